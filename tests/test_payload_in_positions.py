"""Positions with and without a load whose weight is not what the table tells: the load errs, and not the arm."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.simulation.truth import Device
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.robot import load
from symstiff.symbolic.terms import AXES, w

ROBOT, POSES, FORCE, HEAVIER = load("kuka_kr270"), 16, 1500.0, 15.0
AT = {"load": "payload"}


def campaign(levels: tuple[float, ...], shape: str, seed: int = 1) -> Measurements:
    """Random poses, each with these shares of a weight, of an arm whose payload or tool is heavier than told."""
    rng = np.random.default_rng(seed)
    limits = np.array([j.range for j in ROBOT.joint])
    q = np.repeat(rng.uniform(limits[:, 0], limits[:, 1], (POSES, ROBOT.dof)), len(levels), axis=0)
    w = np.zeros((len(q), 6))
    w[:, 2] = -FORCE * np.tile(levels, POSES)
    plan = measurements(q, w, pose=np.repeat(np.arange(POSES), len(levels)), kind="absolute")
    heavier = Effect("payload_error", None, shape, {"dm": HEAVIER})
    place = Device((3.0, 1.0, 0.5), (0.0, 0.0, 2.0))
    return simulate(
        Truth(ROBOT, nominal_truth(ROBOT), (heavier,), Noise((0.02,) * 3), device=place), plan, seed
    )


def first(found: Finding) -> EffectInstance:
    return found.effects[0].instance


def test_a_load_that_is_heavier_than_told_is_named_and_weighed() -> None:
    found = diagnose(Task(ROBOT, campaign((0.0, 0.5, 1.0), "load")))
    assert found.verdict == "named"
    assert (first(found).effect, dict(first(found).where)) == ("payload_error", AT)
    assert first(found).shape["hung"] == 1.0
    mass = found.effects[0].parameters["payload_error_payload_m"]
    assert mass.value == pytest.approx(HEAVIER, abs=4.0 * mass.std)
    assert mass.std < HEAVIER / 10


def test_a_tool_that_is_heavier_than_told_is_there_without_the_load_too() -> None:
    found = diagnose(Task(ROBOT, campaign((0.0, 1.0), "tool")))
    payloads = [e.instance for e in found.effects if e.effect == "payload_error"]
    assert [dict(e.shape) for e in payloads] == [{}]


def test_the_load_has_shapes_of_its_own_where_some_states_have_none() -> None:
    shapes = find("payload_error").shapes
    for kind, unloaded, count in (
        ("absolute", 0.5, 3),
        ("absolute", 0.0, 1),
        ("absolute", 1.0, 1),
        ("deflection", 0.5, 1),
    ):
        assert len(shapes(ROBOT, AT, Scales(kind, unloaded=unloaded))) == count


@pytest.mark.parametrize("shape", [{"hung": 1.0}, {"hung": 1.0, "at_tcp": 1.0}])
def test_its_law_is_nothing_without_a_load_and_the_tools_with_one(shape: dict[str, float]) -> None:
    hung = EffectInstance("payload_error", AT, shape).realise(ROBOT)
    tool = EffectInstance("payload_error", AT, {k: v for k, v in shape.items() if k != "hung"}).realise(ROBOT)
    other = {(t.parameter, t.at): t.factor for t in tool.terms}
    assert {(t.parameter, t.at) for t in hung.terms} == set(other)
    for force, share in ((0.0, 0.0), (5.0, 1.0)):
        values = {w(k): sp.Float(force if k == 3 else 0.0) for k in AXES}
        for term in hung.terms:
            left = sp.expand(term.factor.subs(values) - share * other[term.parameter, term.at])
            assert (
                all(abs(c) < 1e-9 for c in sp.Poly(left, *left.free_symbols).coeffs()) if left != 0 else True
            )
    slope = [term.factor.diff(w(3)).subs({w(k): 0 for k in AXES}) for term in hung.terms]
    assert slope == [0] * len(slope)
