"""What the rows of a pose share: the ways, the pattern of each in the data, and the sizes that are learned."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from symstiff.arrays import TINY, Array, Index, numbered
from symstiff.discrepancy.noise.blocks import Roots, applied, blocks, raised
from symstiff.discrepancy.noise.shaking import STILL, Shaken, common_size, shared_by_readings
from symstiff.discrepancy.problem import Problem

RATIOS = (0.03, 0.1, 0.35, 1.0, 3.0, 10.0, 35.0, 120.0, 400.0)
"""Grid of (variance of the approach error) / (variance of the noise); every second one is looked at first."""

AXES, SHIFT, JOINTS, EACH, BESIDE = "axes", "shift", "joints", "each", "beside"
"""What a pose's rows share: an error of every measured axis, of the translations alone, of the joints' angles, all
alike, or one of every joint, of the axes and of each marker beside, of sizes that were learned from what is left
after all that stands out, or after one effect more."""
LEARNED = (EACH, BESIDE)
"""An effect of one joint passes for the size of its errors where that is learned without the effect."""

ALIKE = 4.0
"""Poses that the belief in joints with like errors counts for; what is learned of more poses pays for it."""
_STEPS = 150
_SEVERAL = 10
"""Rows beyond one a pose from which they say what they share."""
NEAR = (0.55, 1.0, 1.8)
"""Ratios about a size, learned or likely, that are looked at."""


@dataclass(frozen=True)
class Sharing:
    """One hypothesis of the error that a pose's rows share: what shares it, and its variance over the noise's."""

    way: str = AXES
    ratio: float = 0.0


@dataclass(frozen=True)
class Split:
    """How a shared error is split."""

    own: float = 0.0
    """Part of the axes' error that each marker has alone."""
    anew: float = 0.0
    """Part of the shared error that each repeat of a pose has alone: the robot came back to it."""
    reading: Shaken = STILL
    """What the rows of one reading share."""
    learned: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Variances over the noise's by the way that was learned: of each joint's errors, of the axes' and, of several
    markers, of what each has alone."""


def at_first(problem: Problem, ways: Mapping[str, Roots]) -> tuple[Sharing, ...]:
    """None, and the coarse grid of every way that the rows can tell; about its size what was learned."""
    told = [way for way in ways if way in LEARNED or shares(problem, way)]
    return (
        Sharing(),
        *(Sharing(way, ratio) for way in told for ratio in (NEAR if way in LEARNED else RATIOS[::2])),
    )


def several_markers(problem: Problem) -> bool:
    """Whether more than one point was measured."""
    return len(np.unique(problem.channel)) > len(np.unique(problem.axis))


def repeated(problem: Problem) -> bool:
    """Whether poses were measured more than once."""
    return problem.turn is not None and bool(np.any(problem.turn))


def shares(problem: Problem, way: str) -> bool:
    """Whether the rows can tell a way: axes need several rows of one axis in a pose, joints several rows in a pose."""
    label = problem.pose if way == JOINTS else problem.lines
    return problem.rows - len(np.unique(label)) >= _SEVERAL and problem.poses > 2


def near(sharings: Sequence[Sharing], kept: Sequence[Sharing], finer: bool = False) -> tuple[Sharing, ...]:
    """The sharings that are likely and their neighbours on the grid, or halfway to them; what was learned stays."""
    if len(sharings) == 1:
        return tuple(sharings)
    out = [Sharing()]
    for way in dict.fromkeys(s.way for s in sharings if s.ratio > 0 and s.way not in LEARNED):
        there = sorted({s.ratio for s in kept if s.way == way and s.ratio > 0})
        first = bisect_left(RATIOS, there[0]) if there else 0
        last = bisect_left(RATIOS, there[-1]) if there else 0
        if finer and 1 <= len(there) <= 2:
            between = (NEAR[0] * there[0], *there, NEAR[-1] * there[-1])
            out += [Sharing(way, r) for r in between if r >= RATIOS[0]]
        else:
            # none is a neighbour of the smallest, also where another way than this one is likely
            out += [Sharing(way, r) for r in RATIOS[max(first - 1, 0) : last + 2]]
    return (*out, *(s for s in sharings if s.way in LEARNED))


def patterns(problem: Problem, spread: Array, split: Split) -> dict[str, Roots]:
    """K of every way that the data can tell.

    A ratio of 1 is a shared error as large as the noise, mean square of the main rows; of ``LEARNED`` ways as learned.
    """
    common = common_size(problem, spread)
    u = common / spread
    markers = _markers(problem, split.own)
    alone = [np.sqrt(split.own) * u * marker for marker in markers]
    factor = np.column_stack([np.sqrt(1.0 - split.own) * u, *alone])
    reading = raised(shared_by_readings(problem, spread, split.reading), -0.5)

    def shared(label: Index, factor: Array) -> Roots:
        return blocks(label, applied(reading, _by_turn(problem, split.anew, factor)))

    def of_axes(factor: Array) -> Roots:
        if not split.reading.joints:
            return shared(problem.lines, factor)
        # what a joint adds to a reading mixes its axes
        each = [factor * (problem.axis == axis)[:, None] for axis in np.unique(problem.axis)]
        return shared(problem.pose, np.hstack(each))

    ways = {AXES: of_axes(factor)}
    if np.any(problem.axis < 3) and np.any(problem.axis >= 3):
        ways[SHIFT] = of_axes(factor * (problem.axis < 3)[:, None])
    if problem.J is not None and any(j >= 0 for j in problem.joint_of):
        ways[JOINTS] = shared(problem.pose, of_joints(problem, common) / spread[:, None])
    for way, found in split.learned.items():
        ways[way] = shared(problem.pose, _every(problem, spread) * np.sqrt(_spread_out(problem, found)))
    return ways


def _by_turn(problem: Problem, anew: float, factor: Array) -> Array:
    """A shared error's factor (M, k) with the part that each repeat of a pose has alone in columns of its own."""
    if problem.turn is None or anew == 0.0:
        return factor
    alone = [np.sqrt(anew) * factor * (problem.turn == turn)[:, None] for turn in np.unique(problem.turn)]
    return np.hstack([np.sqrt(1.0 - anew) * factor, *alone])


def approaches(problem: Problem, anew: float) -> Index:
    """(M,) a number for what shares an error: the pose, or its repeat where most of the error is each repeat's own."""
    if problem.turn is None or anew < 0.5:
        return problem.pose
    return numbered(problem.pose, problem.turn)


def _markers(problem: Problem, own: float) -> list[Array]:
    points = problem.points
    return [(points == p).astype(float) for p in np.unique(points)] if own > 0 else []


def of_joints(problem: Problem, common: Array) -> Array:
    """(M, n) readings of errors of the joints, the whole as large as ``common`` (M,) in the main rows.

    All angles are alike, a slide's error is as large at the tool as an angle's.
    """
    assert problem.J is not None
    J = problem.J[:, [v for v, j in enumerate(problem.joint_of) if j >= 0]]
    main = problem.main
    size = np.sqrt(np.mean(J[main] ** 2, axis=0))
    slides = np.array([j in problem.slides for j in problem.joint_of if j >= 0]) & (size > 0)
    if np.any(slides) and np.any(size[~slides] > 0):
        J = J * np.where(slides, np.sqrt(np.mean(size[~slides] ** 2)) / np.where(slides, size, 1.0), 1.0)
    whole = float(np.sqrt(np.sum(np.mean(J[main] ** 2, axis=0))))
    return np.asarray(J * (np.sqrt(np.mean(common[main] ** 2)) / max(whole, TINY)))


def _every(problem: Problem, spread: Array) -> Array:
    """(M, n + axes + channels) readings of errors of joints, axes and each marker's axes, in units of the noise."""
    common = common_size(problem, spread)
    alike = [(label[:, None] == np.unique(label)) * common[:, None] for label in _alike(problem)]
    return np.asarray(np.hstack([of_joints(problem, common), *alike]) / spread[:, None])


def _alike(problem: Problem) -> list[Index]:
    """(M,) labels of the errors of one size: axes, and each marker's axes where there are several markers."""
    return [problem.axis, problem.channel] if several_markers(problem) else [problem.axis]


def _spread_out(problem: Problem, each: Sequence[float]) -> Array:
    """(n + axes + channels,) what is alike repeated."""
    labels = _alike(problem)
    joints = len(each) - len(labels)
    counts = [len(np.unique(label)) for label in labels]
    return np.repeat(each, [1] * joints + counts)


def sizes(
    problem: Problem,
    residual: Array,
    spread: Array,
    scale2: float,
    ratio: float,
    label: Index,
    reading: Shaken = STILL,
) -> tuple[float, ...]:
    """Variances over the noise's, by expectation-maximisation: of each joint's errors, the axes' and the markers' own.

    ``residual`` (M,) in the data's unit with the shared error in it, of variance ratio·scale2 against scale2. The
    joints' variances are drawn towards equal ones. Rows of one ``label`` (M,) share an error.
    """
    own = raised(shared_by_readings(problem, spread, reading), -0.5)
    F = applied(own, _every(problem, spread))
    z = applied(own, residual[:, None] / (spread * np.sqrt(scale2))[:, None])[:, 0]
    poses = np.unique(label)
    blocks = [F[label == p] for p in poses]
    seen = np.stack([f.T @ z[label == p] for f, p in zip(blocks, poses, strict=True)])
    gram = np.stack([f.T @ f for f in blocks])
    counts = [len(np.unique(label)) for label in _alike(problem)]
    n = F.shape[1] - sum(counts)
    group = np.repeat(np.arange(n + len(counts)), [1] * n + counts)
    w = np.full(n + len(counts), max(0.5 * ratio, 1e-3))
    for _ in range(_STEPS):
        S = np.linalg.inv(gram + np.diag(1.0 / w[group]))
        mean = np.einsum("pij,pj->pi", S, seen)
        second = np.sum(mean**2 + np.einsum("pii->pi", S), axis=0)
        total = np.bincount(group, second)
        w[:n] = (ALIKE * np.mean(w[:n]) + total[:n]) / (ALIKE + len(poses))
        w[n:] = total[n:] / (np.array(counts) * len(poses))
        w = np.maximum(w, 1e-9)
    return tuple(w.tolist())


def mostly(problem: Problem, spread: Array, each: Sequence[float]) -> str:
    """``JOINTS`` or ``AXES``: what most of the main rows' shared error of these sizes comes from."""
    part = np.mean(_every(problem, spread)[problem.main] ** 2, axis=0) * _spread_out(problem, each)
    joints = len(each) - len(_alike(problem))
    return JOINTS if np.sum(part[:joints]) >= np.sum(part[joints:]) else AXES
