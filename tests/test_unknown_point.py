"""Positions under loads of a point that the robot file does not tell: it is named, and not taken as measured."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import Noise, Truth, nominal_truth, simulate
from symstiff.calibration.simulation.truth import Device
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load
from symstiff.robot.tool import tool_of, with_tool

ROBOT, POSES = load("kuka_kr270"), 15
JOINTS = {name: value for name, value in nominal_truth(ROBOT).items() if name.startswith("c")}
PROBE = (0.05, 0.1, 0.3)


@cache
def loaded(*shift: float) -> Measurements:
    """Each pose without a load and with one, of a point that is shifted from the file's in its frame."""
    rng = np.random.default_rng(5)
    limits = np.array([j.range for j in ROBOT.joint])
    q = np.repeat(rng.uniform(limits[:, 0], limits[:, 1], (POSES, ROBOT.dof)), 2, axis=0)
    w = np.zeros((2 * POSES, 6))
    w[1::2, 2] = -1500.0
    plan = measurements(q, w, pose=np.repeat(np.arange(POSES), 2), kind="absolute")
    robot = with_tool(ROBOT, tuple(a + b for a, b in zip(tool_of(ROBOT), shift, strict=True)))
    place = Device((3.0, 1.0, 0.5), (0.0, 0.0, 2.0))
    return simulate(Truth(robot, JOINTS, (), Noise((0.02,) * 3), device=place), plan, 5)


def told(text: str) -> np.ndarray:
    """The place that is to be entered under [tool]."""
    return np.array([float(x) for x in text.split("xyz = [", 1)[1].split("]", 1)[0].split(",")])


@pytest.mark.parametrize("where", ["diagnose", "identify"])
def test_a_point_far_from_the_files_is_told_with_its_place(where: str) -> None:
    table = loaded(*PROBE)
    if where == "diagnose":
        text = str(diagnose(Task(ROBOT, table, "joints")).because)
    else:
        text = next(r for r in identify(ROBOT, table, "joints").remarks if "seems to stand" in r)
    assert told(text) - np.array(tool_of(ROBOT)) == pytest.approx(np.array(PROBE), abs=5e-3)


def test_an_arm_that_is_out_of_true_is_not_said_to_be_measured_elsewhere() -> None:
    remarks = identify(ROBOT, loaded(0.0, 0.0, 0.0), "joints").remarks
    assert not any("seems to stand" in r for r in remarks)


def test_positions_in_the_wrong_order_of_joints_are_not_laid_to_the_point() -> None:
    table = loaded(0.0, 0.0, 0.0)
    found = diagnose(Task(ROBOT, replace(table, q=table.q[:, [0, 2, 1, 3, 4, 5]]), "joints"))
    assert "xyz = [" not in str(found.because)
