"""A joint that settles at another place at every reading: no effect, and told where nothing else is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.measurements import Measurements
from symstiff.discrepancy.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured


def shaken(table: Measurements, joint: int, size: float, by_pose: bool = False) -> Measurements:
    """The planar arm's readings with a joint that stands off by another angle of that size at every load, or pose."""
    robot, rng = load(ROBOT), np.random.default_rng(5)
    first, both = table.q[:, 0], table.q.sum(axis=1)
    elbow = float(robot.joint[0].a) * np.stack([np.cos(first), np.sin(first)], axis=1)
    marker = np.array(
        [next(m.xyz for m in robot.marker if m.name == table.points[k])[:2] for k in table.point], float
    )
    at = float(robot.joint[1].a) * np.eye(2)[0] + marker
    beyond = np.stack(
        [
            np.cos(both) * at[:, 0] - np.sin(both) * at[:, 1],
            np.sin(both) * at[:, 0] + np.cos(both) * at[:, 1],
        ],
        axis=1,
    )
    lever = beyond if joint == 2 else elbow + beyond
    keys = table.pose[:, None] if by_pose else np.column_stack([table.pose, table.w])
    number = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    angle = size * rng.standard_normal(number.max() + 1)[number]
    values = table.values.copy()
    values[:, 0] -= angle * lever[:, 1]
    values[:, 1] += angle * lever[:, 0]
    return replace(table, values=values)


def told(table: Measurements) -> list[str]:
    """The remarks of a diagnosis on what scatters along a joint."""
    return [r for r in diagnose(Task(load(ROBOT), table)).remarks if "what is left scatters" in r]


@pytest.mark.parametrize("joint", [1, 2])
def test_a_joint_that_sticks_and_slips_is_told(joint: int) -> None:
    remarks = told(shaken(measured(poses=14), joint, 4e-5))
    assert len(remarks) == 1
    assert f"times as much along what joint {joint} moves as elsewhere" in remarks[0]


def test_the_scatter_of_a_joint_is_told_beside_what_is_named_and_noise_and_missed_poses_are_not() -> None:
    assert told(shaken(measured(HARDENING, poses=14), 1, 4e-5))
    assert not told(measured(HARDENING, poses=14))
    assert not told(measured(poses=14))
    assert not told(shaken(measured(poses=14), 2, 4e-5, by_pose=True))
