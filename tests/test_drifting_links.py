"""A link that warms on one side bends: it turns what it carries, and no other effect is named for it."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load
from tests.test_assemble import design

ROBOT = "ur10"


def diagnosed(values: dict[str, object], kind: str = "deflection") -> Finding:
    robot = load(ROBOT)
    drift = Effect("thermal_drift", {"link": 2}, "link_time", values)
    truth = Truth(robot, nominal_truth(robot), (drift,), Noise((0.03, 0.03, 0.03)))
    return diagnose(Task(robot, simulate(truth, design(ROBOT, kind), 5)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["deflection", "absolute"])
def test_a_link_that_bends_as_it_warms_is_named_with_its_turn(kind: str) -> None:
    table = design(ROBOT, kind)
    span = float(np.ptp(table.time))
    found = diagnosed({"rate": [1e-4 / span, 0, 0], "turn": [0, 6e-4 / span, -4e-4 / span]}, kind)
    assert found.verdict == "named"
    (effect,) = found.named
    assert (effect.effect, effect.where) == ("thermal_drift", {"link": 2})
    assert "bends" in effect.shape
    assert effect.parameters["thermal_drift_2_ry"].value == pytest.approx(6e-4, rel=0.35)
    assert "bending as well" in effect.instance.shape_phrases(load(ROBOT))


@pytest.mark.slow
def test_a_link_that_grows_alone_is_not_said_to_bend() -> None:
    span = float(np.ptp(design(ROBOT, "deflection").time))
    found = diagnosed({"rate": [4e-4 / span, 2e-4 / span, -3e-4 / span]})
    (effect,) = found.named
    assert (effect.effect, effect.where) == ("thermal_drift", {"link": 2})
    assert "bends" not in effect.shape
