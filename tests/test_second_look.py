"""The second look under the loads that effects add: what it may do without, and what it takes for granted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy import workflow
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.result import Diagnosis, Name
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load

BIAS, GEAR = "force_sensor_bias", "nonlinear_stiffness"


@cache
def data() -> Measurements:
    """Deflections of a robot whose sensor is biased and whose second gear bends."""
    robot, rng, poses = load("kuka_kr270"), np.random.default_rng(1), 30
    limits = np.array([j.range for j in robot.joint])
    q = rng.uniform(limits[:, 0], limits[:, 1], (poses, 6))
    force = rng.normal(size=(poses, 3))
    force *= 2200.0 / np.linalg.norm(force, axis=1)[:, None]
    w = np.array([[*f * share, 0, 0, 0] for f in force for share in (1 / 3, 2 / 3, 1.0)])
    table = measurements(
        np.repeat(q, 3, axis=0), w, pose=np.repeat(np.arange(poses), 3), joint_units=["rad"] * 6
    )
    hidden = (
        Effect(BIAS, None, "constant", {"bias": [100.0, 150, -200, 20, 30, -10]}),
        Effect(GEAR, {"joint": 2}, "power", {"a": 1.2e-3, "tau0": 4400.0, "exponent": 0.6}),
    )
    return simulate(Truth(robot, nominal_truth(robot), hidden, Noise((0.03,) * 3)), table, 1)


def found_with(
    looks: list[Callable[[Diagnosis], Diagnosis]], monkeypatch: pytest.MonkeyPatch
) -> tuple[Finding, int]:
    """What is found where each look sees otherwise than it would, and how many looks there were."""
    whole, left = workflow.examine, list(looks)

    def look(*args: Any, **keys: Any) -> Diagnosis:
        return left.pop(0)(whole(*args, **keys))

    monkeypatch.setattr(workflow, "examine", look)
    monkeypatch.setattr(workflow, "_AGAIN", 0)  # what a changed look leaves is no gross error
    return diagnose(Task(load("kuka_kr270"), data())), len(looks) - len(left)


def as_it_is(found: Diagnosis) -> Diagnosis:
    return found


def without(effect: str) -> Callable[[Diagnosis], Diagnosis]:
    def less(found: Diagnosis) -> Diagnosis:
        kept = tuple(x for x in found.leading if x[0].effect != effect)
        return replace(found, effects=tuple(e for e in found.effects if e.effect != effect), leading=kept)

    return less


def no_surer(**confidence: float) -> Callable[[Diagnosis], Diagnosis]:
    def doubt(found: Diagnosis) -> Diagnosis:
        known = (replace(e, confidence=confidence.get(e.effect, e.confidence)) for e in found.effects)
        return replace(found, effects=tuple(known))

    return doubt


def backlash_too(found: Diagnosis) -> Diagnosis:
    gear = next(e for e in found.effects if e.effect == GEAR)
    entry = next(x for x in found.leading if x[0].effect == GEAR)
    more = replace(gear, effect="backlash", where={"joint": 3}, shape={"width": 20.0})
    elsewhere = (Name("backlash", {"joint": 3}), more.shape, entry[2])
    return replace(found, effects=(*found.effects, more), leading=(*found.leading, elsewhere))


@pytest.mark.slow
def test_a_second_look_under_the_loads_found_may_do_without_an_effect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, looks = found_with([backlash_too, as_it_is], monkeypatch)
    assert looks == 2
    assert {(e.effect, e.where.get("joint")) for e in found.named} == {(BIAS, None), (GEAR, 2)}


@pytest.mark.slow
def test_a_second_look_does_not_do_without_the_effect_whose_loads_it_takes_for_granted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Under the sensor's bias a law of the loaded joint bends to what the bias itself adds."""
    found, looks = found_with([as_it_is, without(BIAS)], monkeypatch)
    assert looks == 2
    assert {(e.effect, e.where.get("joint")) for e in found.named} == {(BIAS, None), (GEAR, 2)}


@pytest.mark.slow
def test_what_stands_against_an_effect_in_the_first_look_stands_in_the_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The second look takes the bias for granted, so that nothing is left there that could be said against it."""
    found, looks = found_with(
        [no_surer(**{BIAS: 0.7, GEAR: 0.7}), no_surer(**{BIAS: 0.96, GEAR: 0.96})], monkeypatch
    )
    assert looks == 2
    assert {e.effect: e.confidence for e in found.named} == {BIAS: 0.7, GEAR: 0.96}
