"""Gears that creep: they give way more under the later loads of a pose, which no effect of the catalogue does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.simulation import Truth, clean_response, nominal_truth
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.report.words import sentence
from symstiff.robot import load

SIGMA = 3e-5


def experiment(poses: int = 30, loads: int = 3) -> Measurements:
    """A UR10 under a weight that is laid on in equal parts, read at three markers."""
    robot, rng = load("ur10"), np.random.default_rng(4)
    q = np.array([rng.uniform(*joint.range, poses) for joint in robot.joint]).T
    w = np.zeros((poses * loads, 6))
    w[:, 2] = -np.tile(np.linspace(100.0 / loads, 100.0, loads), poses)
    rows = np.repeat(np.arange(poses * loads), 3)
    return measurements(
        np.repeat(q, loads, axis=0)[rows],
        w[rows],
        pose=np.repeat(np.arange(poses), 3 * loads),
        points=("p1", "p2", "p3"),
        point=np.tile([0, 1, 2], poses * loads),
    )


def crept(joint: int, grown: float, seed: int = 1) -> Measurements:
    """What three markers read where a joint's compliance grows with the time under load: by this much at the end."""
    table, values = experiment(), nominal_truth(load("ur10"))
    case = np.abs(table.w[:, 2]) / 100.0
    growth = grown * np.log1p(16.0 * (case - case.min())) / np.log1p(16.0 * np.ptp(case))
    read = np.zeros((len(table), 6))
    for g in np.unique(growth):
        rows = growth == g
        truth = Truth(load("ur10"), {**values, f"c{joint}": values[f"c{joint}"] * (1.0 + g)})
        context = {"points": table.points, "point": table.point[rows]}
        read[rows] = clean_response(truth, table.q[rows], table.w[rows], context)
    noise = np.random.default_rng(seed).normal(scale=SIGMA, size=read.shape)
    known = [1.0, 1.0, 1.0, np.nan, np.nan, np.nan]
    return replace(
        table, kind="deflection", values=(read + noise) * known, sigma=np.tile(SIGMA, read.shape) * known
    )


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "grown"), [(2, 0.25), (3, 0.5)])
def test_a_gear_that_creeps_is_no_load_that_is_misread(joint: int, grown: float) -> None:
    """Beyond a straight line through the loads it is nearly a weight that is missing."""
    found = diagnose(Task(load("ur10"), crept(joint, grown)))
    assert found.verdict == "unexplained"
    assert f"the evidence is strongest at joint {joint}" in sentence(found)
    assert "load_case growing by 1 from the first load of a pose to the last" in sentence(found)
