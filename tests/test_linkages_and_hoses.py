"""Errors that two joints make together, and hoses, in absolute data: unexplained, at the right place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import look
from symstiff.calibration.measurements import Measurements
from symstiff.discrepancy.finding import Finding, Task
from symstiff.discrepancy.workflow import run
from symstiff.report.words import sentence
from symstiff.robot import load
from tests.test_assemble import design, readings, truth_of

NOISE = 2e-5


def experiment() -> Measurements:
    """Fifty poses of a UR10 without a load, three markers."""
    table = design("ur10", "absolute", poses=50, levels=(1.0,))
    return replace(table, w=np.zeros_like(table.w))


def diagnosed(table: Measurements, values: np.ndarray, start: str = "joints") -> Finding:
    """What positions (N, 3) with noise lead to."""
    seen = np.full((len(table), 6), np.nan)
    seen[:, :3] = values + NOISE * np.random.default_rng(3).normal(size=(len(table), 3))
    sigma = np.where(np.isfinite(seen), NOISE, np.nan)
    return run(Task(load("ur10"), replace(table, values=seen, sigma=sigma), start=start))


@pytest.mark.slow
def test_a_linkage_between_two_joints_is_told_with_both_angles() -> None:
    table = experiment()
    angles = np.zeros_like(table.q)
    angles[:, 2] = 1e-4 * np.sin(2 * table.q[:, 1]) * np.cos(table.q[:, 2])
    view = look(load("ur10"), replace(table, q=table.q + angles))
    found = diagnosed(table, view.found.T[:, :3, 3] + view.offset)
    assert found.verdict == "unexplained"
    law = found.last.law
    assert law is not None
    assert law.virtual_joint == "joint 3"
    assert "cos(q3)*sin(2*q2)" in law.expression
    assert "·cos(q3)·sin(2·q2)" in sentence(found)


@pytest.mark.slow
def test_a_hose_that_pulls_all_the_time_is_no_compliance() -> None:
    """From a fixed point beside the arm, the more the further away the flange is."""
    table = experiment()
    flange = look(load("ur10"), table).found.T[:, :3, 3]
    pull = np.zeros_like(table.w)
    pull[:, :3] = 10.0 * (np.array([0.3, 0.6, 1.6]) - flange)
    found = diagnosed(table, readings(truth_of("ur10"), replace(table, w=pull))[:, :3], "complete")
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "flange"
    sizes = {name: (value, deviation) for name, value, deviation, _ in law.terms}
    value, deviation = sizes["pull towards a fixed point: spring"]
    assert value == pytest.approx(10.0, abs=4 * deviation)
    assert "evidence is strongest at the flange" in sentence(found)
