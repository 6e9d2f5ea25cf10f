"""Friction whose loop closes where the load turned, by elements that stick and slip: hysteresis, and no creep.

The planar arm is moved by hand: its geometry and its friction share nothing with the laws that are tried.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import look, under_weights
from symstiff.calibration.kept import completed, seen_in
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.base import Scales
from symstiff.effects.hysteresis import EFFECT, WITHIN
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.report.words import sentence
from symstiff.robot import Robot, load
from symstiff.symbolic.terms import actuated_joint
from tests.diagnosis_data import ROBOT, measured

THERE_AND_BACK = (0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25)
REACH, MARKERS = 0.7, np.array([[0.1, 0.0], [0.0, 0.1], [0.0, -0.1]])
SLIPS = np.array([0.04, 0.12, 0.3, 0.6])
"""Loads at which the elements slip, of the largest."""


def lagging(load_: np.ndarray, largest: float) -> np.ndarray:
    """How far the elements are dragged along (N,) by loads in order: each lets the load go ahead by where it slips."""
    slip = SLIPS * largest
    dragged, out = np.zeros(len(SLIPS)), np.zeros(len(load_))
    for k, now in enumerate(load_):
        dragged = np.clip(dragged, now - slip, now + slip)
        out[k] = dragged.mean()
    return out


def rubbed(size: float, poses: int = 16, seed: int = 3) -> Measurements:
    """Joint 2 also turns by what its friction lets through: ``size`` [rad] under the largest load."""
    table = measured(poses=poses, levels=THERE_AND_BACK, seed=seed)
    branch = np.repeat(np.tile(np.where(np.arange(len(THERE_AND_BACK)) < 4, 1.0, -1.0), poses), 3)
    tip = table.q[:, 0] + table.q[:, 1]
    moment = REACH * (np.cos(tip) * table.w[:, 1] - np.sin(tip) * table.w[:, 0])
    largest = float(np.abs(moment).max())
    turn = np.zeros(len(table))
    for pose in np.unique(table.pose):
        rows = np.flatnonzero((table.pose == pose) & (table.point == 0))
        for more in range(3):
            turn[rows + more] = size * lagging(moment[rows], largest) / largest
    values = table.values.copy()
    along, across = (MARKERS + np.array([REACH, 0.0]))[table.point].T
    values[:, 0] -= turn * (np.sin(tip) * along + np.cos(tip) * across)
    values[:, 1] += turn * (np.cos(tip) * along - np.sin(tip) * across)
    return replace(table, values=values, branch=branch)


def found(table: Measurements) -> Finding:
    return diagnose(Task(load(ROBOT), table))


def test_friction_that_sticks_and_slips_is_hysteresis_with_a_loop_that_closes() -> None:
    finding = found(rubbed(8e-4))
    assert [(e.effect, dict(e.where)) for e in finding.named] == [("hysteresis", {"joint": 2})]
    assert "knee" in finding.named[0].instance.shape
    assert finding.rms.after < 1.05 * finding.rms.noise


@pytest.mark.parametrize("kind", ["absolute", "deflection"])
def test_the_weight_does_not_turn_with_the_load_that_the_experiment_adds(kind: str) -> None:
    """An arm of 200 kg under 1 kN and less: by Masing's rule about the whole load of its shoulder."""
    robot, knee, share = heavy("kuka_kr270"), 300.0, np.array([0.25, 0.5, 1.0, 0.5, 0.25])
    wrench = np.outer(share, [0.0, 0.0, -1000.0, 0.0, 0.0, 0.0])
    table = measurements(
        np.tile([0.0, -1.0, 1.0, 0.0, 0.5, 0.0], (5, 1)), wrench,
        kind=kind, values=np.zeros((5, 6)), branch=[1, 1, 1, -1, -1], load_step=[1, 2, 3, 2, 1],
    )  # fmt: skip
    joint = actuated_joint(2)
    bare = look(robot, table)
    whole = under_weights(bare).tau[:, bare.index[joint]]
    own = whole - bare.tau[:, bare.index[joint]]
    assert np.all(np.abs(own) > 100.0)

    def from_rest(load_: np.ndarray) -> np.ndarray:
        return np.asarray(-load_ / (knee + np.abs(load_)) / 2)

    top = whole[2]
    back = from_rest(np.full(5, top)) - 2.0 * from_rest((top - whole) / 2)
    loop = np.where(table.branch > 0, from_rest(whole), back)
    view = under_weights(bare) if kind == "absolute" else bare
    counted = {"absolute": WITHIN, "deflection": 1.0}[kind]
    (term,) = EFFECT.realise(robot, {"joint": 2}, {"knee": knee, "weights": counted}).terms
    start = from_rest(own) if kind == "deflection" else 0.0
    np.testing.assert_allclose(view.factor(term.factor), loop - start, rtol=1e-9)


def heavy(name: str) -> Robot:
    """A robot of which the file tells the mass of link 2 alone."""
    robot = load(name)
    first, second, *rest = robot.joint
    weight = second.link.model_copy(update={"mass": 200.0, "com": (-0.6, 0.0, 0.0)})
    return robot.model_copy(update={"joint": (first, second.model_copy(update={"link": weight}), *rest)})


def test_positions_of_a_heavy_arm_try_loops_that_count_its_weight() -> None:
    robot, model = heavy("kuka_kr270"), StiffnessModel.of(reduce(heavy("kuka_kr270"), "gravity", "pose"))
    told = model.with_effects([EffectInstance("hysteresis", {"joint": 2}, {"knee": 300.0, "weights": 1.0})])
    (shown,) = seen_in(told, "absolute")[0].effects
    assert shown.shape == {"knee": 300.0, "weights": WITHIN}
    (kept,) = completed(seen_in(told, "absolute")[0], told, "absolute").effects
    assert kept.shape == {"knee": 300.0, "weights": 1.0}
    shapes = EFFECT.shapes(robot, {"joint": 2}, Scales("absolute", {actuated_joint(2): 1000.0}))
    assert {s.get("weights") for s in shapes} == {WITHIN}


def test_without_friction_nothing_is_missing() -> None:
    assert found(rubbed(0.0)).verdict == "nothing_missing"


def test_a_load_cell_that_lags_until_the_load_turns_is_no_joint() -> None:
    """Its loop closes at the largest load as well: what the tables call the load is another one on the way down."""
    levels = np.array(THERE_AND_BACK)
    told = measured(poses=30, levels=THERE_AND_BACK, seed=6)
    branch = np.repeat(np.tile(np.where(np.arange(len(levels)) < 4, 1.0, -1.0), 30), 3)
    share = np.repeat(np.tile(levels, 30), 3)
    read = told.w / (1.0 - 0.06 * branch * (1.0 - share))[:, None]
    finding = found(replace(told, w=read, branch=branch))
    assert (finding.verdict, finding.named) == ("unexplained", ())
    text = sentence(finding)
    assert "at the force sensor" in text
    assert "another one rising than falling, alike where it turns (−6" in text
