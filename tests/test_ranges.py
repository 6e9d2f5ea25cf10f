"""What follows the size of an experiment: physical ranges, the catalogue's for industrial arms, and digits."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from functools import cache
from io import StringIO
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from symstiff.calibration.experiment.situation import look
from symstiff.calibration.identify import identify
from symstiff.calibration.rows import predict
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.cli.diagnose import _print
from symstiff.discrepancy.bridge.ranges import Extent, at_size, extent_of
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.remarks import remarked
from symstiff.discrepancy.findings.result import Quantity
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.base import Scales
from symstiff.effects.registry import catalogue
from symstiff.report.html import _steps
from symstiff.report.residuals import draw_residuals
from symstiff.robot import load
from symstiff.robot.loading import from_table
from symstiff.robot.schema import Robot
from symstiff.robot.table import to_table
from tests.diagnosis_data import HARDENING, ROBOT, measured

LENGTHS = {"a", "d", "xyz", "com"}
ORDINARY = {
    "abb_irb6640": 2000.0, "franka_panda": 30.0, "kuka_kr240": 2400.0, "kuka_kr270": 2700.0, "planar2r": 40.0,
    "puma560": 25.0, "scara": 20.0, "ur10": 100.0, "ur5e": 50.0,
}  # fmt: skip
"""Loads [N] of the library's robots: about their payloads."""


def scaled(part: Any, by: Fraction) -> Any:
    """A robot file's table with its lengths times a factor."""
    if isinstance(part, list):
        return [scaled(p, by) for p in part]
    if not isinstance(part, dict):
        return part
    return {k: _times(v, by) if k in LENGTHS else scaled(v, by) for k, v in part.items()}


def _times(length: Any, by: Fraction) -> Any:
    return [_times(x, by) for x in length] if isinstance(length, list) else str(Fraction(length) * by)


def at(length: float, force: float) -> tuple[Robot, Measurements]:
    """The planar arm with a gear that hardens, all its lengths and loads times factors: its angles are the same."""
    table = measured(HARDENING)
    robot = from_table(scaled(to_table(load(ROBOT)), Fraction(str(length))), ROBOT)
    turns = np.repeat([length, 1.0], 3)
    loads = np.repeat([force, force * length], 3)
    return robot, replace(table, w=table.w * loads, values=table.values * turns, sigma=table.sigma * turns)


@cache
def found(length: float, force: float) -> Finding:
    return diagnose(Task(*at(length, force)))


@pytest.mark.slow
@pytest.mark.parametrize(("length", "force"), [(0.04, 0.01), (0.25, 0.01), (10.0, 1000.0)])
def test_an_arm_of_another_size_gets_the_same_name(length: float, force: float) -> None:
    usual, other = found(1.0, 1.0), found(length, force)
    assert usual.verdict == other.verdict == "named"
    (one,), (two,) = usual.named, other.named
    assert (
        (one.effect, dict(one.where))
        == (two.effect, dict(two.where))
        == ("nonlinear_stiffness", {"joint": 2})
    )
    size, small = one.parameters["nonlinear_stiffness_2_c"], two.parameters["nonlinear_stiffness_2_c"]
    assert small.value * length * force == pytest.approx(size.value, rel=0.01)
    assert not any("physical" in r for r in other.remarks)


@pytest.mark.parametrize("name", sorted(ORDINARY))
@pytest.mark.parametrize("share", [0.5, 1.0])
def test_no_range_of_an_industrial_arm_changes(name: str, share: float) -> None:
    robot = load(name)
    limits = np.array([j.range for j in robot.joint])
    q = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (20, robot.dof))
    w = np.tile([0.0, 0.0, -share * ORDINARY[name], 0.0, 0.0, 0.0], (20, 1))
    extent = extent_of(look(robot, measurements(q, w, kind="deflection", values=np.zeros((20, 6)))))
    assert extent.torque > 0.0
    for effect in catalogue().values():
        for where in effect.places(robot):
            for shape in effect.shapes(robot, where, Scales(context={"time": 60.0}))[:1]:
                parameters = effect.realise(robot, where, shape).parameters
                assert at_size(parameters, extent) == parameters


@pytest.mark.parametrize(
    ("extent", "unit", "factor"),
    [
        (Extent(0.05, 1.0, 0.05), "rad/(N*m)", 100.0),  # 0.05 rad under 5 N·m, or under 0.05 N·m
        (Extent(0.05, 0.1, 0.05), "m/N", 50.0),
        (Extent(0.05, 0.1, 0.05), "rad/N", 50.0),
        (Extent(0.05, 0.1, 0.05), "N", 1.0),
        (Extent(2e6, 1e5, 39.0), "N", 20.0),
        (Extent(2e6, 1e5, 39.0), "N*m", 100.0),
        (Extent(2e6, 1e5, 40.0), "m", 10.0),
        (Extent(2e6, 1e5, 39.0), "rad/(N*m)", 1.0),
        (Extent(2e6, 1e5, 39.0), "rad", 1.0),
        (Extent(), "rad/(N*m)", 1.0),
    ],
)
def test_a_range_is_wider_by_what_the_experiment_is_smaller_or_larger(
    extent: Extent, unit: str, factor: float
) -> None:
    assert extent.factor(unit) == pytest.approx(factor)


@pytest.mark.parametrize(("value", "told"), [(0.05, True), (0.0101, False), (0.005, False), (-0.05, True)])
def test_what_would_lead_but_for_its_size_is_said_to(value: float, told: bool) -> None:
    """Physical up to 0.01 rad/(N·m) here; told from two standard deviations on."""
    usual = found(1.0, 1.0)
    lead = next(c for c in usual.last.candidates if c.effect == "nonlinear_stiffness")
    size = {"nonlinear_stiffness_2_c": Quantity(value, 1e-4, "rad/(N*m)")}
    lead = replace(lead, parameters=size, plausible=not told)
    last = replace(usual.last, verdict="unexplained", candidates=(lead,))
    remarks = [r for r in remarked(usual.assembly.situation.view, last) if "would lead" in r]
    assert len(remarks) == told
    assert all("0.0100 rad/(N·m)" in r or "0.01 rad/(N·m)" in r for r in remarks)


def test_residuals_of_a_small_arm_are_printed_with_digits() -> None:
    small = found(0.04, 0.01)
    printed = StringIO()
    _print(Console(file=printed, width=200), small, "")
    last = small.steps[-1].residual
    view = small.assembly.situation.view
    seen = np.zeros((len(view.table), 3))
    seen[view.state, view.component] = last
    rms = f"{1e3 * np.sqrt(np.mean(np.sum(seen**2, axis=1))):.2g}"
    assert float(rms) < 0.01
    assert f" {rms} " in printed.getvalue()
    assert any(rms in row["cells"] for row in _steps(small)["rows"])


def test_the_picture_of_an_identification_tells_small_residuals() -> None:
    robot, table = at(0.01, 0.01)
    result = identify(robot, table)
    left = 1e3 * (table.values - predict(result.model, table))[:, :3]
    rms = np.sqrt(np.nanmean(left**2, axis=0))
    assert np.all(rms < 5e-3)
    titles = [axes.get_title() for axes in draw_residuals(result).axes[:3]]
    assert titles == [f"{name}: RMS {size:.2g} mm" for name, size in zip("xyz", rms, strict=True)]
