"""Structural groups of candidates: those that add the same spaces to the model, whatever the poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.experiment.anywhere import any_poses
from symstiff.calibration.experiment.placement import placement_columns
from symstiff.calibration.experiment.situation import Situation, linear_columns, look, under_weights
from symstiff.calibration.fits.decomposition import column_space
from symstiff.discrepancy.problem import Candidate, Problem
from symstiff.discrepancy.statistics.scan import OWN
from symstiff.model import StiffnessModel
from symstiff.robot.schema import Robot

_SAME = 1e-6
"""Distance of two shadows, against their length, up to which they are one."""
_MOST_SHAPES = 6
"""Simplest shapes of a candidate up to which its columns are compared with those of others."""


def grouped(problem: Problem, candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Name the groups of candidates that add the same spaces to the model, whichever of their simplest shapes.

    A shape whose space is a part of another one's does not count: that takes in all it does.
    """
    basis = column_space(problem.A)
    probe = np.random.default_rng(0).standard_normal(problem.rows)
    known: list[tuple[str, Array, float]] = []
    out = []
    for candidate in candidates:
        if candidate.unavailable or len(candidate.simplest) > _MOST_SHAPES:
            out.append(candidate)
            continue
        spaces = [_own_space(candidate.block(s), basis) for s in candidate.simplest]
        shadow = np.concatenate([own @ (own.T @ probe) for own in spaces if not _within(own, spaces)])
        size = float(np.linalg.norm(shadow))
        alike = (n for n, other, s in known if abs(s - size) <= _SAME * size and _equal(other, shadow))
        name = next(alike, candidate.key)
        known.append((name, shadow, size))
        out.append(replace(candidate, group=name))
    return tuple(out)


def structural(
    model: StiffnessModel, situation: Situation, candidates: Sequence[Candidate]
) -> tuple[Candidate, ...]:
    """Keep the groups that hold at other poses too: these poses alone may make columns look the same."""
    names = [c.group for c in candidates]
    several = [c for c in candidates if c.group and names.count(c.group) > 1]
    if not several:
        return tuple(candidates)
    elsewhere = _elsewhere(model.robot, situation)
    moved = [replace(c, columns=replace(c.columns, situation=elsewhere, _seen={})) for c in several]  # type: ignore[type-var]
    compliances = list(dict.fromkeys(t.parameter for t in situation.laws.terms))
    A = np.hstack([
        linear_columns(elsewhere.view, situation.laws.terms, compliances),
        placement_columns(elsewhere.view, probe=model.file_tool is not None),
    ])  # fmt: skip
    rows = len(A)
    blank = np.zeros(rows, dtype=np.intp)
    there = grouped(Problem(np.zeros(rows), A, blank, blank, blank, blank), moved)
    both = {c.key: (c.group, found.group) for c, found in zip(several, there, strict=True)}
    first: dict[tuple[str, str], str] = {}
    return tuple(
        replace(c, group=first.setdefault(both[c.key], c.key)) if c.key in both else c for c in candidates
    )


def _elsewhere(robot: Robot, situation: Situation) -> Situation:
    """The same experiment at random poses within the joints' limits."""
    view = situation.view
    poses, back = np.unique(view.table.pose, return_inverse=True)
    q = any_poses(robot, np.random.default_rng(0), len(poses))
    moved = look(robot, replace(view.table, q=q[back.reshape(-1)]))
    moved = replace(moved, turn=view.turn, shift=view.shift)
    if view.table.kind == "absolute":
        moved = under_weights(moved)
    return Situation(moved, replace(situation.laws, view=moved))


def _own_space(block: Array, basis: Array) -> Array:
    """Orthonormal basis (M, r) of what a block adds to the model."""
    length = np.linalg.norm(block, axis=0)
    block = block[:, length > 0] / length[length > 0]
    return column_space(block - basis @ (basis.T @ block), OWN)


def _within(own: Array, spaces: Sequence[Array]) -> bool:
    """Whether a space is a part of a larger one among some."""
    return any(
        other.shape[1] > own.shape[1]
        and bool(np.linalg.norm(own - other @ (other.T @ own)) < _SAME * np.sqrt(own.shape[1]))
        for other in spaces
    )


def _equal(a: Array, b: Array) -> bool:
    return a.shape == b.shape and bool(np.linalg.norm(a - b) < _SAME * np.linalg.norm(b))
