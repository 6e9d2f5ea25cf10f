"""Positions with and without a load that is not what the table tells: the load errs, and not the arm."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.simulation.truth import Device
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load
from symstiff.symbolic.terms import AXES, w

ROBOT, POSES, FORCE, HEAVIER = load("kuka_kr270"), 16, 1500.0, 15.0
AT = {"load": "payload"}


def campaign(levels: tuple[float, ...], error: Effect, seed: int = 1) -> Measurements:
    """Random poses, each with these shares of a weight."""
    rng = np.random.default_rng(seed)
    limits = np.array([j.range for j in ROBOT.joint])
    q = np.repeat(rng.uniform(limits[:, 0], limits[:, 1], (POSES, ROBOT.dof)), len(levels), axis=0)
    w = np.zeros((len(q), 6))
    w[:, 2] = -FORCE * np.tile(levels, POSES)
    plan = measurements(q, w, pose=np.repeat(np.arange(POSES), len(levels)), kind="absolute")
    place = Device((3.0, 1.0, 0.5), (0.0, 0.0, 2.0))
    return simulate(
        Truth(ROBOT, nominal_truth(ROBOT), (error,), Noise((0.02,) * 3), device=place), plan, seed
    )


def heavier(shape: str) -> Effect:
    return Effect("payload_error", None, shape, {"dm": HEAVIER})


def first(found: Finding) -> EffectInstance:
    return found.effects[0].instance


def test_a_load_that_is_heavier_than_told_is_named_and_weighed() -> None:
    found = diagnose(Task(ROBOT, campaign((0.0, 0.5, 1.0), heavier("load"))))
    assert found.verdict == "named"
    assert (first(found).effect, dict(first(found).where)) == ("payload_error", AT)
    assert first(found).shape["loaded"] == 1.0
    mass = found.effects[0].parameters["payload_error_payload_m"]
    assert mass.value == pytest.approx(HEAVIER, abs=4.0 * mass.std)
    assert mass.std < HEAVIER / 10


def test_a_tool_that_is_heavier_than_told_is_there_without_the_load_too() -> None:
    found = diagnose(Task(ROBOT, campaign((0.0, 1.0), heavier("tool"))))
    payloads = [e.instance for e in found.effects if e.effect == "payload_error"]
    assert len(payloads) == 1
    assert "loaded" not in payloads[0].shape


def test_identify_leaves_out_a_known_size_beside_geometry_and_says_so() -> None:
    table = campaign((0.0, 1.0), heavier("tool"))
    plain = StiffnessModel.of(reduce(ROBOT, "gravity", "position"))
    bent = EffectInstance("large_deflection", {"robot": "all"})
    found, alone = (identify(ROBOT, table, start) for start in (plain.with_effect(bent), plain))
    assert any("large deflection: has no size to fit" in r for r in found.remarks)
    assert not any("has no size to fit" in r for r in alone.remarks)
    assert found.fit.values == pytest.approx(alone.fit.values)


SENSOR = {
    "force_sensor_bias": ("constant", {"bias": (60.0, 0.0, 0.0, 0.0, 30.0, 0.0)}, ("fx", "my")),
    "force_sensor_misalignment": ("rotation", {"rotation": (0.03, 0.02, 0.0)}, ("rx", "ry")),
}


@pytest.mark.parametrize("effect", SENSOR)
def test_a_sensor_that_errs_is_named_and_sized(effect: str) -> None:
    """A turn about the load's direction moves nothing."""
    shape, values, seen = SENSOR[effect]
    found = diagnose(Task(ROBOT, campaign((0.0, 0.5, 1.0), Effect(effect, None, shape, values))))
    assert (found.verdict, first(found).effect) == ("named", effect)
    (truth,) = values.values()
    size = dict(
        zip(
            ("fx", "fy", "fz", "mx", "my", "mz") if len(truth) == 6 else ("rx", "ry", "rz"),
            truth,
            strict=True,
        )
    )
    for name in seen:
        p = found.effects[0].parameters[f"{effect}_force_sensor_{name}"]
        assert p.value == pytest.approx(size[name], abs=4.5 * p.std)


def test_a_bias_has_a_place_in_positions_where_some_states_have_no_load() -> None:
    shapes, at = find("force_sensor_bias").shapes, {"load": "force_sensor"}
    assert shapes(ROBOT, at, Scales("absolute", unloaded=0.0)) == ()
    assert all(s["loaded"] == 1.0 for s in shapes(ROBOT, at, Scales("absolute", unloaded=0.3)))
    assert not any("loaded" in s for s in shapes(ROBOT, at, Scales("deflection")))


def test_the_load_has_shapes_of_its_own_where_some_states_have_none() -> None:
    shapes = find("payload_error").shapes
    for kind, unloaded, count in (
        ("absolute", 0.5, 4),
        ("absolute", 0.0, 2),
        ("absolute", 1.0, 2),
        ("deflection", 0.5, 1),
    ):
        assert len(shapes(ROBOT, AT, Scales(kind, unloaded=unloaded))) == count


@pytest.mark.parametrize("shape", [{"loaded": 1.0}, {"loaded": 1.0, "at_tcp": 1.0}])
def test_its_law_is_nothing_without_a_load_and_the_tools_with_one(shape: dict[str, float]) -> None:
    hung = EffectInstance("payload_error", AT, shape).realise(ROBOT)
    tool = EffectInstance("payload_error", AT, {k: v for k, v in shape.items() if k != "loaded"}).realise(
        ROBOT
    )
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
