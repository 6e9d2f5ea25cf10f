"""Gears see the weight of the arm, whether the robot file tells it or not."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sympy as sp

from symstiff.calibration.simulation import Effect, Truth, clean_response, nominal_truth
from symstiff.calibration.simulation.chain import chain_of
from symstiff.calibration.simulation.chain import posture as posture_of
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy import workflow
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.result import Diagnosis
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.arm import FARTHEST, MOMENTS, TAPERS, arm_load, assumed_arms, heaviest, own_load
from symstiff.effects.base import Scales
from symstiff.effects.registry import find
from symstiff.robot import Robot, load
from symstiff.symbolic.terms import actuated_joint, q

SIGMA = 2e-5
STEP = 1e-6
KNEE = {"c": 1.5e-5, "knee": 90.0}
LOADS = {"backlash": (0.33, 0.67, 1.0), "nonlinear_stiffness": (0.33, 0.67, 1.0)}
UP_AND_DOWN = (0.33, 0.67, 1.0, 0.67, 0.33)


def without_masses(robot: Robot) -> Robot:
    """The robot as a file without masses would tell it."""
    return weighing(robot, {i + 1: (0.0, (0.0, 0.0, 0.0)) for i in range(robot.dof)})


def weighing(robot: Robot, told: Mapping[int, tuple[float, tuple[float, ...]]]) -> Robot:
    """The robot with masses [kg] and centres of mass [m] of some links."""
    joints = list(robot.joint)
    for i, (mass, com) in told.items():
        link = joints[i - 1].link.model_copy(update={"mass": mass, "com": com})
        joints[i - 1] = joints[i - 1].model_copy(update={"link": link})
    return robot.model_copy(update={"joint": tuple(joints)})


def assert_named(found: Finding, effect: str, joint: int) -> None:
    """One gear was named, and nothing else."""
    assert found.verdict == "named"
    assert [(e.effect, e.where) for e in found.named] == [(effect, {"joint": joint})]


def experiment(
    effect: str,
    joint: int,
    shape: str,
    sizes: dict[str, Any],
    force: float = 110.0,
    robot: Robot | None = None,
    seed: int = 1,
) -> Measurements:
    """Deflections of an arm (a UR10) with its weights, under forces in random directions, with a hidden effect."""
    robot, rng = robot or load("ur10"), np.random.default_rng(seed)
    levels = LOADS.get(effect, UP_AND_DOWN)
    n, poses = len(levels), 30
    angles = rng.uniform(-2.8, 2.8, (poses, 6))
    direction = rng.normal(size=(poses, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    w = np.array([np.r_[force * f * s, 0, 0, 0] for f in direction for s in levels])
    more = {} if n == 3 else {"branch": np.tile([1, 1, 1, -1, -1], poses)}
    states = np.repeat(angles, n, axis=0)
    truth = Truth(robot, nominal_truth(robot), (Effect(effect, {"joint": joint}, shape, sizes),))
    read = clean_response(truth, states, w, {"kind": "deflection", **more})
    read[:, :3] += SIGMA * rng.normal(size=(len(w), 3))
    read[:, 3:] = np.nan
    return measurements(
        states, w, values=read, sigma=np.where(np.isnan(read), np.nan, SIGMA),
        pose=np.repeat(np.arange(poses), n), kind="deflection", joint_units=["rad"] * 6, **more,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "joint", "shape", "sizes"),
    [
        ("backlash", 2, "tanh", {"gap": 2e-4, "knee": 0.5}),
        ("nonlinear_stiffness", 2, "polynomial", {"c2": 2e-8}),
        ("nonlinear_stiffness", 3, "two_slope", {"c": 8e-6, "knee": 60.0}),
        ("hysteresis", 3, "constant", {"width": 2e-4, "knee": 3.0}),
    ],
)
def test_gears_are_named_where_the_file_tells_no_masses(
    effect: str, joint: int, shape: str, sizes: dict[str, Any]
) -> None:
    robot = load("ur10")
    found = diagnose(Task(without_masses(robot), experiment(effect, joint, shape, sizes)))
    assert_named(found, effect, joint)
    weight = sum(link.mass for link in robot.links)
    assert weight / 4 < found.named[0].shape["mass"] < 4 * weight
    assert any("the robot file tells no masses" in remark for remark in found.remarks)
    gap = found.named[0].parameters.get("backlash_2_gap")
    assert gap is None or gap.value == pytest.approx(2e-4, rel=0.15)


@pytest.mark.slow
def test_hysteresis_is_named_where_the_weight_is_many_times_the_load() -> None:
    table = experiment("hysteresis", 2, "constant", {"width": 1e-4, "knee": 1.0}, force=6.0)
    found = diagnose(Task(without_masses(load("ur10")), table))
    assert_named(found, "hysteresis", 2)
    assert found.named[0].parameters["hysteresis_2_width"].value == pytest.approx(1e-4, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("joint", "force", "knee"), [(3, 20.0, 4.0), (2, 50.0, 12.0)])
def test_a_step_as_wide_as_the_loads_is_backlash_where_the_weight_is_many_times_as_large(
    joint: int, force: float, knee: float
) -> None:
    table = experiment("backlash", joint, "tanh", {"gap": 5e-4, "knee": knee}, force=force)
    found = diagnose(Task(without_masses(load("ur10")), table))
    assert_named(found, "backlash", joint)


@pytest.mark.slow
@pytest.mark.parametrize("mass", [3.0, 6.0])
def test_the_hysteresis_of_a_quill_is_named_though_nobody_tells_what_it_weighs(mass: float) -> None:
    """A SCARA's sliding joint carries its quill, which has no length in the DH table."""
    bare, rng = load("scara"), np.random.default_rng(2)
    heavy = weighing(bare, {3: (mass, bare.joint[2].link.com)})
    low, high = np.array([j.range for j in bare.joint]).T
    states = np.repeat(rng.uniform(low, high, (30, 4)), 5, axis=0)
    direction = rng.normal(size=(30, 3)) * [0.4, 0.4, 1.0]
    w = np.array([np.r_[40.0 * f * s, 0, 0, 0] for f in direction for s in UP_AND_DOWN])
    branch = np.tile([1, 1, 1, -1, -1], 30)
    gear = Effect("hysteresis", {"joint": 3}, "sqrt", {"width": 6e-5, "knee": 3.0, "tau_ref": 40.0})
    values = clean_response(
        Truth(heavy, nominal_truth(heavy), (gear,)), states, w, {"kind": "deflection", "branch": branch}
    )
    values[:, :3] += SIGMA * rng.normal(size=(len(w), 3))
    values[:, 3:] = np.nan
    table = measurements(
        states, w, values=values, sigma=np.where(np.isnan(values), np.nan, SIGMA), pose=np.repeat(np.arange(30), 5),
        kind="deflection", joint_units=["m" if j.prismatic else "rad" for j in bare.joint], branch=branch,
    )  # fmt: skip
    found = diagnose(Task(bare, table))
    assert_named(found, "hysteresis", 3)
    assert found.rms.after == pytest.approx(SIGMA, rel=0.1)


def found_under(
    told: Mapping[int, tuple[float, tuple[float, ...]]],
    effect: str,
    joint: int,
    shape: str,
    sizes: dict[str, Any],
    seed: int = 1,
) -> Finding:
    """What is found of a KR 270's gear where the file does not tell its weights."""
    bare = load("kuka_kr270")
    return diagnose(Task(bare, experiment(effect, joint, shape, sizes, 1500.0, weighing(bare, told), seed)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "joint", "shape", "sizes"),
    [
        ("backlash", 2, "tanh", {"gap": 2e-4, "knee": 20.0}),
        ("backlash", 3, "tanh", {"gap": 2e-4, "knee": 20.0}),
        ("nonlinear_stiffness", 2, "two_slope", {"c": 1.5e-7, "knee": 3000.0}),
    ],
)
def test_an_arm_that_is_heavy_at_its_base_has_its_gears_named(
    effect: str, joint: int, shape: str, sizes: dict[str, Any]
) -> None:
    """Motors near the base, a light wrist: an even rod hangs too much of it at the elbow."""
    told = {
        1: (250.0, (-0.2, 0.0, 0.0)),
        2: (200.0, (-0.9, 0.0, 0.0)),
        3: (130.0, (0.0, 0.0, 0.1)),
        4: (15.0, (0.0,) * 3),
    }
    assert_named(found_under(told, effect, joint, shape, sizes), effect, joint)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "joint", "shape", "sizes"),
    [
        ("nonlinear_stiffness", 4, "polynomial", {"c2": 2e-9}),
        ("backlash", 4, "tanh", {"gap": 3e-4, "knee": 8.0}),
        ("hysteresis", 5, "constant", {"width": 3e-4, "knee": 8.0}),
    ],
)
def test_the_gears_of_a_wrist_are_named_though_its_weight_hangs_beside_their_axes(
    effect: str, joint: int, shape: str, sizes: dict[str, Any]
) -> None:
    """An arm along the axes loads them hardly; a forearm's motors and a valve block beside them do.

    In the first draw of the noise a bad pose stands beside the gap, just beyond the level of a second effect.
    """
    told = {
        2: (200.0, (-0.6, 0, 0)),
        3: (80.0, (0, 0, 0.1)),
        4: (150.0, (0, 0.15, 0.15)),
        5: (60.0, (0.1, 0.05, 0)),
    }
    found = found_under(told, effect, joint, shape, sizes, seed=2)
    assert_named(found, effect, joint)
    assert {"beside_axis", "towards"} <= found.named[0].shape.keys()
    assert any("a body that hangs beside the joint's axis" in remark for remark in found.remarks)


@pytest.mark.slow
def test_a_gear_that_no_assumed_arm_explains_is_told_to_want_masses() -> None:
    """A counterweight behind the shoulder that is heavier than the arm: no arm that is tried pulls the other way."""
    bare = load("kuka_kr270")
    robot = weighing(bare, {2: (900.0, (-2.4, 0.5, 0))})
    table = experiment("nonlinear_stiffness", 2, "polynomial", {"c2": 4e-11}, 1500.0, robot)
    blind, told = diagnose(Task(bare, table)), diagnose(Task(robot, table))
    wanted = "joint 2 carries the arm's weight, which the robot file does not tell"
    assert blind.verdict in ("unexplained", "named_insufficient")
    assert any(wanted in remark for remark in blind.remarks)
    assert ("nonlinear_stiffness", {"joint": 2}) in [(e.effect, e.where) for e in told.named]
    assert not any(wanted in remark for remark in told.remarks)


@pytest.mark.parametrize("name", ["kuka_kr270", "franka_panda", "puma560", "scara"])
def test_a_body_beside_an_axis_loads_its_joint_as_a_mass_on_its_link_does(name: str) -> None:
    """Against the height of a point on the link in the simulator's geometry, by differences."""
    robot = load(name)
    chain = chain_of(robot)
    at = np.random.default_rng(1).uniform(-1, 1, robot.dof)
    for joint in (j for j in range(1, robot.dof + 1) if not robot.joint[j - 1].prismatic):
        for towards in (0.0, 2.1):

            def height(angles: np.ndarray, joint: int = joint, towards: float = towards) -> float:
                found = posture_of(chain, angles[None], np.zeros((1, chain.size)))
                turn = found.after[0][0]
                axis = turn[joint - 1][:, 2]
                x = turn[joint][:, 0]
                return float((np.cos(towards) * x + np.sin(towards) * np.cross(axis, x))[2])

            step = STEP * np.eye(robot.dof)[joint - 1]
            expected = -9.80665 * (height(at + step) - height(at - step)) / (2 * STEP)
            own = own_load(robot, joint, {"beside_axis": 2.0, "towards": towards})
            law = sp.lambdify([q(i + 1) for i in range(robot.dof)], own)
            assert float(law(*at)) == pytest.approx(2.0 * expected, abs=3e-3)


@pytest.mark.parametrize("taper", TAPERS.values())
@pytest.mark.parametrize("name", ["kuka_kr270", "franka_panda", "puma560", "scara"])
def test_an_arms_load_is_that_of_a_rod_that_is_even_or_thins_out(name: str, taper: float) -> None:
    """Against the height of the rod's centre in the simulator's geometry, by many short pieces and differences."""
    robot = load(name)
    chain = chain_of(robot)
    at = np.random.default_rng(0).uniform(-1, 1, robot.dof)

    def height(angles: np.ndarray) -> float:
        found = posture_of(chain, angles[None], np.zeros((1, chain.size)))
        points = np.vstack([found.after[1][0], found.at(chain.tool)])
        lengths = [*np.hypot(chain.a, chain.d), np.linalg.norm(chain.tool)]
        strokes = [*(np.ptp(j.range) if j.prismatic else 0.0 for j in robot.joint), 0.0]
        whole, begin, mass, moment = sum(lengths) + sum(strokes), 0.0, 0.0, 0.0
        for (a, b), length, stroke in zip(itertools.pairwise(points[:, 2]), lengths, strokes, strict=True):
            for stretch, low, high in ((length, a, b), (stroke, b, b)):
                part = (np.arange(2000) + 0.5) / 2000
                weight = (1.0 - taper * (begin + part * stretch) / whole) * stretch / 2000
                mass, moment = mass + weight.sum(), moment + weight @ (low + part * (high - low))
                begin += stretch
        return float(moment / mass)

    for joint in range(1, robot.dof + 1):
        step = STEP * np.eye(robot.dof)[joint - 1]
        expected = -9.80665 * (height(at + step) - height(at - step)) / (2 * STEP)
        law = sp.lambdify([q(i + 1) for i in range(robot.dof)], arm_load(robot, joint, taper))
        assert float(law(*at)) == pytest.approx(expected, abs=2e-3)


def test_masses_are_tried_where_they_matter_and_are_not_known() -> None:
    bare = without_masses(load("ur10"))
    scales = Scales("deflection", {actuated_joint(j): 100.0 for j in range(1, 7)})
    most = [largest for _, largest in assumed_arms(bare, 2, scales)]
    assert most == pytest.approx([100.0 * (1.0 + m) for _ in TAPERS for m in MOMENTS], rel=0.05)
    assert assumed_arms(bare, 1, scales) == ()  # an upright axis
    assert assumed_arms(load("ur10"), 2, scales) == ()
    assert assumed_arms(bare, 2, Scales("absolute", scales.load)) == ()
    tried = [arm for j in range(1, 7) for arm, _ in assumed_arms(bare, j, scales)]
    assert all(arm[name] <= heaviest(bare) for arm in tried for name in TAPERS if name in arm)
    beside = [(j, arm) for j in range(1, 7) for arm, _ in assumed_arms(bare, j, scales) if "towards" in arm]
    assert {j for j, _ in beside} == {4, 5, 6}  # the joints whose axes the arm follows
    assert all(arm["beside_axis"] <= FARTHEST * bare.reach * heaviest(bare) for _, arm in beside)
    assert assumed_arms(bare, 6, Scales("deflection", {actuated_joint(6): 1e5})) == ()
    for effect in ("backlash", "hysteresis", "nonlinear_stiffness"):
        for name in TAPERS:
            assert any(name in s for s in find(effect).shapes(bare, {"joint": 2}, scales))
            assert not any(name in s for s in find(effect).shapes(load("ur10"), {"joint": 2}, scales))


@pytest.mark.slow
def test_what_is_assumed_is_said_once_and_of_what_the_verdict_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    table = experiment("backlash", 2, "tanh", {"gap": 2e-4, "knee": 0.5})
    whole = workflow.examine

    def several(*args: Any, **keys: Any) -> Diagnosis:
        found = whole(*args, **keys)
        again = tuple(replace(e, set_number=1) for e in found.effects)
        elsewhere = tuple(replace(e, where={"joint": 3}, set_number=1) for e in found.effects)
        return replace(found, verdict=verdict, effects=(*found.effects, *again, *elsewhere))

    monkeypatch.setattr(workflow, "examine", several)
    told = {}
    for verdict in ("named", "ambiguous"):
        remarks = diagnose(Task(without_masses(load("ur10")), table)).remarks
        told[verdict] = [r.split(":")[0] for r in remarks if "tells no masses" in r]
    assert told == {
        "named": ["backlash at joint 2"],
        "ambiguous": ["backlash at joint 2", "backlash at joint 3"],
    }


@pytest.mark.slow
def test_a_gear_may_bend_where_only_load_and_weight_together_reach() -> None:
    """The file tells the masses: the joint bears three times what the load alone puts on it."""
    found = diagnose(Task(load("ur10"), experiment("nonlinear_stiffness", 2, "two_slope", KNEE, force=50.0)))
    assert_named(found, "nonlinear_stiffness", 2)
    assert found.named[0].shape["load"] == pytest.approx(KNEE["knee"], rel=0.1)
