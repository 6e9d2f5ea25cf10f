"""What a table lets one identify: read from the columns that vary and the points that are measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.calibration.tables.measurements import Measurements
from symstiff.robot.schema import Robot

_SAME = 1e-6  # m


@dataclass(frozen=True)
class ExperimentClass:
    """Class of loads and measurement, joints that never move, and markers where too few stand for the pose."""

    loads: str
    measure: str
    fixed: Mapping[int, float]
    points: tuple[str, ...] = ()

    def wished(self, loads: str | None, measure: str | None) -> ExperimentClass:
        """The same with another class of loads or measurement, where one is wished for."""
        if measure not in (None, self.measure):
            return ExperimentClass(loads or self.loads, measure, self.fixed)
        return replace(self, loads=loads or self.loads)


def experiment_of(table: Measurements, robot: Robot) -> ExperimentClass:
    """Read the class of the experiment from the columns that vary."""
    used = np.abs(table.w).max(axis=0) > 0
    loads = "wrench" if used[3:].any() else ("force" if used[:2].any() else "gravity")
    still = table.standing if len(table.labels) > 1 else {}
    if table.measured[:, 3:].any():
        return ExperimentClass(loads, "pose", still)
    measure, points = read_at(robot, table.points)
    return ExperimentClass(loads, measure, still, points)


def read_at(robot: Robot, points: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """What positions of points tell, and the points where that is neither the tool's pose nor its position.

    Three that span a plane tell the pose. One beside the tool centre point tells a mixture of translation and
    rotation, and points on a line leave the rotation about it open.
    """
    tip = np.array([float(x) for x in robot.marker_position("tcp")])
    places = np.array([[float(x) for x in robot.marker_position(p)] for p in points])
    if np.abs(places - tip).max() <= _SAME:
        return "position", ()
    spread = np.linalg.matrix_rank(places - places[0], _SAME)
    if spread >= 2:
        return "pose", ()
    return ("pose", tuple(points)) if spread else ("position", (points[0],))
