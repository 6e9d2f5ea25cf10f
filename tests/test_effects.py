"""The catalogue: what it holds, and that every effect flows through the model."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

from symstiff.calibration.simulation.chain import chain_of, joint_index
from symstiff.calibration.simulation.chain import posture as posture_of
from symstiff.calibration.simulation.equilibrium import Mechanism, States, Weight, loads
from symstiff.discrepancy.apart.distinguish import distinction
from symstiff.effects import EffectInstance, catalogue
from symstiff.effects.arm import weight_load
from symstiff.effects.base import Effect, Scales
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only, load_model
from symstiff.reduction.reduce import reduce
from symstiff.robot import Robot, load
from symstiff.symbolic.algebras import NumpyAlgebra, evaluate_numpy
from symstiff.symbolic.latex import letter
from symstiff.symbolic.program import walk
from symstiff.symbolic.reading import laws_latex
from symstiff.symbolic.terms import actuated_joint, q

ALL = {
    "joint_compliance", "link_compliance", "link_asymmetry", "base_compliance", "tool_compliance",
    "gravity_compensator", "nonlinear_stiffness", "backlash", "hysteresis", "wrist_coupling",
    "transmission_error", "joint_offset", "geometric_error", "payload_error", "link_weight",
    "force_sensor_bias", "force_sensor_misalignment", "frame_misalignment", "thermal_drift",
    "large_deflection", "bad_poses",
}  # fmt: skip
SCALES = Scales(
    angles=((-2.0, -1.2, -0.3),) * 7,
    context={"time": 500.0, "temperature": 4.0},
    lowest={"temperature": 20.0},
)


def instances(robot_name: str) -> Iterator[EffectInstance]:
    """Every effect at every place (of many harmonics the first and the last), first and last shape."""
    robot = load(robot_name)
    for effect in catalogue().values():
        for where in effect.places(robot):
            if where.get("harmonics", [1])[0] not in (1, 32):
                continue
            shapes = effect.shapes(robot, where, SCALES)
            for shape in shapes if len(shapes) == 1 else (shapes[0], shapes[-1]):
                yield EffectInstance(effect.identifier, where, shape)


def experiment(dof: int, n: int = 5) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    rng = np.random.default_rng(4)
    q_, w_ = rng.uniform(-1, 1, (n, dof)), rng.normal(size=(n, 6)) * 300
    context = {
        "time": rng.uniform(0, 500, n),
        "temperature": rng.uniform(20, 24, n),
        "branch": rng.choice([-1.0, 1.0], n),
        "turn": rng.uniform(1.0, 4.0, n),
    }
    return q_, w_, context


def test_the_catalogue_holds_every_effect_with_what_a_reader_needs() -> None:
    assert set(catalogue()) >= ALL
    for identifier, effect in catalogue().items():
        assert effect.identifier == identifier
        assert effect.title
        assert effect.description.endswith(".")
        assert effect.seen_in <= {"deflection", "absolute"}
        assert effect.confused_with, identifier
        assert effect.separated_by, identifier
        assert set(effect.confused_with) <= set(catalogue()), identifier


@pytest.mark.parametrize("instance", list(instances("planar2r")), ids=str)
def test_every_effect_at_every_place_flows_into_the_deflection_and_its_columns(
    instance: EffectInstance,
) -> None:
    model = joints_only(load("planar2r"))
    grown = model.with_effect(instance)
    rng = np.random.default_rng(1)
    values = {n: 1e-6 * rng.uniform(0.5, 2) for n in grown.stiffness_parameters}
    values |= {p.name: p.typical * rng.uniform(0.5, 1) for p in grown.effect_parameters}
    q_, w_, context = experiment(2)
    columns = grown.observation(q_, w_, values=values, context=context)
    assert columns.shape == (5, 6, len(grown.parameters))
    for k, name in enumerate(grown.parameters):
        step = 0.1 * abs(values[name])
        ahead, behind = (
            grown.deflection(q_, w_, values={**values, name: values[name] + s * step}, context=context)
            for s in (1, -1)
        )
        scale = np.abs(ahead).max() / step
        np.testing.assert_allclose(columns[:, :, k], (ahead - behind) / (2 * step), atol=1e-9 * scale)


@pytest.mark.parametrize("effect", catalogue().values(), ids=lambda e: e.identifier)
def test_every_shapes_law_has_a_slope_everywhere_that_all_emitters_know(effect: Effect) -> None:
    """An effect of the load differentiates the laws of all others, at no load too."""
    robot = load("planar2r")
    for where in effect.places(robot)[:1]:
        for shape in effect.shapes(robot, where, SCALES):
            for term in effect.realise(robot, where, shape).terms:
                for by in {s for s in term.factor.free_symbols if str(s).startswith("tau")}:
                    slope = sp.diff(term.factor, by)
                    rest = {s: np.float64(0.3) for s in slope.free_symbols}
                    for value in (-1e-9, 0.0, 1e-9, 40.0):
                        assert np.isfinite(walk(slope, {**rest, by: np.float64(value)}, NumpyAlgebra()))


@pytest.mark.parametrize("instance", list(instances("planar2r")), ids=str)
def test_parameters_are_named_by_effect_and_place_with_unit_range_and_size(instance: EffectInstance) -> None:
    for p in instance.realise(load("planar2r")).parameters:
        own = p.name.startswith(f"{instance.effect}_")
        assert own or p.name[0] in "kc", p.name
        assert p.low < p.high
        assert p.low <= p.typical <= p.high
        assert p.unit
        assert p.name.isidentifier()


@pytest.mark.parametrize("name", ["kuka_kr270", "scara"])
def test_no_effect_of_size_zero_changes_a_deflection(name: str) -> None:
    robot = load(name)
    model = joints_only(robot)
    q_, w_, context = experiment(robot.dof, 3)
    values = dict.fromkeys(model.parameters, 1e-6)
    before = model.deflection(q_, w_, values=values)
    seen = set()
    for instance in instances(name):
        replaced = instance.realise(robot).replaces
        if instance.effect in seen or replaced:
            continue
        seen.add(instance.effect)
        after = model.with_effect(instance).deflection(q_, w_, values=values, context=context)
        np.testing.assert_allclose(after, before, atol=1e-15)


def test_a_model_with_effects_is_the_same_after_saving_and_loading(tmp_path: Path) -> None:
    at_each_place = {(i.effect, str(i.where)): i for i in instances("planar2r")}
    model = joints_only(load("planar2r")).with_effects([*at_each_place.values()][:60])
    model = model.with_values({n: 1e-6 * (k + 1) for k, n in enumerate(model.parameters)})
    model.save(tmp_path / "model.toml")
    again = load_model(tmp_path / "model.toml")
    assert again.parameters == model.parameters
    assert again.terms == model.terms
    assert dict(again.values) == dict(model.values)
    assert again.structure_hash == model.structure_hash


def test_latex_of_a_model_shows_every_term_that_an_effect_adds() -> None:
    robot = load("kuka_kr270")
    seen = set()
    for instance in instances("kuka_kr270"):
        if instance.effect in seen:
            continue
        seen.add(instance.effect)
        realised = instance.realise(robot)
        text = laws_latex(realised.terms)
        assert text.startswith("$$")
        for term in realised.terms:
            assert letter(sp.Symbol(term.parameter)) in text


OF_THE_READING = {"force_sensor_misalignment", "frame_misalignment"}
"""What they turn is a load or a reading, and no compliance of the robot."""


_ENOUGH = 12


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", sorted(n for n, e in catalogue().items() if e.columns is None and n not in OF_THE_READING)
)
def test_a_models_compliance_is_the_slope_of_its_deflection_without_load(name: str) -> None:
    robot = load("ur10")
    plain = StiffnessModel.of(reduce(robot))
    angles = np.array([[0.3, -1.1, 0.9, 0.4, 0.7, 0.2]])
    context = dict.fromkeys(("time", "temperature", "branch", "turn"), 1.0)
    for instance in of_all_shapes(name, robot):
        model = plain.with_effect(instance)
        values = {n: 1e-8 * (1 + k % 3) for k, n in enumerate(model.parameters)}
        model = model.with_values(values | {p.name: p.typical for p in model.effect_parameters})
        known = {v.name: len(v.symbols) for v in model.compliance_program.inputs}
        inputs = {"context": np.ones((1, known["context"]))} if "context" in known else {}
        C = evaluate_numpy(model.compliance_program, p=model.vector(), q=angles, **inputs)["C"][0]
        step = 1e-5 * np.eye(6)
        ends = [
            [model.deflection(angles, s * w[None], context=context)[0] for w in step] for s in (1.0, -1.0)
        ]
        slope = (np.array(ends[0]) - np.array(ends[1])).T / 2e-5
        np.testing.assert_allclose(C, slope, atol=2e-6 * np.abs(slope).max(), err_msg=str(instance))


def of_all_shapes(name: str, robot: Robot) -> Iterator[EffectInstance]:
    """An effect at two of its places in the first of its shapes, and at one in all that it has under loads, or where
    these are many, of which numbers alone differ, in a dozen or two."""
    effect = catalogue()[name]
    places = effect.places(robot)
    for where in places[1:3]:
        yield EffectInstance(name, where, next(iter(effect.shapes(robot, where, Scales())), {}))
    under_load = replace(SCALES, load={actuated_joint(j): 100.0 for j in range(1, robot.dof + 1)})
    shapes = effect.shapes(robot, places[-1], under_load)
    for shape in shapes[:: max(len(shapes) // _ENOUGH, 1)]:
        yield EffectInstance(name, places[-1], shape)


def test_a_place_the_robot_does_not_have_is_refused() -> None:
    with pytest.raises(UserError, match="cannot be at"):
        EffectInstance("backlash", {"joint": 9}).realise(load("planar2r"))
    with pytest.raises(UserError, match=r"unknown effect.*entry points symstiff\.effects"):
        EffectInstance("slackness", {"joint": 1}).realise(load("planar2r"))
    with pytest.raises(UserError, match="unknown effect 'backlsh': did you mean 'backlash'"):
        EffectInstance("backlsh", {"joint": 1}).realise(load("planar2r"))
    with pytest.raises(UserError, match="shape"):
        EffectInstance("nonlinear_stiffness", {"joint": 1}, {"load": 1.0}).realise(load("planar2r"))


def test_the_compensators_stiffness_is_the_slope_of_its_moment() -> None:
    robot = load("kuka_kr270")
    compensator = robot.gravity_compensator
    assert compensator is not None
    alpha = 0.4
    shape = {"alpha": alpha}
    (term,) = EffectInstance("gravity_compensator", {"joint": 2}, shape).realise(robot).terms
    load_symbol = next(s for s in term.factor.free_symbols if s.name.startswith("tau"))
    law = sp.lambdify(q(2), term.factor.subs(load_symbol, 1))
    a, arm = math.hypot(compensator.ax or 0, compensator.ay or 0), compensator.L or 0

    def moment(angle: float) -> float:
        phi = alpha - angle
        s = math.sqrt(a**2 + arm**2 + 2 * a * arm * math.cos(phi))
        return (1 - (compensator.s0 or 0) / s) * a * arm * math.sin(phi)

    turn = np.linspace(-3, 3, 13)
    slope = np.array([(moment(x + 1e-6) - moment(x - 1e-6)) / 2e-6 for x in turn])
    found = np.array([law(x) for x in turn])
    np.testing.assert_allclose(found / found[3], slope / slope[3], rtol=1e-7)
    assert max(abs(law(x)) for x in np.linspace(-np.pi, np.pi, 400)) == pytest.approx(1.0, rel=1e-4)


def test_one_compliance_for_each_angle_gives_the_seeds_counts_and_interpolates() -> None:
    robot = load("kuka_kr270")
    angles = {f"angle_{k}": v for k, v in enumerate((-2.0, -1.6, -1.1, -0.7, -0.2), start=1)}
    instance = EffectInstance("gravity_compensator", {"joint": 2}, angles)
    complete = StiffnessModel.of(reduce(robot, "gravity"))
    joints = joints_only(robot, "gravity")
    assert (len(complete.parameters), len(complete.with_effect(instance).parameters)) == (26, 30)
    assert (len(joints.parameters), len(joints.with_effect(instance).parameters)) == (5, 9)
    hats = [t.factor for t in instance.realise(robot).terms]
    load_symbol = next(s for s in hats[0].free_symbols if s.name.startswith("tau"))
    values = np.array(
        [
            [sp.N(h.subs({load_symbol: 1, q(2): v})) for h in hats]
            for v in (*angles.values(), -3.0, -0.45, 1.0)
        ],
        dtype=float,
    )
    np.testing.assert_allclose(values[:5], np.eye(5), atol=1e-12)
    np.testing.assert_allclose(values.sum(axis=1), 1.0)
    np.testing.assert_allclose(values[6], [0, 0, 0, 0.5, 0.5], atol=1e-12)


def test_the_weight_on_a_joint_is_the_simulators() -> None:
    robot = load("ur10")
    chain = chain_of(robot)
    weights = tuple(
        Weight(i, link.mass, tuple(link.mass * x for x in link.com), True)  # type: ignore[arg-type]
        for i, link in enumerate(robot.links)
        if link.mass
    )
    mechanism = Mechanism(chain, np.zeros((chain.size, chain.size)), weights=weights)
    rng = np.random.default_rng(0)
    q_ = rng.uniform(-3, 3, (4, 6))
    zero = np.zeros(4)
    states = States(q_, np.zeros((4, 6)), zero, zero, zero, zero)
    expected = loads(mechanism, states, posture_of(chain, q_, np.zeros((4, chain.size))))
    for j in range(1, 7):
        law = sp.lambdify([q(i) for i in range(1, 7)], weight_load(robot, j))
        found = [float(law(*row)) for row in q_]
        np.testing.assert_allclose(found, expected[:, joint_index(j)], atol=1e-9)


def test_with_masses_a_gap_is_crossed_only_where_the_total_torque_turns_over() -> None:
    robot = load("ur10")
    model = joints_only(robot).with_effect(EffectInstance("backlash", {"joint": 2}, {"width": 0.01}))
    q_ = np.array([[0.0, -0.3, 0.2, 0.1, 0.4, 0.0]] * 2)  # stretched out: gravity loads joint 2
    up_little, up_much = [0, 0, 20.0, 0, 0, 0], [0, 0, 600.0, 0, 0, 0]
    values = {"backlash_2_gap": 1e-3}
    still, crossed = model.deflection(q_, np.array([up_little, up_much]), values=values)[:, 2]
    assert abs(still) < 1e-9
    assert abs(crossed) > 5e-4


def distinguishable(
    model: StiffnessModel, effect: str, where: dict[str, Any], kind: str = "deflection"
) -> bool:
    return distinction(model, effect, where, kind=kind).distinguishable


def test_where_joints_stood_still_a_reduced_model_has_all_that_can_be_told() -> None:
    for name, fixed in (("kuka_kr270", {1: 0, 2: 0, 3: 0}), ("ur10", {2: -1.2, 3: 0.7})):
        model = StiffnessModel.of(reduce(load(name), "gravity", "pose", fixed=fixed))
        assert set(model.fixed) == set(fixed)
        gained = [distinction(model, "link_compliance", {"link": i}).gained for i in range(7)]
        assert gained == [0] * 7


def test_structure_alone_tells_what_no_data_can_show() -> None:
    model = StiffnessModel.of(reduce(load("kuka_kr270")))
    tool = distinction(model, "tool_compliance", {"link": 6})
    missing = {f"k6_{a}{a}" for a in (1, 2, 3)} - set(model.parameters)
    assert missing
    assert missing <= set(tool.inside)
    assert distinguishable(model, "gravity_compensator", {"joint": 2})
    assert not distinguishable(model, "joint_compliance", {"joint": 3})
    assert not distinguishable(model, "link_compliance", {"link": 2})
    assert not distinguishable(model, "transmission_error", {"joint": 2, "harmonics": [3]})
    assert distinguishable(model, "transmission_error", {"joint": 2, "harmonics": [3]}, kind="absolute")
    assert not distinguishable(model, "joint_offset", {"joint": 1}, kind="absolute")  # placement
    assert distinguishable(model, "joint_offset", {"joint": 2}, kind="absolute")


@pytest.mark.parametrize("effect", ["backlash", "hysteresis", "nonlinear_stiffness"])
def test_a_joint_that_no_load_turns_shows_nothing(effect: str) -> None:
    model = StiffnessModel.of(reduce(load("kuka_kr270"), "gravity"))
    assert not distinguishable(model, effect, {"joint": 1})
    assert distinguishable(model, effect, {"joint": 3})


def test_what_a_model_of_joints_lacks_can_be_told_from_it() -> None:
    model = joints_only(load("planar2r"), "force", "position")
    assert not distinguishable(model, "joint_compliance", {"joint": 1})
    assert distinguishable(model, "link_compliance", {"link": 1})
    assert distinguishable(model, "base_compliance", {"link": 0})
    assert distinguishable(model, "nonlinear_stiffness", {"joint": 2})


@pytest.mark.parametrize(
    ("effect", "shape"),
    [
        ("nonlinear_stiffness", {"load": 0.0, "power": 2.0}),
        ("nonlinear_stiffness", {"load": -5.0, "knee": 1.0}),
        ("backlash", {"width": 0.0}),
        ("hysteresis", {"width": 5.0, "loop": -1.0}),
        ("thermal_drift", {"time": 0.0}),
        ("thermal_drift", {"time": 60.0, "T": 0.0}),
        ("thermal_drift", {"temperature": -2.0}),
    ],
)
def test_a_size_that_divides_has_to_be_above_zero(effect: str, shape: dict[str, float]) -> None:
    where = {"measurement": "frame"} if effect == "thermal_drift" else {"joint": 2}
    with pytest.raises(UserError, match="give a value above zero"):
        EffectInstance(effect, where, shape).realise(load("ur10"))


@pytest.mark.parametrize(
    ("effect", "where", "shape", "why"),
    [
        ("transmission_error", {"joint": 3, "harmonics": "12"}, {}, "harmonics = '12'"),
        ("gravity_compensator", {"joint": 2}, {"angle_1": 1.0, "angle_2": -1.0}, "ascending order"),
        ("gravity_compensator", {"joint": 2}, {"angle_1": 1.0, "angle_2": 1.0}, "ascending order"),
        ("bad_poses", {"rows": "p4"}, {}, "labels of its rows"),
    ],
)
def test_what_would_be_read_as_something_else_is_refused(
    effect: str, where: dict[str, Any], shape: dict[str, float], why: str
) -> None:
    with pytest.raises(UserError, match=why):
        EffectInstance(effect, where, shape).realise(load("ur10"))


def test_compliances_by_angle_say_at_which_angle_they_hold() -> None:
    law = EffectInstance("gravity_compensator", {"joint": 2}, {"angle_1": -1.0, "angle_2": 0.5})
    meanings = [p.meaning for p in law.realise(load("ur10")).parameters]
    assert ["q2 = -1 rad" in meanings[0], "q2 = 0.5 rad" in meanings[1]] == [True, True]
