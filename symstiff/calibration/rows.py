"""Measured deflections against a model: one equation a measured component (seed eq. 6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from symstiff.calibration.fits.components import component_sigma
from symstiff.calibration.fits.shared import Blocks, Joints
from symstiff.calibration.tables.loading import turn_of
from symstiff.calibration.tables.measurements import COMPONENTS, Measurements
from symstiff.codegen.runtime import for_poses
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.robot.schema import Robot
from symstiff.symbolic.numeric import forward, joint_jacobian, tool_to_point
from symstiff.symbolic.passes import context_vector
from symstiff.symbolic.terms import deflection


@dataclass(frozen=True, eq=False)
class Equations:
    """Linear equations y = A·π + e of a deflection table.

    A: (R, P), y: (R,) [m, rad], sigma: (R,) or None; row: (R,) row of the table, component: (R,) 0…5.
    """

    A: np.ndarray
    y: np.ndarray
    sigma: np.ndarray | None
    row: np.ndarray
    component: np.ndarray

    def spread(self, flat: np.ndarray, rows: int) -> np.ndarray:
        """Equations' values (R,) back to table shape (rows, 6), NaN where not measured."""
        table = np.full((rows, 6), np.nan)
        table[self.row, self.component] = flat
        return table


def context_of(model: StiffnessModel, table: Measurements) -> dict[str, np.ndarray]:
    """Time, temperature, branch and what follows from that, those that are known throughout.

    Raises UserError for a row that lacks what the model follows.
    """
    columns = {"time": table.time, "temperature": table.temperature, "branch": table.branch}
    needed = [s.name for vector in context_vector(model.terms) for s in vector.symbols]
    columns |= {"turn": turn_of(table)} if "turn" in needed else {}
    known = {k: np.isfinite(v) for k, v in columns.items()}
    for name in needed:
        column = "branch" if name == "turn" else name
        if not known[name].any():
            raise UserError(
                f"{', '.join(table.files) or 'the table'}: the model needs the column {column}: add it, with a value "
                "in every row"
            )
        if not known[name].all():
            place = table.place(int(np.argmin(known[name])))
            raise UserError(f"{place}: column {column}: missing value: the model needs it in every row")
    return {k: v for k, v in columns.items() if known[k].all()}


def at_points(
    model: StiffnessModel, table: Measurements, twist: np.ndarray, values: Mapping[str, float] | None = None
) -> np.ndarray:
    """Twists of the tool centre point (M, 6, …) seen at every row's measured point: d + r × offset.

    A device that is turned sees the offset turned as well.
    """
    if table.points == ("tcp",):
        return twist
    known = model.values if values is None else values
    turn = np.eye(3) + sum((known.get(n, 0.0) * t for n, t in _turns(model).items()), np.zeros((3, 3)))
    offset = _offsets(model, table) @ turn.T
    arm = offset.reshape(*offset.shape, *(1,) * (twist.ndim - 2))
    seen = twist.copy()
    seen[:, :3] += np.cross(twist[:, 3:], np.broadcast_to(arm, twist[:, 3:].shape), axis=1)
    return seen


def _offsets(model: StiffnessModel, table: Measurements) -> np.ndarray:
    """(M, 3) from the tool centre point to every row's measured point, base axes."""
    turn, found = forward(model.robot, table.q)[:, :3, :3], np.zeros((len(table.q), 3))
    for index, point in enumerate(table.points):
        if point != "tcp":
            own = table.point == index
            found[own] = turn[own] @ tool_to_point(model.robot, point)
    return found


def _turns(model: StiffnessModel) -> dict[str, np.ndarray]:
    """By parameter (3, 3): what one unit of it adds to a translation that the device reads, for each one there is."""
    found: dict[str, np.ndarray] = {}
    for term in model.terms:
        if term.at.kind == "measure" and term.at.axis <= 3:
            for c in (1, 2, 3):
                share = term.factor.diff(deflection(c))
                if share.is_number and share != 0:
                    found.setdefault(term.parameter, np.zeros((3, 3)))[term.at.axis - 1, c - 1] += float(
                        share
                    )
    return found


def predict(
    model: StiffnessModel, table: Measurements, values: Mapping[str, float] | None = None
) -> np.ndarray:
    """Predicted deflections of the measured points (M, 6) [m, rad]."""
    return at_points(model, table, _at_tool(model, table, values), values)


def _at_tool(model: StiffnessModel, table: Measurements, values: Mapping[str, float] | None) -> np.ndarray:
    """Predicted deflections of the tool centre point (M, 6)."""
    evaluator = for_poses(model, len(table.q))
    return evaluator.deflection(table.q, table.w, values=values, context=context_of(model, table))


def equations(
    model: StiffnessModel, table: Measurements, values: Mapping[str, float] | None = None
) -> Equations:
    """The equations of a deflection table, linearised at ``values`` where the model is not linear in them.

    Raises UserError for absolute data, whose placement and geometry ``diagnose`` estimates.
    """
    if table.kind != "deflection":
        raise UserError(
            "absolute positions, not deflections: use symstiff diagnose, which estimates placement"
        )
    evaluator = for_poses(model, len(table.q))
    at_tool = evaluator.observation(table.q, table.w, values=values, context=context_of(model, table))
    matrix = at_points(model, table, at_tool, values)
    if turns := _turns(model) if table.points != ("tcp",) else {}:
        angle, offset = _at_tool(model, table, values)[:, 3:], _offsets(model, table)
        for name, turn in turns.items():
            matrix[:, :3, model.parameters.index(name)] += np.cross(angle, offset @ turn.T)
    row, component = np.nonzero(table.measured)
    A, y = matrix[row, component], table.values[row, component]
    if not model.is_linear:
        y = y - predict(model, table, values)[row, component] + A @ model.vector(values)
    return Equations(A, y, stated_sigma(table, row, component), row, component)


def stated_sigma(table: Measurements, row: np.ndarray, component: np.ndarray) -> np.ndarray | None:
    """Stated deviations of equations; gaps take the median of their kind, None where a kind has none."""
    sigma = np.array(table.sigma[row, component])
    for kind in (component < 3, component >= 3):
        if not kind.any():
            continue
        known = sigma[kind & np.isfinite(sigma)]
        if not len(known):
            return None
        sigma[kind & ~np.isfinite(sigma)] = np.median(known)
    return sigma


def shared_blocks(e: Equations, table: Measurements, robot: Robot, moved: np.ndarray) -> Blocks:
    """Which equations an error is common to: one component of a pose, of one approach, of a point in either.

    The robot misses its pose, in part anew at every repeat; the reading without load is each point's own.
    Translations and rotations have errors of their own size, and so have the joints, whose errors move all components:
    ``moved`` (R, n) is what an equation reads of a radian or a metre of each. A joint that slides is off by as much as
    turning ones are at the arm's reach.
    """
    pose, approach, point = table.pose[e.row], table.approach[e.row], table.point[e.row]
    count, points = len(COMPONENTS), len(table.points)
    by_component = [label * count + e.component for label in (pose, approach)]
    lever = np.array([robot.reach if joint.prismatic else 1.0 for joint in robot.joint])
    by_point = [(label * points + point) * count + e.component for label in (pose, approach)]
    return Blocks(
        np.stack([*by_component, *by_point], axis=1), np.asarray(e.component >= 3, dtype=np.intp),
        Joints(np.stack([pose, approach], axis=1), moved * lever),
    )  # fmt: skip


def moved_by_joints(model: StiffnessModel, table: Measurements, e: Equations) -> np.ndarray:
    """(R, n) what an equation reads of a radian or a metre of each joint."""
    return np.asarray(at_points(model, table, joint_jacobian(model.robot, table.q))[e.row, e.component])


def weights(e: Equations) -> np.ndarray | None:
    """Standard deviations of the equations: given, or one for metres and one for radians from the residuals."""
    if e.sigma is not None:
        return e.sigma
    if (e.component >= 3).any() and (e.component < 3).any():
        kinds = ["translation" if c < 3 else "rotation" for c in e.component]
        return component_sigma(e.A, e.y, kinds)
    return None
