"""What a diagnosis says of the noise: markers, shared errors, a stated sigma, repeats that are copies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.identify import identify
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.findings.remarks import _of_approach
from symstiff.discrepancy.noise.sharing import AXES, JOINTS
from symstiff.discrepancy.workflow import diagnose
from symstiff.report import sizes, words
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured


def test_a_marker_that_scatters_more_is_told() -> None:
    table = measured()
    values = table.values.copy()
    values[table.point == 1, :3] += 4e-5 * np.random.default_rng(8).normal(size=(np.sum(table.point == 1), 3))
    found = diagnose(Task(load(ROBOT), replace(table, values=values)))
    assert found.verdict == "nothing_missing"
    assert found.last.noise.by_marker["p2"] == pytest.approx(np.sqrt(5.0), rel=0.25)
    assert any("marker p2 scatters" in r for r in found.remarks)
    assert not any("scatters" in r for r in diagnose(Task(load(ROBOT), measured())).remarks)


@pytest.mark.slow
def test_an_error_that_a_poses_rows_share_is_told_where_it_exceeds_the_noise() -> None:
    table = measured(poses=16)
    values = table.values.copy()
    values[:, :3] += 6e-5 * np.random.default_rng(2).normal(size=(16, 3))[table.pose]
    found = diagnose(Task(load(ROBOT), replace(table, values=values)))
    assert found.verdict == "nothing_missing"
    assert found.last.noise.approach == pytest.approx(6e-5, rel=0.3)
    assert any("share an error" in r for r in found.remarks)
    assert words.headline(found).startswith("Nothing found missing")
    assert words.headline(diagnose(Task(load(ROBOT), measured()))) == "Nothing is missing"


def test_where_an_effect_may_hide_the_headline_does_not_say_that_nothing_is_missing() -> None:
    """Beyond doubt joints stand elsewhere in each pose: stiffer in a few, they would look like that."""
    found = diagnose(Task(load(ROBOT), measured()))
    for shared, size, p, hides in (
        (JOINTS, 0.5, 1e-9, True), (JOINTS, 0.5, 0.1, False), (JOINTS, 0.1, 1e-9, False), (AXES, 0.5, 1e-9, False)
    ):  # fmt: skip
        noise = replace(found.last.noise, shared=shared, approach=size * found.last.noise.sigma, approach_p=p)
        told = words.headline(replace(found, last=replace(found.last, noise=noise)))
        assert told == (
            "Nothing found missing; something may hide in an error that a pose's rows share"
            if hides
            else "Nothing is missing"
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "probability", "shared", "told"),
    [
        ("absolute", 1e-6, AXES, "repeatability"),
        ("absolute", 0.02, AXES, ""),
        ("deflection", 1e-6, AXES, "as one reading without load in each pose"),
        (
            "deflection",
            1e-6,
            JOINTS,
            "as if the joints had stopped beside their targets: the robot's repeatability",
        ),
        ("deflection", 0.02, JOINTS, ""),
    ],
)
def test_a_sure_shared_error_is_told(kind: str, probability: float, shared: str, told: str) -> None:
    """In deflections one of the axes is the reading without load, which all load cases share."""
    last = diagnose(Task(load(ROBOT), measured())).last
    assert last.verdict == "nothing_missing"
    noise = replace(last.noise, approach=0.6 * last.noise.sigma, approach_p=probability, shared=shared)
    remarks = _of_approach(replace(measured(), kind=kind), replace(last, noise=noise))  # type: ignore[arg-type]
    assert [("0.6 times the noise" in r and told in r) for r in remarks] == [True] * bool(told)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stated", "wrong"), [(2e-5, False), (2.83e-5, False), (4.5e-5, True), (1.4e-5, True)]
)
def test_a_sigma_that_counts_the_reading_without_load_is_right(stated: float, wrong: bool) -> None:
    """Each reading of 0.02 mm: a deflection varies by 0.028 mm, of which its pose shares a half."""
    table = measured(poses=20)
    values = table.values.copy()
    unloaded = 2e-5 * np.random.default_rng(5).normal(size=(20, 3, 3))
    values[:, :3] -= unloaded[table.pose, table.point]
    sigma = np.where(table.measured, stated, np.nan)
    found = diagnose(Task(load(ROBOT), replace(table, values=values, sigma=sigma)))
    assert found.verdict == "nothing_missing"
    assert found.last.noise.misstated == wrong
    assert any("times the stated sigma" in r for r in found.remarks) == wrong
    assert ("times the stated sigma" in words.sentence(found)) == (stated == 1.4e-5)
    told = " ".join(sizes.noise_lines(found))
    assert ("if the stated one counts the reading without load" in told) == (stated == 2.83e-5)


@pytest.mark.slow
def test_an_error_that_exceeds_the_noise_is_told_whatever_is_named() -> None:
    table = measured(HARDENING, poses=16)
    values = table.values.copy()
    values[:, :3] += 6e-5 * np.random.default_rng(2).normal(size=(16, 3))[table.pose]
    found = diagnose(Task(load(ROBOT), replace(table, values=values)))
    assert [e.effect for e in found.named] == ["nonlinear_stiffness"]
    assert any("share an error" in r for r in found.remarks)


def thrice(table: Measurements, noise: float) -> Measurements:
    """Every row with two repeats, of noise of their own [m] or, without, copies."""
    rows = np.tile(np.arange(len(table)), 3)
    values = table.values[rows] + noise * np.random.default_rng(5).normal(size=(len(rows), 6))
    return replace(table.select(rows), values=values, repeat=np.repeat([1.0, 2.0, 3.0], len(table)))


@pytest.mark.slow
def test_repeats_that_are_copies_say_nothing_of_the_noise() -> None:
    once = measured(HARDENING)
    once = replace(once, sigma=np.full_like(once.sigma, np.nan))
    copied = thrice(once, 0.0)
    alone, found = (diagnose(Task(load(ROBOT), table)) for table in (once, copied))
    assert (found.verdict, found.rms) == (alone.verdict, alone.rms)
    (told,) = [r for r in found.remarks if "copies" in r]
    assert told.startswith(f"{2 * len(once)} of {2 * len(once)} repeats")
    fitted = identify(load(ROBOT), copied)
    assert fitted.fit.dof == identify(load(ROBOT), once).fit.dof
    assert told in fitted.remarks
    honest = diagnose(Task(load(ROBOT), thrice(once, 2e-5)))
    assert honest.last.noise.source == "repeats"
    assert not any("copies" in r for r in honest.remarks)


def test_noise_that_nothing_checks_is_said_to_be_so() -> None:
    assert any("nothing checks it" in r for r in diagnose(Task(load(ROBOT), measured(stated=0.0))).remarks)
    assert not any("nothing checks it" in r for r in diagnose(Task(load(ROBOT), measured())).remarks)
