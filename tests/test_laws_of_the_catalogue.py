"""The catalogue's laws against pencil and paper: what one joint of a planar arm does under a load that is known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from symstiff.effects import EffectInstance, catalogue
from symstiff.effects.base import Scales
from symstiff.model import StiffnessModel, joints_only
from symstiff.robot import load, parse

TURNING = "format = 1\nname = 'turning'\n" + "[[joint]]\na = 1\nalpha = 0\nd = 0\n" * 3
ACROSS = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]
"""A force of one newton at the tip: one newton metre in joint 3, at which all angles are zero."""


def turned(
    effect: str, shape: dict[str, float], sizes: dict[str, float], load_: float, **context: Any
) -> float:
    """How far joint 3 turns by an effect of its own [rad], under a moment of so many N·m."""
    model: StiffnessModel = joints_only(parse(TURNING.encode()))
    model = model.with_effect(EffectInstance(effect, {"joint": 3}, shape))
    values = {f"{effect}_3_{name}": value for name, value in sizes.items()}
    moment = {k: [v] for k, v in context.items()}
    dt = model.deflection([[0.0] * 3], [[load_ * x for x in ACROSS]], values=values, context=moment)
    return float(dt[0, 5])


@pytest.mark.parametrize(
    ("effect", "shape", "sizes", "moment", "context", "expected"),
    [
        ("backlash", {"width": 1.0}, {"gap": 2e-4}, 500.0, {}, 1e-4),
        ("backlash", {"width": 1.0}, {"gap": 2e-4}, -500.0, {}, -1e-4),
        # friction lags: less deflection on the way up, more on the way down
        ("hysteresis", {"width": 1.0}, {"width": 2e-4}, 500.0, {"branch": 1.0}, -1e-4),
        ("hysteresis", {"width": 1.0}, {"width": 2e-4}, 500.0, {"branch": -1.0}, 1e-4),
        ("hysteresis", {"width": 1.0, "load": 2e3, "power": 0.5}, {"width": 2e-4}, 500.0, {"branch": -1.0}, 5e-5),
        ("hysteresis", {"width": 1.0, "loop": 1e3}, {"width": 2e-4}, 500.0, {"branch": -1.0}, 7.5e-5),
        # closed at the load where it turned: on the way down as on the way up there, and then more
        ("hysteresis", {"knee": 250.0}, {"width": 2e-4}, 500.0, {"turn": 1.0}, -1e-4 * 500 / 750),
        ("hysteresis", {"knee": 250.0}, {"width": 2e-4}, -500.0, {"turn": 1.0}, 1e-4 * 500 / 750),
        ("hysteresis", {"knee": 250.0}, {"width": 2e-4}, 500.0, {"turn": 2.0}, -1e-4 * 1000 / 1250 + 2e-4 * 500 / 1000),
        ("nonlinear_stiffness", {}, {"c2": 1e-10, "c3": 2e-13}, -500.0, {}, -2.5e-5 - 2.5e-5),
        ("nonlinear_stiffness", {"load": 200.0, "knee": 1.0}, {"c": 1e-7}, 500.0, {}, 3e-5),
        ("nonlinear_stiffness", {"load": 200.0, "saturation": 1.0}, {"c": 1e-7}, 500.0, {}, 2e-5 * math.tanh(2.5)),
    ],
)  # fmt: skip
def test_a_joint_turns_as_its_law_says(effect, shape, sizes, moment, context, expected):
    assert turned(effect, shape, sizes, moment, **context) == pytest.approx(expected, rel=1e-4)


def test_a_drift_has_grown_by_its_parameter_at_the_end_of_the_session():
    model = joints_only(parse(TURNING.encode()))
    name = "thermal_drift_frame_x"
    for shape, start, end in (
        ({"time": 600.0}, 0.0, 600.0),
        ({"time": 600.0, "T": 150.0}, 0.0, 600.0),
        ({"time": 600.0, "T": 150.0, "start": 1000.0}, 1000.0, 1600.0),
    ):
        drifting = model.with_effect(EffectInstance("thermal_drift", {"measurement": "frame"}, shape))
        dt = drifting.deflection(
            np.zeros((2, 3)), np.zeros((2, 6)), values={name: 1e-4}, context={"time": [start, end]}
        )
        np.testing.assert_allclose(dt[:, 0], [0.0, 1e-4], rtol=1e-8, atol=1e-16)


@pytest.mark.parametrize("constant", [0.05, 0.085, 0.11, 0.2, 0.42, 0.8])
def test_what_warms_up_within_a_part_of_the_session_is_in_the_profile(constant):
    """A time constant that is not, leaves most of a slow start or of a fast one, and another name takes it."""
    session = 14200.0
    shapes = catalogue()["thermal_drift"].shapes(load("ur10"), {"link": 2}, Scales(context={"time": session}))
    t = np.linspace(0.0, session, 60)

    def grown(shape):
        return 1.0 - np.exp(-t / shape["T"]) if "T" in shape else t / shape["time"]

    def left(law):
        X = np.column_stack([np.ones_like(t), law])
        truth = grown({"T": constant * session})
        rest = truth - X @ np.linalg.lstsq(X, truth, rcond=None)[0]
        return np.sum(rest**2) / np.sum((truth - truth.mean()) ** 2)

    assert min(left(grown(shape)) for shape in shapes) < 0.07


def test_coefficients_of_powers_of_the_load_have_the_units_of_these_powers():
    robot = load("scara")
    slide = next(j for j, joint in enumerate(robot.joint, start=1) if joint.prismatic)
    for joint, units in ((1, ["rad/(N*m)^2", "rad/(N*m)^3"]), (slide, ["m/N^2", "m/N^3"])):
        parameters = EffectInstance("nonlinear_stiffness", {"joint": joint}).realise(robot).parameters
        assert [p.unit for p in parameters] == units


def test_any_two_of_the_last_three_joints_may_share_gears():
    places = catalogue()["wrist_coupling"].places(load("kuka_kr270"))
    assert [p["joints"] for p in places] == [[4, 5], [4, 6], [5, 6]]


def test_a_loop_under_the_links_weight_closes_beyond_every_load_that_the_joint_can_carry():
    robot = load("ur10")
    shapes = catalogue()["hysteresis"].shapes(robot, {"joint": 2}, Scales())
    counted = [s["loop"] for s in shapes if "loop" in s and s.get("weights")]
    alone = [s["loop"] for s in shapes if "loop" in s and not s.get("weights")]
    # stretched out, upper arm, forearm and wrist load the shoulder by more than 100 N·m
    assert min(counted) > min(alone) + 100.0


@pytest.mark.parametrize(
    "shape",
    [
        {"load": 100.0, "power": 3.0},
        {"load": 100.0, "power": 0.5},
        {"load": 40.0, "knee": 1.0},
        {"load": 40.0, "saturation": 1.0},
    ],
)
@pytest.mark.parametrize("size", [1e-5, -1e-5])
def test_whether_a_gear_hardens_or_softens_is_told_by_its_slopes(
    shape: dict[str, float], size: float
) -> None:
    small, large = (
        turned("nonlinear_stiffness", shape, {"c": size}, x + 1.0)
        - turned("nonlinear_stiffness", shape, {"c": size}, x)
        for x in (2.0, 120.0)
    )
    told = "Here it softens." if large > small else "Here it hardens."
    assert catalogue()["nonlinear_stiffness"].sense(shape, {"nonlinear_stiffness_3_c": size}) == told
