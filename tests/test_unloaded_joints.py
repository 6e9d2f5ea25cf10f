"""Joints that carry no load: rounding is no load of theirs, and laws of their angle are looked for all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.tables.measurements import measurements
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.search.localise import best_law
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.model import joints_only
from symstiff.robot import load
from tests.test_assemble import complete, design, measured, truth_of


def test_a_load_of_rounding_is_none() -> None:
    """A force through the axis of the last joint, in poses whose sines and cosines are rounded."""
    q = np.random.default_rng(4).uniform(-1.5, 1.5, (12, 6))
    down, read = np.tile([0.0, 0.0, -50.0, 0.0, 0.0, 0.0], (12, 1)), np.full((12, 6), 1e-4)
    table = measurements(q, down, values=read, kind="deflection")
    problem = assemble(joints_only(load("ur10")), table, effects=()).problem
    assert problem.tau is not None
    by_joint = {
        problem.virtual_joints[v]: np.abs(problem.tau[:, v]).max() for v in range(problem.tau.shape[1])
    }
    assert by_joint["joint 2"] > 1.0
    assert by_joint["joint 1"] == by_joint["joint 6"] == 0.0


def test_a_law_of_the_angle_is_found_at_a_joint_without_a_load() -> None:
    problem = assemble(
        complete("scara"), measured(truth_of("scara"), design("scara", "absolute", 30))
    ).problem
    assert problem.J is not None
    assert problem.tau is not None
    assert problem.q is not None
    v = problem.virtual_joints.index("joint 4")
    free = np.arange(problem.tau.shape[1]) != v
    wave = 3e-4 * np.sin(2.0 * problem.q[:, 3])
    noise = 2e-6 * np.random.default_rng(2).normal(size=problem.rows)
    moved = replace(problem, tau=problem.tau * free, y=problem.y + problem.J[:, v] * wave + noise)
    law = best_law(moved, prepare(moved, ()).scan, "joint 4")
    assert law is not None
    assert "sin(2*q4)" in law.expression
    assert law.tau_scale == 0.0
    assert np.std(law.values) == pytest.approx(np.std(wave), rel=0.2)
