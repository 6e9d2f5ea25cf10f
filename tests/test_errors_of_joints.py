"""Joints that stand beside their targets: noise that all rows of a pose share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from symstiff.arrays import Array
from symstiff.discrepancy.examine import examine
from symstiff.discrepancy.noise.sharing import EACH, JOINTS, LEARNED, sizes
from symstiff.discrepancy.problem import Candidate, Parameter, Problem
from symstiff.discrepancy.statistics.prepare import prepare
from tests.test_discrepancy_engine import QUICK, SIGMA, arm, measured


def joints_elsewhere(problem: Problem, size: Sequence[float], seed: int) -> Array:
    """(M,) readings of joints that stand elsewhere in each pose, by ``size`` [rad] each."""
    assert problem.J is not None
    actuated = [v for v, j in enumerate(problem.joint_of) if j >= 0]
    angle = np.random.default_rng(seed).normal(size=(problem.poses, len(actuated))) * np.array(size)
    return np.asarray(np.einsum("mj,mj->m", problem.J[:, actuated], angle[problem.pose]))


@pytest.mark.slow
def test_joints_that_stand_elsewhere_raise_no_alarm() -> None:
    a = arm(30)
    size = [2e-5, 8e-5, 4e-5]
    found = [
        examine(measured(a.problem, joints_elsewhere(a.problem, size, s), s), a.candidates, QUICK)
        for s in range(10)
    ]
    assert [d.verdict for d in found].count("nothing_missing") >= 9
    assert [d.noise.shared for d in found].count(JOINTS) >= 9


def turning_unevenly(problem: Problem, joint: int, harmonic: int) -> Candidate:
    """A gear that runs ahead and behind with its angle, under every load."""
    assert problem.J is not None
    assert problem.q is not None
    J, q = problem.J[:, joint], problem.q[:, joint]
    columns = np.stack([J * np.sin(harmonic * q), J * np.cos(harmonic * q)], axis=1)
    sizes = (Parameter("a", "rad"), Parameter("b", "rad"))
    return Candidate("uneven", {"joint": joint + 1, "harmonic": harmonic}, sizes, lambda shape: columns)


@pytest.mark.slow
def test_what_one_joint_has_in_every_pose_does_not_pass_for_the_size_of_its_errors() -> None:
    """Where each joint's errors have a size of their own, one with an effect would seem to miss its poses by more."""
    a, found = arm(20), []
    gears = tuple(turning_unevenly(a.problem, joint, n) for joint in range(3) for n in range(1, 9))
    assert a.problem.J is not None
    assert a.problem.q is not None
    hidden = 2e-4 * a.problem.J[:, 1] * np.sin(5.0 * a.problem.q[:, 1] + 0.4)
    for seed in range(6):
        readings = joints_elsewhere(a.problem, [6e-5] * 3, seed) + hidden
        data = measured(a.problem, readings, seed, 2.0 * SIGMA)
        found.append(examine(data, (*gears, *a.candidates), QUICK))
    named = [d for d in found if d.verdict == "named"]
    assert len(named) >= 4
    assert all(
        [(e.effect, e.where) for e in d.effects] == [("uneven", {"joint": 2, "harmonic": 5})] for d in named
    )


@pytest.mark.parametrize(("sizes", "way"), [([1e-4] * 3, JOINTS), ([2e-4, 3e-5, 3e-5], EACH)])
def test_sizes_that_are_learned_of_each_joint_have_to_pay_for_it(sizes: list[float], way: str) -> None:
    """Of joints whose errors are alike what was learned of each fits better, by chance: that is not enough."""
    a = arm(30)
    for seed in range(4):
        readings = joints_elsewhere(a.problem, sizes, seed)
        found = prepare(measured(a.problem, readings, seed, 0.0), a.candidates)
        assert (found.scan.best.sharing.way in LEARNED) == (way == EACH)


@pytest.mark.parametrize("seed", range(4))
def test_errors_of_joints_and_of_axes_are_told_together(seed: int) -> None:
    a = arm(40)
    joints = joints_elsewhere(a.problem, [2e-4] * 3, seed)
    found = prepare(measured(a.problem, joints, seed, 6.0 * SIGMA), a.candidates)
    assert found.scan.best.sharing.way in LEARNED
    assert found.report.shared == JOINTS
    assert found.report.sigma == pytest.approx(SIGMA, rel=0.1)
    size = np.hypot(6.0 * SIGMA, np.sqrt(np.mean(joints**2)))
    assert found.report.approach == pytest.approx(size, rel=0.15)
    alone = max(
        v
        for v, x in zip(found.scan.log_likelihood, found.scan.layers, strict=True)
        if x.sharing.way not in LEARNED
    )
    assert found.scan.log_likelihood.max() > alone + 5.0


def test_the_variances_of_the_joints_errors_are_found() -> None:
    problem = arm(200).problem
    size = np.array([2e-5, 8e-5, 4e-5])
    y = joints_elsewhere(problem, list(size), 1) + SIGMA * np.random.default_rng(2).normal(size=problem.rows)
    spread = np.full(problem.rows, SIGMA)
    ratio = float(np.var(y)) / SIGMA**2 - 1.0
    found = np.array(sizes(problem, y, spread, 1.0, ratio, problem.pose))[:3]
    assert found / found[0] == pytest.approx((size / size[0]) ** 2, rel=0.45)


def test_what_each_marker_has_alone_is_told_from_the_joints_errors() -> None:
    poses, cases, joints, markers = 400, 3, 4, 3
    pose, case, channel = (g.ravel() for g in np.indices((poses, cases, 3 * markers)))
    rng = np.random.default_rng(5)
    J = rng.normal(size=(poses, 3 * markers, joints))[pose, channel] / np.sqrt(joints)
    angle = rng.normal(size=(poses, joints)) * np.sqrt([0.2, 0.8, 0.4, 0.4])
    alone = np.sqrt(0.3) * rng.normal(size=(poses, 3 * markers))[pose, channel]
    y = rng.normal(size=len(pose)) + np.einsum("mj,mj->m", J, angle[pose]) + alone
    problem = Problem(
        y, np.ones((len(pose), 1)), pose, case, channel, channel % 3, J=J, tau=np.zeros_like(J),
        virtual_joints=tuple(f"joint {j + 1}" for j in range(joints)), joint_of=tuple(range(joints)),
    )  # fmt: skip
    found = np.array(sizes(problem, y, np.ones(len(y)), 1.0, 0.5, problem.pose))
    assert found[:joints] == pytest.approx(np.mean(angle**2, axis=0), rel=0.3)
    assert found[joints] < 0.03
    assert found[-1] == pytest.approx(0.3, rel=0.25)
