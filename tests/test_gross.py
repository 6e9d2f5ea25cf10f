"""Gross errors: a single reading that is far off is left out and told, and what is missing is found without it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.tables.measurements import Measurements
from symstiff.calibration.tables.table import read_table
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.gross import gross, in_usual
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured, saved

SIGMA = 2e-5


def off(table: Measurements, rows: list[int], size: float) -> Measurements:
    values = np.array(table.values)
    values[rows, :3] += size * SIGMA * np.array([1.0, -1.0, 1.0])
    return replace(table, values=values)


def diagnosed(table: Measurements) -> Finding:
    return diagnose(Task(load(ROBOT), table))


def left_out(found: Finding) -> list[str]:
    return [r for r in found.remarks if "left out" in r]


def test_a_gear_is_named_beside_a_reading_that_is_off(tmp_path: Path) -> None:
    clean = measured(HARDENING)
    table = read_table(saved(off(clean, [40], 25.0), tmp_path / "data.csv"))
    found, without = diagnosed(table), diagnosed(clean)
    assert [(e.effect, dict(e.where)) for e in found.named] == [("nonlinear_stiffness", {"joint": 2})]
    (said,) = left_out(found)
    assert "data.csv: line 42" in said
    assert "It is left out" in said
    assert len(found.table) == len(clean) - 1
    for name, value in without.model.values.items():
        assert found.model.values[name] == pytest.approx(value, abs=without.model.deviations[name])
    assert left_out(without) == []


def test_two_readings_are_left_out_though_one_hides_behind_the_other() -> None:
    found = diagnosed(off(off(measured(), [40], 400.0), [101], 20.0))
    assert found.verdict == "nothing_missing"
    assert len(found.table) == len(measured()) - 2


@pytest.mark.parametrize("hidden", [(), (HARDENING,)])
def test_a_tenth_of_the_readings_may_be_off_where_they_are_scattered(
    hidden: tuple[dict[str, object], ...], tmp_path: Path
) -> None:
    """They drag the fit, so that few of them stand out at first."""
    rng = np.random.default_rng(6)
    rows = np.sort(rng.choice(150, 10, replace=False)).tolist()
    clean = measured(*hidden)
    values = np.array(clean.values)
    values[rows, :3] += rng.choice([-1, 1], (10, 3)) * rng.uniform(12, 40, (10, 1)) * SIGMA
    found = diagnosed(read_table(saved(replace(clean, values=values), tmp_path / "data.csv")))
    assert [(e.effect, dict(e.where)) for e in found.named] == [(h["effect"], h["where"]) for h in hidden]
    assert len(found.table) == 140
    assert sorted(set(range(2, 152)) - set(found.table.line.tolist())) == [row + 2 for row in rows]
    assert all("data.csv: lines " in said for said in left_out(found))


def test_a_pose_that_is_off_as_a_whole_is_an_effect_and_no_slip() -> None:
    table = measured()
    found = diagnosed(off(table, np.flatnonzero(table.pose == 3).tolist(), 25.0))
    assert [(e.effect, dict(e.where)) for e in found.named] == [("bad_poses", {"rows": ["p4"]})]
    assert len(found.table) == len(table)


def test_how_far_off_is_counted_in_stated_sigmas() -> None:
    """Far from a tracker readings scatter more: eight times the others' residual there is twice the usual one."""
    view = diagnosed(measured()).assembly.situation.view
    sigma = np.full(view.table.values.shape, SIGMA)
    sigma[40] *= 4.0
    far = replace(view, table=replace(view.table, sigma=sigma))
    size = np.full(len(view.state), SIGMA)
    size[view.state == 40] *= 8.0
    assert in_usual(far, size)[40] == pytest.approx(2.0 * in_usual(far, size)[0])


def test_what_lies_within_the_stated_deviation_is_no_gross_error() -> None:
    """Where few rows are left to fit, the usual residual is small, and half a stated sigma many times that."""
    found = diagnosed(measured())
    noise = 0.05 * SIGMA * np.random.default_rng(5).normal(size=len(found.assembly.problem.y))
    noise[7] += SIGMA
    assert not len(gross(_leaving(found, noise)))
    noise[7] += 4 * SIGMA
    assert gross(_leaving(found, noise)).tolist() == [7 // 3]


def test_noise_has_no_gross_errors_and_many_of_them_are_something_else() -> None:
    found = diagnosed(measured())
    rows = len(found.assembly.problem.y)
    rng = np.random.default_rng(5)
    step = found.last.growth[-1]
    for _ in range(200):
        noise = SIGMA * rng.normal(size=rows)
        assert not len(gross(_leaving(found, noise)))
    noise = SIGMA * rng.normal(size=rows)
    many = noise.copy()
    many[np.arange(0, rows, 45)] += 40 * SIGMA  # one row of every pose
    assert len(step.residual) == rows
    assert not len(gross(_leaving(found, many)))
    noise[7] += 40 * SIGMA
    assert gross(_leaving(found, noise)).tolist() == [7 // 3]


def _leaving(found: Finding, residual: np.ndarray) -> Finding:
    growth = (*found.last.growth[:-1], replace(found.last.growth[-1], residual=residual))
    return replace(found, last=replace(found.last, growth=growth))
