"""A load on a deflected arm: the arm's own weight has bent it already, whether the robot file tells it or not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from symstiff.calibration.counted import added_by, fitted_beside
from symstiff.calibration.experiment.situation import Laws, Situation, look, under_weights
from symstiff.calibration.identify import identify
from symstiff.calibration.rows import predict
from symstiff.calibration.simulation import Truth, clean_response, nominal_truth
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.arm import arm_load, under_arm, weight_load
from symstiff.effects.base import Scales, Shape
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel, joints_only
from symstiff.reduction import reduce
from symstiff.robot import Robot, load
from symstiff.symbolic.terms import actuated_joint, q
from tests.test_unknown_weights import without_masses

SIGMA = 1e-5
SOFTER = 4.0
PARAMETERS = StiffnessModel.of(reduce(load("ur10"))).parameters


def deflections(robot: Robot, force: float, seed: int) -> Measurements:
    """Of an arm whose gears are soft, by the equilibrium of the bent arm: nothing else is missing."""
    rng = np.random.default_rng(seed)
    angles = np.repeat(rng.uniform(-2.8, 2.8, (30, robot.dof)), 3, axis=0)
    direction = rng.normal(size=(30, 3))
    direction *= force / np.linalg.norm(direction, axis=1)[:, None]
    w = np.array([np.r_[f * s, 0, 0, 0] for f in direction for s in (0.4, 0.7, 1.0)])
    sizes = nominal_truth(robot)
    soft = {name: SOFTER * value if name.startswith("c") else value for name, value in sizes.items()}
    read = clean_response(Truth(robot, soft), angles, w, {"kind": "deflection"})
    read[:, :3] += SIGMA * rng.normal(size=(len(w), 3))
    read[:, 3:] = np.nan
    return measurements(
        angles, w, values=read, sigma=np.where(np.isnan(read), np.nan, SIGMA),
        pose=np.repeat(np.arange(30), 3), kind="deflection", joint_units=["rad"] * robot.dof,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_large_deflection_is_named_though_nobody_tells_what_the_arm_weighs(seed: int) -> None:
    robot = load("ur10")
    bare = without_masses(robot)
    found = diagnose(Task(bare, deflections(robot, 110.0, seed)))
    assert found.verdict == "named"
    assert [e.effect for e in found.named] == ["large_deflection"]
    (arm,) = found.named[0].shape.values()
    weight = sum(link.mass for link in robot.links)
    assert weight / 3 < arm < 3 * weight
    assert any("the law was taken under an arm of" in remark for remark in found.remarks)


def test_identify_takes_a_known_size_off_the_readings_and_says_so() -> None:
    """Of an arm whose masses the file tells; without it the fit is some times the noise, and its values are others."""
    robot = load("ur10")
    table = deflections(robot, 110.0, 1)
    plain = StiffnessModel.of(reduce(robot, "force", "position"))
    bent = EffectInstance("large_deflection", {"robot": "all"})
    found, alone = (identify(robot, table, start, held_out=0.2) for start in (plain.with_effect(bent), plain))
    left, left_alone = (
        i.validation.to_dict()["after"]["positional"]["rms"] for i in (found, alone) if i.validation
    )
    assert left < 1.25 * np.sqrt(3.0) * SIGMA
    assert left_alone > 1.5 * left
    assert found.model.effects == (bent,)
    assert found.model.values["large_deflection_all_share"] == 1.0
    assert any("has a known size, which was taken off the readings (up to" in r for r in found.remarks)


def test_a_known_size_is_that_under_all_loads_that_the_fit_finds() -> None:
    """A sensor that reads 20 N too little is a table with 20 N less."""
    robot = load("ur10")
    table = deflections(robot, 110.0, 1)
    bias = np.array([0.0, 20.0, 0.0, 0.0, 0.0, 0.0])
    plain = StiffnessModel.of(reduce(robot, "force", "position"))
    plain = plain.with_values(dict.fromkeys(plain.parameters, 1e-7))
    sensor = EffectInstance("force_sensor_bias", {"load": "force_sensor"})
    biased = plain.with_effect(sensor)
    biased = biased.with_values({**plain.values, "force_sensor_bias_force_sensor_fy": 20.0})
    bent = [EffectInstance("large_deflection", {"robot": "all"})]
    found = added_by(bent, biased, table)
    expected = added_by(bent, plain, replace(table, w=table.w + bias))
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.nanmax(np.abs(expected)))
    assert np.nanmax(np.abs(found - added_by(bent, plain, table))) > 0.1 * np.nanmax(np.abs(expected))


def test_compliances_that_nothing_tells_have_values_while_a_known_size_is_taken_off() -> None:
    """The start model's, or what fits: with none of them the arm would be stiffer than it is."""
    robot = load("ur10")
    table = deflections(robot, 110.0, 1)
    plain = joints_only(robot)
    for link in (2, 3):
        plain = plain.with_effect(EffectInstance("link_compliance", {"link": link}))
    plain = plain.with_values(dict.fromkeys(plain.parameters, 2e-8))
    bent = EffectInstance("large_deflection", {"robot": "all"})
    near, found = fitted_beside([bent], plain, table), identify(robot, table, plain.with_effect(bent))
    held = set(plain.parameters) - set(found.fit.names)
    assert held
    assert all(near.values[name] != 0.0 for name in held)
    missed = (predict(near, table) - table.values)[table.measured]
    assert np.sqrt(np.mean(missed**2)) < 0.02 * np.sqrt(np.nanmean(table.values**2))
    assert [e.effect for e in found.model.effects] == [
        "link_compliance",
        "link_compliance",
        "large_deflection",
    ]


@pytest.mark.parametrize("kind", ["deflection", "absolute"])
def test_an_arm_that_is_taken_for_granted_is_as_one_that_the_file_tells(kind: str) -> None:
    robot, shape = load("ur10"), {"mass": 20.0}
    bare = without_masses(robot)
    rng = np.random.default_rng(5)
    q, w = rng.uniform(-2.0, 2.0, (8, 6)), rng.normal(size=(8, 6)) * [80, 80, 80, 0, 0, 0]
    read = np.zeros((8, 6)) if kind == "deflection" else np.ones((8, 6))
    table = measurements(q, w, kind=kind, values=read)

    def column(of: Robot, shape: Shape) -> np.ndarray:
        view = look(of, table)
        view = under_weights(view) if kind == "absolute" else view
        model = StiffnessModel.of(reduce(of)).with_values(dict.fromkeys(PARAMETERS, 1e-7))
        effect = find("large_deflection")
        assert effect.columns is not None
        return effect.columns(Situation(view, Laws(view, model.terms, model.values)), {"robot": "all"}, shape)

    told = column(under_arm(bare, shape), {})
    np.testing.assert_allclose(column(bare, shape), told, atol=1e-9 * np.abs(told).max())
    assert np.abs(column(bare, {}) - told).max() > 0.01 * np.abs(told).max()


def loads(robot: Robot, expressions: Sequence[sp.Expr]) -> np.ndarray:
    """What loads are in random poses."""
    poses = np.random.default_rng(3).uniform(-2.0, 2.0, (20, robot.dof))
    law = sp.lambdify([q(j + 1) for j in range(robot.dof)], list(expressions), "numpy")
    return np.array([np.broadcast_to(x, 20) for x in law(*poses.T)], dtype=float)


@pytest.mark.parametrize("name", ["ur10", "kuka_kr270", "scara"])
@pytest.mark.parametrize(("shape", "taper"), [({"mass": 30.0}, 0.0), ({"tapered_mass": 12.0}, 1.0)])
def test_an_arm_that_is_taken_for_granted_loads_the_joints_as_it_does_in_the_laws_of_gears(
    name: str, shape: Shape, taper: float
) -> None:
    bare = without_masses(load(name))
    heavy, joints = under_arm(bare, shape), range(1, bare.dof + 1)
    (mass,) = shape.values()
    assert sum(link.mass for link in heavy.links) <= mass * (1.0 + 1e-9)
    found = loads(bare, [weight_load(heavy, j) for j in joints])
    told = mass * loads(bare, [arm_load(bare, j, taper) for j in joints])
    np.testing.assert_allclose(found, told, atol=1e-9 * np.abs(told).max())


def test_arms_are_tried_for_deflections_where_the_file_tells_no_masses() -> None:
    shapes, robot, where = find("large_deflection").shapes, load("ur10"), {"robot": "all"}
    sizes = {actuated_joint(j): 100.0 for j in range(1, 7)}
    bare = without_masses(robot)
    tried = shapes(bare, where, Scales("deflection", sizes))
    assert tried[0] == {}
    assert {key for shape in tried for key in shape} == {"mass", "tapered_mass"}
    assert shapes(robot, where, Scales("deflection", sizes)) == ({},)
    assert shapes(bare, where, Scales("absolute", sizes)) == ({},)
    assert under_arm(bare, {}) is bare


def test_a_gear_that_bends_sags_by_what_its_law_gives_under_the_weight() -> None:
    """Its law is that of what a load adds to the weight: f(weight + load) - f(weight); the sag is f(weight)."""
    robot = load("ur10")
    table = measurements([[0.3, -0.6, 0.9, 0.2, 0.4, 0.0]], [[0.0, 0.0, -50.0, 0.0, 0.0, 0.0]])
    view = look(robot, table)
    gear = EffectInstance("nonlinear_stiffness", {"joint": 2}, {"load": 60.0, "power": 3.0}).realise(robot)
    found = Situation(view, Laws(view, gear.terms, {"nonlinear_stiffness_2_c": 1e-4}))
    joint = view.index[actuated_joint(2)]
    weight = (under_weights(view).tau - view.tau)[0, joint]
    assert abs(weight) > 20.0
    assert found.sag[0, joint] == pytest.approx(1e-4 * 60.0 * (weight / 60.0) ** 3, rel=1e-9)
