"""Joint commands that put the loaded tool where the unloaded one should be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from symstiff.arguments import A_MODEL, require
from symstiff.arrays import TINY
from symstiff.calibration.doubts.soundness import (
    check_bends,
    nothing_bends,
    outside_class,
    outside_fixed,
)
from symstiff.codegen.names import measured_between
from symstiff.codegen.reference import LARGEST_CORRECTION, ROUNDED, unit_length
from symstiff.codegen.runtime import Evaluator, for_poses
from symstiff.codegen.text import context_names
from symstiff.display import counted, few
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.symbolic.algebras import context_columns
from symstiff.symbolic.numeric import forward, joint_jacobian

_ROUNDS = 50  # near a singular pose steps shrink slowly: the Jacobian is that of the unloaded arm
_FINE = 12  # rounds from which on a row that converged is done: rounding keeps its steps from vanishing
_TYPICAL_ROUNDS = 5
_STILL = 1e-13  # rad, m: a row that moves by less is done
_CONVERGED = (
    1e-9  # rad, m: where the last step is smaller, rounding or curvature alone keeps it from vanishing
)
_SINGULAR = 1e-10
_SAMPLE = 16  # poses that tell an arm's rank; the largest of their ranks is missed by chance alone
_ABSURD = 1e6  # rad
_UNITS = {"time": "s", "temperature": "°C"}
_LEAP, _BESIDE = 0.02, 0.02
"""Correction of a joint [rad, m] and ratio of the least to the largest singular value that are those beside a singular
pose."""


@dataclass(frozen=True, eq=False)
class Compensated:
    """Corrected commands q_cmd (N, n), the pose error (N, 6) [m, rad] before and after, and why rows were not solved.

    ``kept`` (N,) is empty for a solved row, else "singular", "too_far", "not_converged" or "no_gain": such a row keeps
    its q, and its error is what it was before. ``remarks`` tell loads and joints that the model was not
    reduced for, loads under which it does not bend, and rows beside a singular pose.
    """

    q_cmd: np.ndarray
    before: np.ndarray
    after: np.ndarray
    kept: np.ndarray
    remarks: tuple[str, ...] = ()

    @property
    def solved(self) -> np.ndarray:
        """(N,): which rows have a corrected command."""
        return np.asarray(self.kept == "")

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean square of the positional error [m] before and after; NaN of no row."""
        return _rms(self.before), _rms(self.after)

    def __repr__(self) -> str:
        before, after = (1e3 * rms for rms in self.rms)
        kept = int((~self.solved).sum())
        stayed = f", {kept} as they were" if kept else ""
        return f"Compensated({counted(len(self.kept), 'row')}{stayed}: {before:.3g} to {after:.3g} mm rms by the model)"


def compensate_online(
    model: StiffnessModel, q: np.ndarray, w: np.ndarray, *, context: Mapping[str, np.ndarray] | None = None
) -> np.ndarray:
    """q_cmd = q − J(q)⁺·Δt(q, W): one step, as the generated C function ``compensate`` (N, n).

    q (N, n) [rad, m], w (N, 6) [N, N·m] in base axes; context: columns (N,) that a law needs, as ``deflection`` takes.
    Rows in a singular pose, that would move a joint by more than 0.25 rad or m, or whose tool would be farther off
    after the step (by the Jacobian half way, as beside a singular pose), keep their q. The generated code has
    no rank but the number of joints or 6: an arm that nowhere has it is singular everywhere. The model holds for the
    loads and fixed joints that it was reduced for (``outside_class`` and ``outside_fixed`` of
    ``symstiff.calibration.doubts.soundness`` tell others). Raises UserError for what is no number, and for a model
    without values.
    """
    require(model, StiffnessModel, *A_MODEL)
    check_bends(model)
    model = model.of_robot()
    q, w = model.poses(q, w)
    dt = for_poses(model, len(q)).deflection(q, w, context=context)
    step, regular = _step(model, q, dt, min(model.robot.dof, 6))
    usable = regular & _small(step)
    usable[usable] = _gains(model, q[usable], step[usable], dt[usable])
    return np.where(usable[:, None], q - step, q)


def compensate(
    model: StiffnessModel, q: np.ndarray, w: np.ndarray, *, context: Mapping[str, np.ndarray] | None = None
) -> Compensated:
    """Solve T(q_cmd)·Δt(q_cmd, W) = T(q) by Newton steps with the nominal Jacobian (off-line compensation).

    q (N, n) [rad, m], the poses where the tool should be without load; w (N, 6) [N, N·m], the loads at the tool centre
    point in base axes; context: columns (N,) that a law needs, such as ``time`` [s].
    Where the robot cannot reach all six coordinates the weighted error that is left is the smallest, where joints are
    redundant the motion is. Not solved are rows in a singular pose (fewer directions of motion than the arm has
    elsewhere), rows that did not converge or whose error would grow, and rows that would move a joint by
    more than 0.25 rad or m, where a correction of compliance errors has no meaning. Effects of the measurement alone
    are no laws of the robot and move nothing. A reduced model holds for its class of loads, and where joints stood
    fixed for their values alone: ``remarks`` of the result tell what is outside. Raises UserError for values that are
    no numbers, for a model without values (a start for ``identify``), and where a deflection overflows.
    """
    require(model, StiffnessModel, *A_MODEL)
    check_bends(model)
    model = model.of_robot()
    q, w = model.poses(q, w)
    moment = context_columns(context, len(q))
    remarks = (
        *outside_class(w, model.loads),
        *outside_fixed(q, model),
        *nothing_bends(w, model),
        *_unmeasured(model, moment),
    )
    target = forward(model.robot, q)
    evaluator = for_poses(model, _TYPICAL_ROUNDS * len(q))
    command, kept, moving = q.copy(), np.full(len(q), "not_converged"), np.arange(len(q))
    last, share = np.zeros_like(q), np.ones((len(q), 1))

    def error(rows: np.ndarray) -> np.ndarray:
        there = {k: x[rows] for k, x in moment.items()}
        return _error(evaluator, target[rows], command[rows], w[rows], there)

    before, rank = error(moving), _rank(model)
    if not np.isfinite(before).all():
        raise UserError("the model predicts deflections beyond all numbers: correct its values, or the loads")
    for turn in range(_ROUNDS):
        step, regular = _step(model, command[moving], error(moving), rank)
        share[moving] = np.where(_swings(step, last[moving]), share[moving] / 2, share[moving])
        step *= share[moving]
        size = np.abs(step).max(axis=1, initial=0.0)
        step[size < _STILL] = 0.0  # rounding moves no joint
        command[moving], last[moving] = command[moving] - step, step
        small = _small(command[moving] - q[moving])
        cases = [~regular, ~small, size < _CONVERGED]
        kept[moving] = np.select(cases, ["singular", "too_far", ""], "not_converged")
        moving = moving[regular & small & (size >= (_STILL if turn < _FINE else _CONVERGED))]
        if not len(moving):
            break
    after = before.copy()
    rows = np.flatnonzero(kept == "")
    after[rows] = error(rows)
    kept[_weight(model, after) > _weight(model, before) + _CONVERGED] = "no_gain"
    keep = (kept != "")[:, None]
    command = np.where(keep, q, command)
    remarks = (*remarks, *_beside_singular(model, q, command, rank))
    return Compensated(command, before, np.where(keep, before, after), kept, remarks)


def _unmeasured(model: StiffnessModel, moment: Mapping[str, np.ndarray]) -> list[str]:
    """A remark on times and temperatures that lie beyond those that the laws which follow them were measured at."""
    held = measured_between(model)
    found = []
    for name in [n for n in context_names(model.deflection_program) if n in held and n in moment]:
        low, high = held[name]
        beyond = np.flatnonzero((moment[name] < low) | (moment[name] > high))
        if len(beyond):
            found.append(
                f"{counted(len(beyond), 'row')} at a {name} beyond what was measured, {low:.6g} to {high:.6g} "
                f"{_UNITS[name]} (first: row {beyond[0] + 1}): the law that follows it goes on there as it was fitted"
            )
    return found


def _beside_singular(model: StiffnessModel, q: np.ndarray, command: np.ndarray, rank: int) -> list[str]:
    """A remark on rows beside a singular pose whose joints go far for a small correction.

    There joints move the tool nearly alike: each counts as much, a joint that only turns the tool where its position
    comes first as well.
    """
    far = np.abs(command - q).max(axis=1, initial=0.0)
    J = _weighed_jacobian(model, q)
    alike = J / np.maximum(np.linalg.norm(J, axis=1, keepdims=True), TINY)
    s = np.linalg.svd(alike, compute_uv=False)[:, :rank]
    rows = np.flatnonzero((far > _LEAP) & (s[:, -1] < _BESIDE * s[:, 0]))
    if not len(rows):
        return []
    joint = int(np.argmax(np.abs(command - q)[rows[np.argmax(far[rows])]])) + 1
    unit = "m" if model.robot.joint[joint - 1].prismatic else "rad"
    which = few([str(r + 1) for r in rows], 6)
    there = f"there by up to {far[rows].max():.2g} {unit} (joint {joint})"
    return [
        f"{counted(len(rows), 'row')} beside a singular pose ({which}): small corrections of the tool turn joints "
        f"{there}, and jump from one pose to the next: lead the path past it, or leave these rows as they are"
    ]


def _small(motion: np.ndarray) -> np.ndarray:
    """Which rows of joint motions (N, n) [rad, m] are corrections; one that is not finite is none."""
    return np.asarray(np.all(np.abs(motion) <= LARGEST_CORRECTION, axis=1))


def _gains(model: StiffnessModel, q: np.ndarray, step: np.ndarray, dt: np.ndarray) -> np.ndarray:
    """Which rows' deflections (N, 6) steps of joints (N, n) lessen, by the Jacobian half way, or leave as they are."""
    moved = np.einsum("nij,nj->ni", joint_jacobian(model.robot, q - step / 2), step)
    return np.asarray(_weight(model, dt - moved) ** 2 <= ROUNDED * _weight(model, dt) ** 2)


def _swings(step: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Which steps (N, n) undo half of the last one or more: whole steps would swing about the solution, (N, 1)."""
    back = np.sum(step * last, axis=1, keepdims=True)
    return np.asarray(back < -0.5 * np.sum(last**2, axis=1, keepdims=True))


def _rms(error: np.ndarray) -> float:
    """Of the positional parts of errors (N, 6) [m]."""
    return float(np.sqrt((error[:, :3] ** 2).sum(axis=1).mean())) if len(error) else float("nan")


def _weight(model: StiffnessModel, twist: np.ndarray) -> np.ndarray:
    """Lengths (N,) [m] of twists (N, 6) with rotations as lengths, as the steps weigh them."""
    return np.asarray(np.linalg.norm(twist * _scale(model), axis=1))


def _scale(model: StiffnessModel) -> np.ndarray:
    return np.array([1.0, 1.0, 1.0, *[unit_length(model)] * 3])


def _error(
    evaluator: Evaluator,
    target: np.ndarray,
    q: np.ndarray,
    w: np.ndarray,
    context: Mapping[str, np.ndarray] | None,
) -> np.ndarray:
    """Loaded pose at q minus target, as a twist in base axes (N, 6)."""
    from scipy.spatial.transform import Rotation

    deflection = evaluator.deflection(q, w, context=context)
    pose = forward(evaluator.model.robot, q)
    turn = deflection[:, 3:]
    absurd = ~(np.abs(turn) < _ABSURD).all(axis=1, keepdims=True)  # no rotation, but a number that says so
    turned = Rotation.from_rotvec(np.where(absurd, 0.0, turn)) * Rotation.from_matrix(pose[:, :3, :3])
    away = (turned * Rotation.from_matrix(target[:, :3, :3]).inv()).as_rotvec()
    moved = pose[:, :3, 3] + deflection[:, :3] - target[:, :3, 3]
    return np.hstack([moved, np.where(absurd, turn, away)])


def _rank(model: StiffnessModel) -> int:
    """In how many directions the arm moves its tool where it is not singular."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (_SAMPLE, model.robot.dof))
    s = np.linalg.svd(_weighed_jacobian(model, q), compute_uv=False)
    return int((s > _SINGULAR * s[:, :1]).sum(axis=1).max())


def _weighed_jacobian(model: StiffnessModel, q: np.ndarray) -> np.ndarray:
    """Jacobians (N, 6, n) with rotations as lengths."""
    return np.asarray(joint_jacobian(model.robot, q) * _scale(model)[None, :, None])


def _step(
    model: StiffnessModel, q: np.ndarray, twist: np.ndarray, rank: int
) -> tuple[np.ndarray, np.ndarray]:
    """Joint motions that cause a twist: exact, of least norm, or in least squares; and which rows have that rank."""
    u, s, vt = np.linalg.svd(_weighed_jacobian(model, q), full_matrices=False)
    u, s, vt = u[:, :, :rank], s[:, :rank], vt[:, :rank]
    regular = s[:, -1] > _SINGULAR * s[:, 0]
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > _SINGULAR * s[:, :1])
    step = np.einsum("nki,nk,njk,nj->ni", vt, inverse, u, twist * _scale(model))
    return step, regular
