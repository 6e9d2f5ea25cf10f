"""The bridge from measurement tables to the statistics, held against the nonlinear simulator."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import Laws, Situation, look
from symstiff.calibration.fits.decomposition import column_space
from symstiff.calibration.simulation import (
    Device,
    Effect,
    Noise,
    Truth,
    clean_response,
    nominal_truth,
    simulate,
)
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.bridge.assemble import Assembly, assemble
from symstiff.discrepancy.problem import Candidate
from symstiff.effects import EffectInstance, catalogue
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only
from symstiff.reduction.physical import original, terms_of
from symstiff.reduction.reduce import reduce
from symstiff.robot import from_table, load
from symstiff.robot.table import to_table

LOADS = {"kuka_kr270": 300.0, "ur10": 40.0, "scara": 30.0}


@cache
def complete(name: str) -> StiffnessModel:
    return StiffnessModel.of(reduce(load(name)))


def design(name: str, kind: str, poses: int = 12, levels: tuple[float, ...] = (0.3, 1.0)) -> Measurements:
    """Poses within the limits, loads of several directions, three markers, and all the context there is."""
    robot = load(name)
    rng = np.random.default_rng(2)
    limits = np.array([j.range for j in robot.joint])
    q = rng.uniform(limits[:, 0], limits[:, 1], (poses, robot.dof))
    w = rng.normal(size=(poses, 6)) * [1, 1, 1, 0.2, 0.2, 0.2] * LOADS[name]
    each = len(levels) * 3
    n = poses * each
    return measurements(
        np.repeat(q, each, axis=0),
        np.concatenate([np.repeat(f[None] * s, 3, axis=0) for f in w for s in levels]),
        pose=np.repeat(np.arange(poses), each),
        points=("p1", "p2", "p3"),
        point=np.tile([0, 1, 2], n // 3),
        kind=kind,  # type: ignore[arg-type]
        joint_units=["m" if j.prismatic else "rad" for j in robot.joint],
        time=np.arange(n) * 7.0,
        temperature=20.0 + 3.0 * np.sin(np.arange(n) / 40.0),
        branch=np.tile(np.repeat([1.0, -1.0], 3), n // 6),
    )


def readings(truth: Truth, table: Measurements) -> np.ndarray:
    """The simulator's noise-free values (rows, 6)."""
    fields = ("points", "point", "labels", "pose", "time", "temperature", "branch")
    context: dict[str, Any] = {name: getattr(table, name) for name in fields}
    return clean_response(truth, table.q, table.w, {"kind": table.kind, **context})


def measured(truth: Truth, table: Measurements) -> Measurements:
    values = readings(truth, table)
    values[:, 3:] = np.nan
    return replace(table, values=values)


def truth_of(name: str, *effects: Effect, size: float = 1.0) -> Truth:
    robot = load(name)
    values = {k: v * size for k, v in nominal_truth(robot).items()}
    return Truth(robot, values, tuple(effects), device=Device())


def outside(y: np.ndarray, A: np.ndarray) -> np.ndarray:
    basis = column_space(A, 1e-11)
    return y - basis @ (basis.T @ y)


def of(found: Assembly, effect: str, where: dict[str, Any]) -> Candidate:
    return next(c for c in found.candidates if c.effect == effect and dict(c.where) == where)


@pytest.mark.parametrize("name", list(LOADS))
@pytest.mark.parametrize("kind", ["deflection", "absolute"])
def test_a_complete_model_explains_a_robot_that_has_nothing_else(name: str, kind: str) -> None:
    found = assemble(complete(name), measured(truth_of(name), design(name, kind)))
    problem = found.problem
    left = outside(problem.y, problem.A)
    assert np.sqrt(np.mean(problem.y**2)) > 1e-4
    assert np.sqrt(np.mean(left**2)) < 3e-6  # second-order terms of the nonlinear simulator


def test_rows_say_what_they_are() -> None:
    table = measured(truth_of("scara"), design("scara", "deflection"))
    problem = assemble(complete("scara"), table).problem
    assert problem.rows == 12 * 2 * 9
    assert problem.poses == 12
    assert len(np.unique(problem.channel)) == 9
    assert set(np.unique(problem.axis)) == {0, 1, 2}
    assert problem.load is not None
    np.testing.assert_allclose(np.unique(problem.load), [0.3, 1.0])
    assert problem.J is not None
    assert problem.tau is not None
    assert problem.virtual_joints[6] == "joint 1"
    assert problem.joint_of[6] == 0
    keys = np.column_stack([problem.pose, problem.case, problem.channel])
    assert len(np.unique(keys, axis=0)) == problem.rows  # no two rows pass for repeats
    k = problem.virtual_joints.index("joint 2")
    np.testing.assert_allclose(
        problem.tau[:, k].reshape(-1, 9)[:, :1], problem.tau[:, k].reshape(-1, 9)[:, 1:2]
    )


def test_load_cases_are_numbered_in_their_pose_as_measured_and_a_sensors_scatter_makes_none() -> None:
    table = design("scara", "deflection", 4, (0.25, 0.5, 1.0, -0.5, -1.0))
    rows = np.tile(np.arange(len(table)), 2)
    twice = replace(table.select(rows), repeat=np.repeat([1.0, 2.0], len(table)))
    twice = replace(twice, branch=np.full(len(twice), np.nan))
    scatter = 5e-5 * np.abs(twice.w).max() * np.random.default_rng(2).normal(size=twice.w.shape)
    for given in (twice, replace(twice, w=twice.w + scatter)):
        values = np.tile([1e-3, 1e-3, 1e-3, np.nan, np.nan, np.nan], (len(given), 1))
        problem = assemble(complete("scara"), replace(given, values=values), effects=()).problem
        first = np.tile(np.repeat(np.arange(5), 3), 4)
        found = problem.case.reshape(-1, 3)[:, 0]
        assert list(found) == list(np.tile(first, 2))
        assert len(np.unique(problem.cells)) == problem.rows / 2


SIGNALS = [
    ("deflection", "joint_compliance", {"joint": 2}, "", {"c": 1e-8}, True),
    ("deflection", "backlash", {"joint": 3}, "tanh", {"gap": 1e-5, "knee": "width"}, False),
    ("deflection", "hysteresis", {"joint": 2}, "constant", {"width": 1e-5, "knee": "width"}, False),
    ("deflection", "nonlinear_stiffness", {"joint": 2}, "tanh", {"a": 1e-6, "tau0": "load"}, False),
    ("deflection", "wrist_coupling", {"joints": [4, 5]}, "", {"c": 1e-8}, False),
    ("deflection", "link_asymmetry", {"link": 2}, "", {"entries": {"45": 1e-9, "16": 1e-10}}, False),
    ("deflection", "force_sensor_bias", {"load": "force_sensor"}, "", {"bias": [3, -2, 5, 1, 0.5, 1]}, False),
    ("deflection", "force_sensor_misalignment", {"load": "force_sensor"}, "", {"rotation": [2e-3, 1e-3, -1e-3]},
     False),
    ("deflection", "force_sensor_bias", {"load": "force_sensor"}, "tool", {"bias": [3, -2, 5, 1, 0.5, 1]}, False),
    ("deflection", "force_sensor_misalignment", {"load": "force_sensor"}, "tool", {"rotation": [2e-3, 1e-3, -1e-3]},
     False),
    ("deflection", "frame_misalignment", {"measurement": "frame"}, "", {"rotation": [2e-3, 1e-3, -1e-3]}, False),
    ("deflection", "thermal_drift", {"measurement": "frame"}, "time", {"rate": [1e-8, 0, -1e-8]}, False),
    ("deflection", "thermal_drift", {"link": 2}, "link_time", {"rate": [1e-8, 0, -1e-8]}, False),
    ("deflection", "payload_error", {"load": "payload"}, "load", {"dm": 1.0, "dmc": [0.1, 0.2, 0.3]}, False),
    ("deflection", "bad_poses", {"rows": ["p3"]}, "", {"poses": ["p3"], "shift": [1e-5, -2e-5, 0]}, False),
    ("absolute", "joint_offset", {"joint": 2}, "", {"offset": 1e-5}, False),
    ("absolute", "transmission_error", {"joint": 3, "harmonics": [5]}, "", {"a": 1e-5, "b": -2e-5,
                                                                            "harmonics": [5]}, False),
    ("absolute", "geometric_error", {"link": 2}, "", {"shift": [1e-5, 2e-5, 0, 1e-5, 0, -1e-5]}, False),
    ("absolute", "backlash", {"joint": 2}, "tanh", {"gap": 1e-5, "knee": "width"}, False),
    ("absolute", "link_weight", {"link": 3}, "", {"mass": 2.0, "com": [0.1, 0.05, -0.1]}, False),
    ("absolute", "payload_error", {"load": "payload"}, "tool", {"dm": 1.0, "dmc": [0.1, 0.2, 0.3]}, False),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "effect", "where", "shape", "values", "inside"), SIGNALS)
def test_a_candidates_columns_hold_what_the_simulator_shows_of_the_effect(
    kind: str, effect: str, where: dict[str, Any], shape: str, values: dict[str, Any], inside: bool
) -> None:
    name = "kuka_kr270"
    table = design(name, kind)
    found = assemble(complete(name), measured(truth_of(name), table))
    candidate = of(found, effect, where)
    assert bool(candidate.unavailable) == inside
    form = candidate.shapes[0]
    if shape == "tanh" and effect == "nonlinear_stiffness":
        form = next(s for s in candidate.shapes if "saturation" in s)
    if shape.endswith("time"):
        form = next(s for s in candidate.shapes if "time" in s and "T" not in s)
    if shape == "tool" and effect.startswith("force_sensor"):
        form = next(s for s in candidate.shapes if s.get("tool"))
    values = {k: form[v] if isinstance(v, str) else v for k, v in values.items()}
    more = Effect(effect, where, shape, values)
    difference = readings(truth_of(name, more), table) - readings(truth_of(name), table)
    view = found.situation.view
    signal = outside(difference[view.state, view.component], found.problem.A)
    if inside:
        assert np.linalg.norm(signal) < 0.02 * np.linalg.norm(difference)
        return
    block = candidate.columns(form)
    left = outside(signal, np.hstack([found.problem.A, block]))
    assert np.linalg.norm(signal) > 1e-8
    assert np.linalg.norm(left) < 0.07 * np.linalg.norm(signal)  # half a per cent of the power


def test_the_second_order_term_has_the_size_that_the_simulator_shows() -> None:
    name = "kuka_kr270"
    table = design(name, "deflection")
    table = replace(table, w=table.w * 12.0)
    found = assemble(complete(name), measured(truth_of(name), table))
    column = of(found, "large_deflection", {"robot": "all"}).columns({})
    signal, part = outside(found.problem.y, found.problem.A), outside(column[:, 0], found.problem.A)
    assert np.linalg.norm(signal - part) < 0.35 * np.linalg.norm(signal)


@pytest.mark.parametrize(("kind", "limit"), [("deflection", 0.25), ("absolute", 0.06)])
def test_the_second_order_term_stands_on_the_sag_of_an_arm_that_weighs(kind: str, limit: float) -> None:
    """Without the links' weight 0.43 and 0.16 of it would be left. Of positions a part of the sag passes for geometry,
    from which the equations start.
    """
    table = design("ur10", kind, poses=30)
    found = assemble(complete("ur10"), measured(truth_of("ur10"), replace(table, w=table.w * 3.0)))
    column = of(found, "large_deflection", {"robot": "all"}).columns({})
    signal, part = outside(found.problem.y, found.problem.A), outside(column[:, 0], found.problem.A)
    assert np.linalg.norm(signal - part) < limit * np.linalg.norm(signal)


def test_an_effect_in_the_model_is_no_candidate_and_its_columns_are_the_models() -> None:
    name = "scara"
    more = Effect("backlash", {"joint": 2}, "tanh", {"gap": 1e-3, "knee": 2.0})
    data = measured(truth_of(name, more), design(name, "deflection"))
    plain = assemble(complete(name), data)
    grown = complete(name).with_effect(EffectInstance("backlash", {"joint": 2}, {"width": 2.0}))
    found = assemble(grown, data)
    assert found.names[-1] == "backlash_2_gap"
    assert found.fitted["backlash_2_gap"] == pytest.approx(1e-3, rel=0.05)
    assert of(found, "backlash", {"joint": 2}).unavailable == "the model has it"
    before, after = (np.linalg.norm(outside(a.problem.y, a.problem.A)) for a in (plain, found))
    assert after < 0.05 * before


def test_known_second_order_terms_of_a_model_are_taken_off_the_data() -> None:
    name = "kuka_kr270"
    table = design(name, "deflection")
    data = measured(truth_of(name), replace(table, w=table.w * 12.0))
    plain = assemble(complete(name), data)
    grown = assemble(complete(name).with_effect(EffectInstance("large_deflection", {"robot": "all"})), data)
    before, after = (np.linalg.norm(outside(a.problem.y, a.problem.A)) for a in (plain, grown))
    assert after < 0.35 * before


def test_what_a_table_cannot_show_says_why() -> None:
    table = design("scara", "deflection")
    nothing = np.full(len(table), np.nan)
    table = replace(table, time=nothing, temperature=nothing, branch=nothing)
    reasons = {
        c.key: c.unavailable
        for c in assemble(complete("scara"), measured(truth_of("scara"), table)).candidates
    }
    assert "branch" in reasons["hysteresis@joint=2"]
    assert "temperature" in reasons["thermal_drift@measurement=frame"]
    assert "deflection data" in reasons["joint_offset@joint=2"]
    assert "combinations" in reasons["joint_compliance@joint=1"]
    assert reasons["backlash@joint=2"] == ""


def test_effects_that_add_the_same_columns_share_a_group() -> None:
    found = assemble(complete("scara"), measured(truth_of("scara"), design("scara", "deflection")))
    base, same = of(found, "base_compliance", {"link": 0}), of(found, "link_asymmetry", {"link": 0})
    assert base.group == same.group != ""
    assert of(found, "link_asymmetry", {"link": 1}).group != base.group


def test_columns_that_are_the_same_at_these_poses_alone_share_no_group() -> None:
    """With joint 3 always at one angle, drifts of the links before and behind it look the same, but only there."""
    table = design("ur10", "deflection")
    still = replace(table, q=np.where(np.arange(6) == 2, 0.7, table.q))
    found = assemble(complete("ur10"), measured(truth_of("ur10"), still))
    before, behind = (of(found, "thermal_drift", {"link": i}) for i in (2, 3))
    space = [c.columns(c.shapes[1]) for c in (before, behind)]
    assert np.linalg.norm(outside(space[1], space[0])) < 1e-6 * np.linalg.norm(space[1])
    assert before.group != behind.group


def test_a_model_of_joints_is_offered_the_compliance_of_links() -> None:
    data = measured(truth_of("kuka_kr270"), design("kuka_kr270", "deflection"))
    found = assemble(joints_only(load("kuka_kr270")), data)
    assert not of(found, "link_compliance", {"link": 2}).unavailable
    assert not of(found, "base_compliance", {"link": 0}).unavailable


def test_noise_columns_become_sigma_and_absent_ones_none() -> None:
    robot = load("scara")
    truth = Truth(robot, nominal_truth(robot))
    assert assemble(complete("scara"), measured(truth, design("scara", "deflection"))).problem.sigma is None
    noisy = replace(truth, noise=replace(truth.noise, sigma_mm=(0.02,) * 3))
    sigma = assemble(complete("scara"), simulate(noisy, design("scara", "deflection"), 1)).problem.sigma
    assert sigma is not None
    np.testing.assert_allclose(sigma, 2e-5)


def test_a_table_of_another_robot_or_without_measurements_is_refused() -> None:
    table = design("scara", "deflection")
    with pytest.raises(UserError, match="nothing measured"):
        assemble(complete("scara"), table)
    with pytest.raises(UserError, match="joint columns"):
        assemble(complete("kuka_kr270"), measured(truth_of("scara"), table))


def test_under_the_links_weights_a_joint_is_not_part_of_the_link_before_it_and_yet_in_the_complete_model() -> (
    None
):
    """A link's weight bends the link and does not turn the joint behind it."""
    raw = to_table(load("kuka_kr270"))
    for joint, mass in zip(raw["joint"], (600, 420, 260, 90, 40, 15), strict=True):
        joint["link"] |= {"mass": mass, "com": [-0.2, 0.05, 0.1]}
    robot = from_table(raw, "heavy")
    table = design("kuka_kr270", "absolute", poses=30)
    w = np.zeros_like(table.w)
    w[:, 2] = np.where(table.pose % 2 == 0, -200.0, -1500.0)
    truth = Truth(robot, nominal_truth(robot), (), device=Device())
    found = assemble(
        StiffnessModel.of(reduce(robot, "gravity", "position")), measured(truth, replace(table, w=w))
    )
    joints = [
        of(found, "joint_compliance", {"joint": j}) for j in (2, 3, 4, 5)
    ]  # the others' axes feel nothing
    assert all(c.unavailable for c in joints)


def test_a_link_that_is_told_to_be_rigid_has_no_asymmetry_alone_and_a_rigid_pedestal_is_no_beam() -> None:
    entry = to_table(load("scara"))
    entry["base"]["link"] = {"template": "rigid"}
    entry["joint"][1]["link"] = {"template": "rigid"}
    robot = from_table(entry, "scara")
    model = StiffnessModel.of(reduce(robot))
    found = assemble(model, measured(truth_of("scara"), design("scara", "deflection")))
    for link in (0, 2):
        assert "rigid" in of(found, "link_asymmetry", {"link": link}).unavailable
    assert of(found, "link_asymmetry", {"link": 1}).unavailable == ""
    assert "full block" in of(found, "link_compliance", {"link": 0}).unavailable
    assert of(found, "link_compliance", {"link": 2}).unavailable == ""
    assert of(found, "base_compliance", {"link": 0}).unavailable == ""


def test_what_the_second_order_term_leaves_is_of_third_order_rotations_of_a_sagged_arm_too() -> None:
    robot, rng = load("ur10"), np.random.default_rng(0)
    low, high = np.array([j.range for j in robot.joint]).T
    q, w = rng.uniform(low * 0.4, high * 0.4, (6, 6)), rng.normal(size=(6, 6)) * [60, 60, 60, 8, 8, 8]
    table = measurements(q, w, kind="deflection", values=np.zeros((6, 6)), joint_units=["rad"] * 6)
    left = []
    for size in (1.0, 0.1):
        values = {k: v * size for k, v in nominal_truth(robot).items()}
        read = simulate(Truth(robot, values, (), Noise((0.0,) * 3), components="pose"), table, 0).values
        view = look(robot, table)
        terms = terms_of(tuple(p for p in original(robot).parameters if p.name in values))
        situation = Situation(view, Laws(view, terms, values))
        linear = np.einsum("nrv,nv->nr", view.at_point, situation.theta)
        second = np.zeros((6, 6))
        column = catalogue()["large_deflection"].columns
        assert column is not None
        second[view.state, view.component] = column(situation, {"robot": "all"}, {})[:, 0]
        left.append(np.abs(read - linear - second).reshape(6, 2, 3).max(axis=(0, 2)))
    assert np.all(left[1] < 2e-3 * left[0])
