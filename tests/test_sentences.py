"""What the sentence and the remarks of a verdict say where names, places or the code are not all of it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.rows import predict
from symstiff.calibration.simulation.experiment import simulate
from symstiff.calibration.simulation.truth import truth_from_table
from symstiff.discrepancy.conclusion import _beyond_code
from symstiff.discrepancy.finding import Finding, Task
from symstiff.discrepancy.result import Name
from symstiff.discrepancy.strata import Stratum
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.report import words
from symstiff.report.folder import write_report
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, design, measured


@pytest.fixture(scope="module")
def found() -> Finding:
    return diagnose(Task(load(ROBOT), measured(HARDENING)))


@pytest.mark.parametrize(("p_time", "alone"), [(7e-4, True), (0.02, False)])
def test_no_place_is_accused_where_one_stratum_alone_rejects(
    p_time: float, alone: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As noise that follows itself makes it: tests of laws see nothing, and no law is fitted to what is none."""
    strata = (Stratum("time", 18, 50.0, 2.8, p_time), Stratum("nonlinear in load", 40, 41.0, 1.0, 0.6))
    monkeypatch.setattr("symstiff.discrepancy.examine.strata", lambda *_: strata)
    said = diagnose(Task(load(ROBOT), measured()))
    assert said.verdict == ("unexplained" if alone else "nothing_missing")
    assert words.headline(said).startswith("More is left than independent noise") == alone
    assert ("holds more than noise (time: p = 0.0007" in words.sentence(said)) == alone
    if alone:
        assert (said.last.law, said.last.device_law) == (None, None)
        verdict = write_report(said, tmp_path / "out").verdict
        assert verdict["accused"] is None
        assert "strongest" not in verdict["sentence"] + (tmp_path / "out" / "report.html").read_text()


def test_what_the_data_hardly_tell_from_a_named_effect_is_told_once(found: Finding) -> None:
    (gear,) = found.named
    like = Name("backlash", {"joint": 2})
    told = words.sentence(replace(found, effects=(replace(gear, confounded_with=(like,)),)))
    assert "These data hardly tell nonlinear stiffness at joint 2 from backlash at joint 2." in told
    other = replace(gear, effect="backlash", where={"joint": 2}, set_number=1)
    beside = replace(found, effects=(replace(gear, confounded_with=(like,)),), alternatives=(other,))
    assert "hardly tell" not in words.sentence(beside)
    assert "not excluded: backlash at joint 2" in words.sentence(beside)
    assert "hardly tell" not in words.sentence(replace(found, effects=(replace(gear, confounded_with=()),)))


def test_what_the_code_leaves_of_a_large_deflection_is_told_in_millimetres() -> None:
    """The model's deflections are those of the unloaded pose: what they miss is in the data, whatever was found."""
    model = StiffnessModel.of(reduce(load(ROBOT), "wrench", "pose"))
    model = model.with_values(dict.fromkeys(model.parameters, 2e-4))
    grown = model.with_effect(EffectInstance("large_deflection", {"robot": "all"}))
    table = simulate(
        truth_from_table({"format": 1, "robot": ROBOT, "noise": {"sigma_mm": 0.02}}), design(), 1
    )
    missed = (table.values - predict(model, table))[:, :3]
    (told,) = _beyond_code(grown, table, 2e-5)
    size = 1e3 * np.sqrt(np.mean(missed[table.measured[:, :3]] ** 2))
    assert float(re.findall(r"leave ([\d.]+) mm rms", told)[0]) == pytest.approx(size, rel=1e-3)
    assert _beyond_code(grown, table, 1e-3 * size) == []  # it leaves no more than with it
    assert _beyond_code(model, table, 2e-5) == []
