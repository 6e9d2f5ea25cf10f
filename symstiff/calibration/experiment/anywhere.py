"""Random rows of an experiment of the same kind: what holds there holds at any poses, not at those measured alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from symstiff.arrays import Array
from symstiff.reduction.structural import LOADS
from symstiff.robot.schema import Robot


def any_poses(
    robot: Robot, rng: np.random.Generator, count: int, held: Mapping[int, float] | None = None
) -> Array:
    """(count, n) joint variables within the limits [rad, m]; those ``held``, by joint from one on, at their values."""
    low, high = robot.ranges.T
    q = rng.uniform(low, high, (count, robot.dof))
    for joint, value in (held or {}).items():
        q[:, joint - 1] = value
    return q


def any_loads(loads: str, rng: np.random.Generator, count: int) -> Array:
    """(count, 6) wrenches of a class of loads, of deviation one in each of its components."""
    return np.asarray(rng.normal(size=(count, 6)) * [k in LOADS[loads] for k in range(1, 7)])
