"""Names of one thing are one explanation; two things that give the same columns are two, and none is the surer."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.simulation import Noise, Truth, nominal_truth, simulate
from symstiff.calibration.simulation.phenomena import Effect
from symstiff.calibration.tables.measurements import measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load


@pytest.mark.slow
def test_a_wave_a_turn_and_the_weight_behind_it_are_one_and_the_same_to_an_unloaded_arm() -> None:
    """Whatever turns with the second joint as its load from weight does: no pose tells which."""
    robot, rng = load("ur10"), np.random.default_rng(7)
    wave = Effect("transmission_error", {"joint": 2}, "harmonics", {"a": [1.5e-4], "harmonics": [1.0]})
    stiff = {name: c for name, c in nominal_truth(robot).items() if name.startswith("c")}
    truth = Truth(robot, stiff, effects=(wave,), noise=Noise((0.02,) * 3), kind="absolute")
    planned = measurements(rng.uniform(-2.4, 2.4, (60, 6)), np.zeros((60, 6)), kind="absolute")
    found = diagnose(Task(robot, simulate(truth, planned, 3), "joints"))
    assert found.verdict == "ambiguous"
    weight, gear = found.effects
    assert (weight.effect, dict(weight.where)) == ("link_weight", {"link": 2})
    assert (gear.effect, dict(gear.where)) == ("transmission_error", {"joint": 2, "harmonics": [1]})
    assert weight.confidence == gear.confidence > 0.45
    assert [e.set_number for e in found.effects] == [0, 1]
    assert gear.parameters["transmission_error_2_a1"].value == pytest.approx(1.5e-4, abs=3e-5)


@pytest.mark.slow
def test_noise_of_nanometres_beside_links_that_the_model_lacks_overflows_nothing() -> None:
    """What is left is ten thousand times the stated sigma and uneven, and so is what the noise is learned from."""
    robot, rng = load("ur10"), np.random.default_rng(7)
    wave = Effect("transmission_error", {"joint": 2}, "harmonics", {"a": [1.5e-4], "harmonics": [1.0]})
    truth = Truth(robot, nominal_truth(robot), effects=(wave,), noise=Noise((2e-5,) * 3), kind="absolute")
    planned = measurements(rng.uniform(-2.4, 2.4, (60, 6)), np.zeros((60, 6)), kind="absolute")
    found = diagnose(Task(robot, simulate(truth, planned, 3), "joints"))
    assert "transmission_error" in {e.effect for e in found.named}
    assert found.rms.after < 0.05 * found.rms.before
