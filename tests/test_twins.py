"""Effects at two places with the same columns are one explanation, told with both names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.report import words
from symstiff.report.verdict import effect_table
from symstiff.robot import load
from tests.test_assemble import design


@pytest.fixture(scope="module")
def finding() -> Finding:
    """A SCARA whose third link grows with time; the slide before it keeps its frame parallel to the second's."""
    robot = load("scara")
    drift = Effect("thermal_drift", {"link": 3}, "link_time", {"rate": [2e-6, -1e-6, 1e-6]})
    truth = Truth(robot, nominal_truth(robot), (drift,), Noise((0.03, 0.03, 0.03)))
    return diagnose(Task(robot, simulate(truth, design("scara", "deflection"), 5)))


def test_the_verdict_is_named_and_not_ambiguous(finding: Finding) -> None:
    assert finding.verdict == "named"
    (effect,) = finding.named
    assert effect.effect == "thermal_drift"
    links = {effect.where["link"], *(n.where["link"] for n in effect.twins)}
    assert links == {2, 3}
    assert {n.where.get("link") for n in effect.confounded_with} >= links - {effect.where["link"]}


def test_the_sentence_has_both_names(finding: Finding) -> None:
    text = words.sentence(finding)
    assert all(part in text for part in ("link 2", "link 3", "no data tell them apart"))


def test_a_drift_is_told_with_the_time_that_it_takes(finding: Finding) -> None:
    (effect,) = finding.named
    span = effect.shape["time"]
    assert span == pytest.approx(np.ptp(finding.table.time), rel=5e-3)
    assert f"(over {span:.4g} s: thermal_drift_" in words.sentence(finding)
    assert effect_table(effect)["sizes_over"] == {"time": span}
    warm = replace(effect, shape={"temperature": 5.28, "reference": 20.0})
    assert "(per 5.28 K: thermal_drift_" in words.sentence(replace(finding, effects=(warm,)))
    gear = EffectInstance("nonlinear_stiffness", {"joint": 1}, {"tau0": 5.0})
    assert gear.span_phrases(load("scara")) == ()
