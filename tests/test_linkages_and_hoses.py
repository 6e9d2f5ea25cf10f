"""Errors of two joints together, hoses, bent rays in absolute data: unexplained, at the right place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import look
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.search.localise import FittedLaw
from symstiff.discrepancy.workflow import diagnose
from symstiff.report.words import sentence
from symstiff.robot import load
from tests.test_assemble import assemble, complete, design, outside, readings, truth_of

NOISE = 2e-5


def experiment() -> Measurements:
    """Fifty poses of a UR10 without a load, three markers."""
    table = design("ur10", "absolute", poses=50, levels=(1.0,))
    return replace(table, w=np.zeros_like(table.w))


def positions(table: Measurements, angles: np.ndarray | float = 0.0) -> np.ndarray:
    """(N, 3) of a rigid UR10 whose joints stand elsewhere by some angles (N, 6)."""
    view = look(load("ur10"), replace(table, q=table.q + angles))
    return np.asarray(view.found.T[:, :3, 3] + view.offset)


def filled(table: Measurements, seen: np.ndarray) -> Measurements:
    """The table with positions (N, 3)."""
    return replace(table, values=np.hstack([seen, np.full_like(seen, np.nan)]))


def diagnosed(table: Measurements, values: np.ndarray, start: str = "joints") -> Finding:
    """What positions (N, 3) with noise lead to."""
    seen = filled(table, values + NOISE * np.random.default_rng(3).normal(size=(len(table), 3)))
    return diagnose(
        Task(load("ur10"), replace(seen, sigma=np.where(seen.measured, NOISE, np.nan)), start=start)
    )


def law_of(found: Finding) -> FittedLaw:
    """The law that describes what has no name."""
    assert found.verdict == "unexplained"
    assert found.last.law is not None
    return found.last.law


@pytest.mark.slow
def test_a_linkage_between_two_joints_is_told_with_both_angles() -> None:
    table = experiment()
    angles = np.zeros_like(table.q)
    angles[:, 2] = 1e-4 * np.sin(2 * table.q[:, 1]) * np.cos(table.q[:, 2])
    found = diagnosed(table, positions(table, angles))
    law = law_of(found)
    assert law.virtual_joint == "joint 3"
    assert "cos(q3)*sin(2*q2)" in law.expression
    assert "·cos(q3)·sin(2·q2)" in sentence(found)


@pytest.mark.slow
def test_a_joint_that_runs_out_of_round_as_it_warms_up_is_told_with_time() -> None:
    """A transmission error that is not there when the session begins has no name in the catalogue."""
    table = experiment()
    began, took = float(table.time.min()), float(np.ptp(table.time))
    assert took > 0
    angles = np.zeros_like(table.q)
    warm = 1.0 - np.exp(-2.0 * (table.time - began) / took)
    angles[:, 2] = 2e-4 * warm * np.sin(table.q[:, 2] + 0.4)
    law = law_of(diagnosed(table, positions(table, angles)))
    assert law.virtual_joint == "joint 3"
    assert "time*sin(q3)" in law.expression


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


def test_readings_that_bend_or_are_not_square_are_laws_wherever_the_device_stands() -> None:
    table = experiment()
    seen = positions(table) + np.array([2.0, -1.0, 0.5])
    found = assemble(complete("ur10"), filled(table, seen), effects=())
    state, component = found.situation.view.state, found.situation.view.component
    laws = {law.title: law.values for law in found.problem.devices if law.place == "measuring device"}
    stretched = 1e-5 * seen @ [[1.0, 0.2, 0.0], [0.2, -0.5, 0.1], [0.0, 0.1, 0.3]]
    square = laws["scale error along a direction"] @ [10.0, 2.0, 0.0, -5.0, 1.0, 3.0]
    assert square == pytest.approx(stretched[state, component], abs=1e-12)
    away = seen - [3.0, 1.0, 0.0]
    bent = np.zeros_like(seen)
    bent[:, 2] = 1e-5 * np.sum(away**2, axis=1)
    left = outside(
        bent[state, component], np.column_stack([laws["vertical error by the place"], found.problem.A])
    )
    assert np.linalg.norm(left) < 1e-3 * np.linalg.norm(outside(bent[state, component], found.problem.A))


@pytest.mark.slow
def test_a_tracker_whose_rays_bend_is_no_soft_base() -> None:
    table = experiment()
    seen = positions(table)
    seen[:, 2] += 2e-5 * np.sum((seen - [3.0, -2.0, 1.2]) ** 2, axis=1)
    found = diagnosed(table, seen)
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.terms[0][0].startswith("vertical error by the place")
