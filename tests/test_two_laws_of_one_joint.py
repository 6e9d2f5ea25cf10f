"""Two laws of one gear: backlash and an uneven stiffness, which one law bends to most of, and two waves a turn."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.statistics.bank import BESIDE, UNNAMED, build
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance
from symstiff.model import joints_only
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


def absolute(poses: int, force: float = 1500.0) -> Measurements:
    """One position a pose, under a force of any side."""
    robot, rng = load("kuka_kr270"), np.random.default_rng(1)
    limits = np.array([j.range for j in robot.joint])
    q = rng.uniform(limits[:, 0], limits[:, 1], (poses, 6))
    side = rng.normal(size=(poses, 6))[:, :3]
    w = np.zeros((poses, 6))
    w[:, :3] = force * side / np.linalg.norm(side, axis=1)[:, None]
    return measurements(q, w, pose=np.arange(poses), points=("p1",), point=np.zeros(poses, int), kind="absolute",
                        joint_units=["rad"] * 6)  # fmt: skip


@pytest.mark.slow
def test_two_waves_of_one_gear_that_hide_each_other_are_named() -> None:
    """Each is noise to the test of the other, of which forty positions hold little."""
    robot = load("kuka_kr270")
    waves = Effect(
        "transmission_error", {"joint": 2}, "harmonics",
        {"a": [1e-4, 3e-5], "b": [-5e-5, 9e-5], "harmonics": [3, 11]},
    )  # fmt: skip
    truth = Truth(robot, nominal_truth(robot), (waves,), Noise((0.06, 0.06, 0.06)))
    found = diagnose(Task(robot, simulate(truth, absolute(40), 1)))
    assert found.verdict == "named"
    assert [e.where for e in found.named] == [
        {"joint": 2, "harmonics": [3]},
        {"joint": 2, "harmonics": [11]},
    ]


def test_a_wave_makes_others_of_its_gear_likelier_and_the_priors_stay_a_distribution() -> None:
    robot = load("kuka_kr270")
    truth = Truth(robot, nominal_truth(robot), (), Noise((0.06, 0.06, 0.06)))
    assembly = assemble(joints_only(robot), simulate(truth, absolute(40), 1))
    bank = build(assembly.problem, assembly.candidates, ())
    wave = {
        (c.where["joint"], *c.where["harmonics"]): k
        for k, c in enumerate(bank.candidates)
        if c.effect == "transmission_error"
    }
    beside = bank.beside(bank, [wave[2, 3]])
    others = np.array([k for k in range(len(bank.candidates)) if k != wave[2, 3]])
    more = np.exp(beside.log_prior - bank.log_prior)
    assert more[wave[2, 11]] > 10 > 1 > more[wave[3, 11]] == pytest.approx(1 - BESIDE)
    before = 1 - UNNAMED - np.exp(bank.log_prior[wave[2, 3]])
    assert np.exp(beside.log_prior[others]).sum() == pytest.approx(BESIDE + (1 - BESIDE) * before)
    assert bank.beside(bank, []) is bank
    both = [
        bank.beside(bank, members).log_prior
        for members in ([wave[2, 3], wave[3, 5]], [wave[3, 5], wave[2, 3]])
    ]
    np.testing.assert_allclose(*both)
    assert both[0][wave[2, 11]] == pytest.approx(both[0][wave[3, 11]])


def test_a_wave_that_the_model_has_makes_others_of_its_gear_likelier() -> None:
    """As one that was found beside it does: a gear that was uneven in the last campaign is so in this one."""
    robot = load("kuka_kr270")
    truth = Truth(robot, nominal_truth(robot), (), Noise((0.06, 0.06, 0.06)))
    table = simulate(truth, absolute(40), 1)
    known = joints_only(robot).with_effect(
        EffectInstance("transmission_error", {"joint": 2, "harmonics": [3, 5]})
    )
    priors: list[dict[str, float]] = []
    for model in (joints_only(robot), known):
        assembly = assemble(model, table)
        bank = build(assembly.problem, assembly.candidates, ())
        priors.append(dict(zip((c.key for c in bank.candidates), np.exp(bank.log_prior), strict=True)))
        of_gear = [c for c in bank.candidates if c.effect == "transmission_error" and c.where["joint"] == 2]
    assert len(of_gear) == 30
    assert not {(3,), (5,)} & {tuple(c.where["harmonics"]) for c in of_gear}  # type: ignore[arg-type]
    bare, grown = priors
    assert sum(grown[c.key] for c in of_gear) > BESIDE
    assert grown[of_gear[0].key] > 10 * bare[of_gear[0].key]
    assert sum(grown.values()) == pytest.approx(BESIDE + (1 - BESIDE) * sum(bare.values()))
