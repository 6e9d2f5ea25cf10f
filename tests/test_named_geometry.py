"""A start model that names errors of frames, fitted to the positions of another campaign."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from symstiff.calibration.identify import Identification, identify
from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.simulation.truth import Device
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel, joints_only
from symstiff.robot import load
from symstiff.robot.schema import Robot
from symstiff.robot.tool import tool_of, with_tool

ROBOT, POSES, SIGMA, OFFSET = load("kuka_kr270"), 30, 0.02, 1.2e-3
JOINTS = {name: value for name, value in nominal_truth(ROBOT).items() if name.startswith("c")}
PLACE = Device((3.0, 1.0, 0.5), (0.0, 0.0, 2.0))
JOINT = EffectInstance("joint_offset", {"joint": 2})


PROBE = with_tool(ROBOT, tuple(a + b for a, b in zip(tool_of(ROBOT), (0.05, -0.02, 0.1), strict=True)))


@cache
def campaign(seed: int, robot: Robot = ROBOT, force: float = 800.0) -> Measurements:
    """Random poses with three loads each, of an arm with one joint's zero off."""
    rng = np.random.default_rng(seed)
    limits = np.array([j.range for j in ROBOT.joint])
    q = np.repeat(rng.uniform(limits[:, 0], limits[:, 1], (POSES, ROBOT.dof)), 3, axis=0)
    w = np.zeros((3 * POSES, 6))
    w[:, :3] = rng.normal(size=(3 * POSES, 3)) * force
    w[::3] = 0.0
    plan = measurements(q, w, pose=np.repeat(np.arange(POSES), 3), kind="absolute")
    offset = Effect("joint_offset", {"joint": 2}, "constant", {"offset": OFFSET})
    return simulate(Truth(robot, JOINTS, (offset,), Noise((SIGMA,) * 3), device=PLACE), plan, seed)


def start(*effects: EffectInstance, **values: float) -> StiffnessModel:
    return joints_only(ROBOT, "wrench", "position").with_effects(effects).with_values({**JOINTS, **values})


def fitted(model: StiffnessModel, seed: int = 1) -> Identification:
    return identify(ROBOT, campaign(seed), model)


def off_by(found: Identification, name: str, truth: float) -> float:
    """A value's distance from the truth, in its deviations."""
    return abs(found.model.values[name] - truth) / found.model.deviations[name]


def test_a_named_offset_is_fitted_beside_the_placement_alone() -> None:
    found = fitted(start(JOINT, joint_offset_2_offset=1e-3))
    beside = set(found.fit.names) - set(found.model.parameters)
    assert beside == {f"geometry_0_{k}" for k in range(1, 7)}
    assert off_by(found, "joint_offset_2_offset", OFFSET) < 4.0
    assert all(
        off_by(found, name, value) < 4.5 for name, value in JOINTS.items() if name in found.model.deviations
    )
    assert any("errors of frames are those that the start model names" in r for r in found.remarks)


def test_it_has_the_value_that_a_diagnosis_gives_it() -> None:
    model = start(JOINT, joint_offset_2_offset=1e-3)
    told = diagnose(Task(ROBOT, campaign(2), model)).model
    found = fitted(model, 2).model
    for name in ("joint_offset_2_offset", "c2", "c3"):
        assert found.values[name] == pytest.approx(told.values[name], abs=0.3 * told.deviations[name]), name


def test_what_has_no_value_and_cannot_be_told_apart_stays_zero() -> None:
    """Frame 1 turns about joint 2's axis as the joint does: one of the two was told, the other one not."""
    frame = EffectInstance("geometric_error", {"link": 1})
    found = fitted(start(JOINT, frame, joint_offset_2_offset=1e-3))
    values, deviations = found.model.values, found.model.deviations
    lost = [p.name for p in frame.realise(ROBOT).parameters if p.name not in deviations]
    assert lost
    assert all(values[name] == 0.0 for name in lost)
    assert any("these positions do not tell" in r and lost[0] in r for r in found.remarks)
    assert off_by(found, "joint_offset_2_offset", OFFSET) < 4.0


def test_a_probe_that_nobody_told_of_is_placed_anew_as_far_as_the_model_leaves_it_free() -> None:
    """Its place is a shift of the last link: beside a model that names that link's error it is that error."""
    table, last = campaign(3, PROBE, 0.0), EffectInstance("geometric_error", {"link": 6})
    offset = start(JOINT, joint_offset_2_offset=1e-3)
    found = identify(ROBOT, table, offset)
    assert {"geometry_6_1", "geometry_6_2", "geometry_6_3"} <= set(found.fit.names)
    assert off_by(found, "joint_offset_2_offset", OFFSET) < 4.0
    with_last = start(JOINT, last, joint_offset_2_offset=1e-3, geometric_error_6_x=1e-4)
    found = identify(ROBOT, table, with_last)
    assert "geometric_error_6_x" in found.model.deviations
    assert sum(name.startswith("geometry_6") for name in found.fit.names) == 2


def test_a_model_that_names_no_frame_has_all_of_them_beside() -> None:
    found = fitted(start())
    assert len(set(found.fit.names) - set(found.model.parameters)) > 20
    assert any("constants of geometry and placement" in r for r in found.remarks)


def test_a_diagnosis_does_not_ask_for_poses_that_would_not_tell_frames_apart() -> None:
    frame = EffectInstance("geometric_error", {"link": 1})
    found = diagnose(Task(ROBOT, campaign(2), start(JOINT, frame, joint_offset_2_offset=1e-3)))
    remarks = " ".join(found.remarks)
    assert "geometric_error_1_rz" in remarks
    assert "or the place of the device" in remarks
    assert "more poses" not in remarks
