"""One compliance of a joint for each of its values: the seed's C2 and J2."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg

from symstiff.arrays import Array
from symstiff.calibration.experiment.anywhere import any_loads, any_poses
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.calibration.rows import equations
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import catalogue
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction.svd import numeric_rank, svd

_SHARE = 1e-6  # of a compliance in a combination, below which it is rounding
_SAME = 2e-3  # distance of two values of a joint [rad, m] up to which they are one level
_WIDE = 5e-3  # what a level is not wider than
_MOST = 20  # levels of a joint: each has to be measured in poses of its own


def levels_of(values: Array) -> Array:
    """The values (N,) of a joint [rad, m] that were measured at, ascending: those that lie together are one.

    A joint that moves through its range has no levels: every value is its own.
    """
    ordered = np.unique(values)
    levels = np.split(ordered, np.flatnonzero(np.diff(ordered) > _SAME) + 1)
    if any(np.ptp(level) > _WIDE for level in levels if len(level)):
        return ordered
    return np.array([np.mean(level) for level in levels])


def by_level(model: StiffnessModel, table: Measurements, joint: int) -> StiffnessModel:
    """One compliance of a joint for each of its distinct values in the table.

    Compliances that these stand for leave the model. Raises UserError for a joint that cannot have them.
    """
    robot = model.robot
    if not 1 <= joint <= robot.dof:
        raise UserError(f"per_level: q{joint}: {robot.name} has joints 1 to {robot.dof}")
    law, shape = next((e, e.levels) for e in catalogue().values() if e.levels is not None)
    places = [int(where["joint"]) for where in law.places(robot)]
    if joint not in places:
        able = f"name q{places[0]}" if places else "it has no joint for one, leave it out"
        raise UserError(
            f"per_level: q{joint}: a compliance that follows the joint's angle is the law of a {law.title.lower()}, "
            f"and q{joint} of {robot.name} has none: {able}"
        )
    angles = np.round(levels_of(table.q[:, joint - 1]), 6)
    if not 2 <= len(angles) <= _MOST:
        raise UserError(
            f"per_level: q{joint} has {len(angles)} distinct values: a compliance for each needs 2 to {_MOST}"
        )
    levels = EffectInstance(law.identifier, {"joint": joint}, shape(angles.tolist()))
    return _without_spare(model, levels, table, joint, angles)


def _without_spare(
    model: StiffnessModel, levels: EffectInstance, table: Measurements, joint: int, angles: np.ndarray
) -> StiffnessModel:
    """The model grown by levels, less the compliances that these and the others make up at any pose.

    Where the link before the joint has an axis along the joint's, the effect replaces the rotation about it; about
    oblique axes the joint turns by a combination, of which the compliance with the largest share leaves.
    """
    plain = replace(model, effects=(levels,), values={}, deviations={})
    names = plain.stiffness_parameters
    A = equations(plain, _anywhere(plain, table, joint, angles)).A
    spare, null = set(), _null(A)[:, : len(names)]
    # where compliances alone vanish the model asks for more than is measured, whatever the levels
    if len(null) and not len(_null(A[:, : len(names)])):
        triangle, order = scipy.linalg.qr(null, mode="r", pivoting=True)
        spare = {names[k] for k, pivot in zip(order, np.diag(triangle), strict=False) if abs(pivot) > _SHARE}
    known = {n: v for n, v in model.values.items() if n not in spare}
    spread = {n: v for n, v in model.deviations.items() if n not in spare}
    kept = tuple(p for p in model.compliances if p.name not in spare)
    return replace(model, compliances=kept, values=known, deviations=spread).with_effect(levels)


def _null(A: np.ndarray) -> np.ndarray:
    """(d, P) orthonormal combinations of columns, scaled to length one, that vanish."""
    _, s, vt = svd(unit_columns(A)[0])
    return np.asarray(vt[numeric_rank(s, len(A)).rank :])


def _anywhere(model: StiffnessModel, table: Measurements, joint: int, angles: np.ndarray) -> Measurements:
    """Random poses at a joint's levels under loads of the model's class, with what the table measures at its points."""
    rng, points = np.random.default_rng(0), len(table.points)
    seen = np.array([table.measured[table.point == k].any(axis=0) for k in range(points)])
    count = 3 * len(model.parameters) + 10 * len(angles)
    q = any_poses(model.robot, rng, count, table.standing)
    q[:, joint - 1] = angles[np.arange(count) % len(angles)]
    w = any_loads(model.loads, rng, count)
    return measurements(
        np.repeat(q, points, axis=0), np.repeat(w, points, axis=0), points=table.points,
        point=np.tile(np.arange(points), count), kind="deflection",
        values=np.tile(np.where(seen, 0.0, np.nan), (count, 1)),
    )  # fmt: skip
