"""Backlash and an uneven stiffness in one gear: one law bends to most of both, and two laws explain them."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load

LOADS = (0.2, 0.4, 0.6, 0.8, 1.0)
TORQUE = 3000.0
"""Of the order of the largest load on the first joint [N·m]."""


def experiment(poses: int = 15, force: float = 1500.0) -> Measurements:
    """Loads from all sides in steps, three markers, on a robot whose first joint carries no weight."""
    robot, rng = load("kuka_kr270"), np.random.default_rng(4)
    limits = np.array([j.range for j in robot.joint])
    each = 3 * len(LOADS)
    side = rng.normal(size=(poses, 3))
    side *= force / np.linalg.norm(side, axis=1)[:, None]
    w = np.repeat(np.vstack([[*f * share, 0.0, 0.0, 0.0] for f in side for share in LOADS]), 3, axis=0)
    return measurements(
        np.repeat(rng.uniform(limits[:, 0], limits[:, 1], (poses, 6)), each, axis=0), w,
        pose=np.repeat(np.arange(poses), each), points=("p1", "p2", "p3"),
        point=np.tile(np.arange(3), poses * len(LOADS)), joint_units=["rad"] * 6,
    )  # fmt: skip


def diagnosed(*effects: Effect) -> Finding:
    robot = load("kuka_kr270")
    truth = Truth(robot, nominal_truth(robot), effects, Noise((0.015, 0.012, 0.018)))
    return diagnose(Task(robot, simulate(truth, experiment(), 7)))


GAP = Effect("backlash", {"joint": 1}, "arctan", {"gap": 2e-4, "knee": 0.02 * TORQUE})
SATURATING = Effect("nonlinear_stiffness", {"joint": 1}, "tanh", {"a": 5e-4, "tau0": 0.4 * TORQUE})
HARDENING = Effect("nonlinear_stiffness", {"joint": 1}, "polynomial", {"c3": -2.5e-14})
ROOT = Effect("nonlinear_stiffness", {"joint": 1}, "power", {"a": 1.5e-3, "tau0": TORQUE, "exponent": 0.6})


@pytest.mark.slow
@pytest.mark.parametrize("gear", [SATURATING, HARDENING])
def test_backlash_and_an_uneven_stiffness_of_one_gear_are_two_effects(gear: Effect) -> None:
    found = diagnosed(gear, GAP)
    assert found.verdict == "named"
    assert {(e.effect, e.where["joint"]) for e in found.named} == {
        ("nonlinear_stiffness", 1),
        ("backlash", 1),
    }
    gap = next(e for e in found.named if e.effect == "backlash").parameters["backlash_1_gap"].value
    assert gap == pytest.approx(2e-4, rel=0.5)


@pytest.mark.slow
def test_one_law_whose_shape_is_only_close_is_one_effect() -> None:
    found = diagnosed(ROOT)
    assert [(e.effect, e.where) for e in found.named] == [("nonlinear_stiffness", {"joint": 1})]
