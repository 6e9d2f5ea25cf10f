"""Friction whose loop closes where the load turned, by elements that stick and slip: hysteresis, and no creep.

The planar arm is moved by hand: its geometry and its friction share nothing with the laws that are tried.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.report.words import sentence
from symstiff.robot import load
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
