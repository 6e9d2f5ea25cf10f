"""Where the measured point stands on the last link, when the robot file does not say.

A probe on the flange is measured far from the tool centre point of the robot file. That is no error of the
robot: in absolute data without an external load the offset is estimated along with the device's placement.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.doubts.soundness import check_tool
from symstiff.calibration.experiment.placement import motions, stations
from symstiff.calibration.tables.measurements import Measurements
from symstiff.model import StiffnessModel
from symstiff.robot.schema import Robot
from symstiff.robot.tool import tool_of, with_tool
from symstiff.symbolic.numeric import kinematics

LEAST, LEAST_SHARE = 5e-3, 0.02
"""Offsets below this [m], of small arms below this share of the reach, are what a calibration finds, not a point that
nobody told of."""
FAR = 0.03
"""Distance, in reaches, that no uncalibrated robot is away."""
_ROUNDS, _SETTLED = 60, 1e-9
"""Linearisations, at most, and the last step [m] with which they have settled."""
_FEWEST = 12
"""Rows from which the point is looked for: nine numbers are found along."""


def find_point(model: StiffnessModel, table: Measurements, robot: Robot) -> tuple[StiffnessModel, str]:
    """The model with the tool centre point moved to the point that was measured, and a remark on it.

    Only for absolute positions of the tool centre point under no external load, and where the point stands more than
    5 mm off, or a fiftieth of a small arm's reach; else the model as it is, and no remark. Raises UserError where that
    is not ``robot``'s tool.
    """
    if table.kind != "absolute" or table.points != ("tcp",) or np.abs(table.w).max(initial=0.0) > 0:
        check_tool(model, robot)
        return model, ""
    offset = measured_at(model, table)
    length = float(np.linalg.norm(offset))
    if length < min(LEAST, LEAST_SHARE * model.robot.reach):
        return model, ""
    shown = ", ".join(f"{1e3 * x:.1f}" for x in offset)
    return moved_to(model, offset), (
        f"the measured point stands {1e3 * length:.1f} mm from the tool centre point of the robot file "
        f"({shown} mm in tool axes): taken as measured; say so in [tool] or as a [[marker]]"
    )


def of_point(model: StiffnessModel, table: Measurements) -> list[str]:
    """A remark where the point of positions under loads stands far from the tool centre point of the robot file.

    It is not taken as measured there, as ``find_point`` does without loads: whether they act at it as well, the table
    does not tell.
    """
    if not table.w.any():
        return []
    offset = measured_at(model, table)
    length = float(np.linalg.norm(offset))
    if length < FAR * model.robot.reach:
        return []
    xyz = ", ".join(f"{x:.4g}" for x in tool_of(moved_to(model, offset).robot))
    return [
        f"the measured point seems to stand {1e3 * length:.0f} mm from the tool centre point of the robot file: say so "
        f"with xyz = [{xyz}] under [tool], where loads act then, or as a [[marker]]"
    ]


def measured_at(model: StiffnessModel, table: Measurements) -> Array:
    """(3,) where the point of absolute positions stands, from the tool centre point in tool axes [m].

    Zeros where markers were measured, or too few rows tell.
    """
    rows = np.flatnonzero(table.measured[:, :3].all(axis=1))
    if table.points != ("tcp",) or len(rows) < _FEWEST:
        return np.zeros(3)
    found = kinematics(model.robot, table.q[rows])
    return _offset(found.T[:, :3, :3], found.T[:, :3, 3], table.select(rows))


def _offset(attitude: Array, position: Array, table: Measurements) -> Array:
    """(3,) point in tool axes that, with the device's placement, brings prediction and data together."""
    offset, station, seen = np.zeros(3), table.station, table.values[:, :3]
    for _ in range(_ROUNDS):
        points = position + attitude @ offset
        turn, shift = stations(points, table)
        moved = motions(points, station)[:, :3]
        X = np.concatenate([attitude, moved], axis=2).reshape(-1, 3 + moved.shape[2])
        y = (np.einsum("nij,ni->nj", turn, seen - shift) - points).reshape(-1)
        length = np.linalg.norm(X, axis=0)
        step = np.linalg.lstsq(X / length, y, rcond=1e-6)[0] / length
        offset = offset + step[:3]
        if np.abs(step[:3]).max() < _SETTLED:
            break
    return np.asarray(offset)


def moved_to(model: StiffnessModel, offset: Array) -> StiffnessModel:
    """The model with the tool centre point shifted, in tool axes, to a micrometre."""
    before = kinematics(model.robot, np.zeros((1, model.robot.dof)))
    shift = before.R[0, -1].T @ before.T[0, :3, :3] @ offset
    given = tool_of(model.robot)
    x, y, z = (float(f"{a + b:.6f}") for a, b in zip(given, shift, strict=True))
    return replace(model, robot=with_tool(model.robot, (x, y, z)), file_tool=model.file_tool or given)
