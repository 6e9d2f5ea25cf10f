"""Effects whose size follows something that their law does not depend on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.readings import experiment_of
from symstiff.calibration.identify import start_model
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.constancy import inconstancies
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.findings.result import Inconstancy
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.workflow import diagnose, first_assembly
from symstiff.report.verdict import verdict_table
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured


def changing(by: str, amount: float, a: float, seed: int = 3) -> Measurements:
    """A joint that hardens, by an amount more or less with something."""
    plain = measured(seed=seed, poses=14)
    whole = measured(HARDENING | {"a": a}, seed=seed, poses=14)
    follows = {"q1": np.sin(whole.q[:, 0]), "order": np.linspace(-1.0, 1.0, len(whole))}[by]
    size = 1.0 + amount * follows[:, None]
    return replace(whole, values=plain.values + size * (whole.values - plain.values))


def found_of(table: Measurements) -> tuple[Inconstancy, ...]:
    """What the size of the uneven stiffness follows once that is in the model, whatever else may lead."""
    model, _ = start_model(load(ROBOT), "complete", experiment_of(table, load(ROBOT)))
    assembly = first_assembly(model, table)
    ready = prepare(assembly.problem, assembly.candidates)
    entry = evidence(ready.scan).best_entry[ready.bank.named["nonlinear_stiffness@joint=2"]]
    return inconstancies(assembly.problem, ready, [int(entry)])


@pytest.mark.parametrize("by", ["q1", "order"])
def test_what_a_size_follows_is_found_with_how_far_it_does(by: str) -> None:
    first = found_of(changing(by, 0.6, 1e-4))[0]
    assert (first.name.effect, first.name.where, first.by) == ("nonlinear_stiffness", {"joint": 2}, by)
    assert first.p_value < 1e-6
    assert 0.03 < first.share < 0.5
    assert first.high - first.low == pytest.approx(1.2, abs=0.4)


@pytest.mark.parametrize("seed", [3, 5, 7, 9])
def test_one_size_follows_nothing(seed: int) -> None:
    assert found_of(changing("q1", 0.0, 1e-4, seed)) == ()


def test_a_named_effect_without_one_size_is_told_and_less_sure() -> None:
    found = diagnose(Task(load(ROBOT), changing("q1", 0.5, 3e-5)))
    leading = found.effects[0]
    assert (leading.effect, dict(leading.where)) == ("nonlinear_stiffness", {"joint": 2})
    assert leading.confidence <= 0.75
    remark = next(r for r in found.remarks if "no one size" in r)
    assert remark.startswith(
        "nonlinear stiffness at joint 2 has no one size in these data: it runs from 0.6 to 2.1"
    )
    assert "with the position of joint 1 (p = 0.002" in remark
    told = verdict_table(found)["inconstant"]
    assert [(one["effect"], one["where"], one["by"]) for one in told] == [
        ("nonlinear_stiffness", {"joint": 2}, "q1")
    ]


def sessions(*sizes: float) -> Measurements:
    """Files of one pose after another, each with a size of its own of the same effect."""
    plain, whole = measured(seed=3, poses=14), measured(HARDENING | {"a": 1e-4}, seed=3, poses=14)
    file = (whole.pose >= len(whole.labels) // 2).astype(np.intp)
    size = np.array(sizes)[file][:, None]
    values = plain.values + size * (whole.values - plain.values)
    return replace(whole, values=values, file=file, files=("may.csv", "june.csv"))


def test_a_size_that_changed_between_files_is_told_for_each() -> None:
    first = found_of(sessions(0.5, 1.5))[0]
    assert first.by == "file"
    assert dict(first.each) == pytest.approx({"may.csv": 0.5, "june.csv": 1.5}, abs=0.15)
    assert not any(one.by == "file" for one in found_of(sessions(1.0, 1.0)))


def test_a_named_effect_that_changed_between_files_is_told_with_what_to_do_next() -> None:
    found = diagnose(Task(load(ROBOT), sessions(0.9, 1.15)))
    assert found.verdict == "named"
    (told,) = (r for r in found.remarks if "diagnose each by itself" in r)
    assert "has no one size in these files" in told
    assert set(verdict_table(found)["inconstant"][0]["files"]) == {"may.csv", "june.csv"}


@pytest.mark.slow
def test_where_files_differ_too_much_for_a_name_they_are_to_be_diagnosed_each() -> None:
    found = diagnose(Task(load(ROBOT), sessions(0.3, 1.7)))
    assert found.verdict == "unexplained"
    (told,) = (r for r in found.remarks if "diagnose each by itself" in r)
    assert "these are several files" in told
