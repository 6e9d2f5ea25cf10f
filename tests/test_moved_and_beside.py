"""A target that moved once, and a load that does not act where the table says: neither has a name, both are found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.arrays import Array
from symstiff.calibration.simulation.experiment import simulate
from symstiff.calibration.simulation.truth import truth_from_table
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.noise.scales import start
from symstiff.discrepancy.noise.sharing import Split
from symstiff.discrepancy.search.proof import _predict
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.workflow import diagnose
from symstiff.report import words
from symstiff.robot import load
from tests.diagnosis_data import ROBOT, design, measured
from tests.test_discrepancy_engine import arm
from tests.test_discrepancy_engine import measured as noisy

SHIFT = np.array([6e-5, -4e-5, 5e-5])


def diagnosed(table: Measurements) -> Finding:
    return diagnose(Task(load(ROBOT), table))


def in_tool(table: Measurements, vector: Array) -> Array:
    """(N, 3) a vector of the planar arm's tool in base axes: its joints turn about one axis."""
    c, s = np.cos(table.q.sum(axis=1)), np.sin(table.q.sum(axis=1))
    return np.column_stack([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], 0 * c + vector[2]])


@pytest.mark.slow
@pytest.mark.parametrize("flange", [True, False])
def test_what_moved_once_is_accused_with_its_time_and_way(flange: bool) -> None:
    """The targets on the flange, between two poses; or the device."""
    table = measured(poses=14)
    moved = in_tool(table, SHIFT) if flange else np.tile(SHIFT, (len(table), 1))
    values = table.values.copy()
    values[:, :3] += (table.pose >= 6)[:, None] * moved
    found = diagnosed(replace(table, values=values))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == ("flange" if flange else "measuring device")
    assert [value for _, value, _, _ in law.terms] == pytest.approx(SHIFT, abs=1.5e-5)
    axes = "tool" if flange else "device"
    assert f"a shift from 43 % of the session on in the {axes}'s axes" in words.sentence(found)


@pytest.mark.slow
@pytest.mark.parametrize("of_tool", [True, False])
@pytest.mark.parametrize("grows", [True, False])
def test_a_load_beside_its_point_is_accused_with_its_lever(of_tool: bool, grows: bool) -> None:
    told, lever = design(poses=14), np.array([0.02, 0.05, -0.03])
    share = np.linalg.norm(told.w[:, :3], axis=1)
    share /= share.max()
    arms = (in_tool(told, lever) if of_tool else np.tile(lever, (len(told), 1))) * (
        share[:, None] if grows else 1.0
    )
    w = told.w + np.hstack([0 * arms, np.cross(arms, told.w[:, :3])])
    truth = truth_from_table({"format": 1, "robot": ROBOT, "noise": {"sigma_mm": 0.02}})
    found = diagnosed(replace(simulate(truth, replace(told, w=w), 3), w=told.w))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "force sensor"
    assert ("tool's" if of_tool else "base's") in law.terms[0][0]
    assert ("growing" in law.terms[0][0]) == grows
    for (_, value, deviation, _), hidden in zip(law.terms, lever, strict=True):
        assert abs(value - hidden) < 3 * deviation < 0.06


@pytest.mark.slow
def test_a_pose_under_another_load_is_accused_with_what_it_lacks() -> None:
    """A weight that was not put on: a seventh of the load in one pose."""
    told = design(poses=14)
    w = told.w * np.where(told.pose == 5, 6 / 7, 1.0)[:, None]
    truth = truth_from_table({"format": 1, "robot": ROBOT, "noise": {"sigma_mm": 0.02}})
    found = diagnosed(replace(simulate(truth, replace(told, w=w), 3), w=told.w))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == f"pose {told.labels[5]}"
    ((_, value, deviation, _),) = law.terms
    assert abs(value + 100 / 7) < 3 * deviation < 6
    assert found.accused == law.place
    assert f"pose {told.labels[5]}, where a load that differs (" in words.sentence(found)


@pytest.mark.slow
def test_a_device_that_reads_too_much_along_its_beam_is_accused_with_its_gain() -> None:
    table, beam = measured(poses=14), np.array([0.6, 0.64, 0.48])
    values = table.values.copy()
    values[:, :3] += 0.06 * (values[:, :3] @ beam)[:, None] * beam
    found = diagnosed(replace(table, values=values))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "measuring device"
    gain = dict(zip(("xx", "xy", "xz", "yy", "yz"), law.terms, strict=True))
    assert gain["xx"][0].endswith("xx beyond the mean")
    assert gain["xy"][1] == pytest.approx(100 * 0.06 * beam[0] * beam[1], abs=3 * gain["xy"][2])
    assert gain["xx"][1] == pytest.approx(100 * 0.06 * (beam[0] ** 2 - 1 / 3), abs=3 * gain["xx"][2])


def test_poses_that_hardly_show_an_effect_predict_nothing_of_it() -> None:
    """A column of rounding errors in the poses that are used, and of its full size in the others."""
    bare = arm(12).problem
    problem = noisy(bare, np.zeros(bare.rows))
    column = np.where(problem.pose < 8, 1e-14 * np.sin(np.arange(problem.rows)), 1.0)[:, None]
    noise = prepare(problem, ()).scan.noise
    train, test = np.flatnonzero(problem.pose < 8), np.flatnonzero(problem.pose >= 8)
    alone = _predict(problem, noise, train, test, [])
    assert _predict(problem, noise, train, test, [column]) == pytest.approx(
        alone, abs=1e-3 * np.abs(alone).max()
    )


def test_what_the_poses_hardly_show_is_drawn_to_zero_as_far_as_its_noise_demands() -> None:
    """By hand: least squares, and zero beside each column of unit length as sure as the noise is below the signal."""
    problem = noisy(arm(12).problem)
    train, test = np.flatnonzero(problem.pose < 8), np.flatnonzero(problem.pose >= 8)
    column = np.where(problem.pose < 8, 1e-3, 1.0) * np.sin(np.arange(problem.rows))
    X = np.column_stack([problem.A, column])
    X /= np.linalg.norm(X, axis=0)
    width, y = X.shape[1], problem.y
    plain, (left,), _, _ = np.linalg.lstsq(X[train], y[train], rcond=None)
    signal = (y[train] @ y[train] - left) / width
    sure = np.sqrt(left / (len(train) - width) / signal) * np.eye(width)
    drawn = np.linalg.lstsq(np.vstack([X[train], sure]), np.append(y[train], np.zeros(width)), rcond=None)[0]
    assert abs(drawn[-1]) < 0.3 * abs(plain[-1])
    found = _predict(problem, start(problem, Split()), train, test, [column[:, None]])
    assert found == pytest.approx(y[test] - X[test] @ drawn, rel=1e-6)
