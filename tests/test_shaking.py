"""Markers of one reading that move together, as a load or a robot that is not still moves them, are noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Truth, nominal_truth
from symstiff.calibration.tables.measurements import Measurements, concatenate
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.noise import scales as noises
from symstiff.discrepancy.noise.shaking import Shaken, readings
from symstiff.discrepancy.noise.sharing import AXES, JOINTS, Sharing, Split
from symstiff.discrepancy.workflow import diagnose
from symstiff.report.verdict import verdict_table
from symstiff.robot import load
from tests.diagnosis_data import measured as small
from tests.test_assemble import complete, design, measured, truth_of

SIGMA = 3e-5


def shaken(table: Measurements, truth: Truth, seed: int, together: float) -> Measurements:
    """Readings whose noise has a part of its variance in common for the three markers of a load case."""
    rng = np.random.default_rng(seed)
    values = measured(truth, table).values.copy()
    values[:, 3:] = np.nan
    common = np.repeat(rng.normal(size=(len(table) // 3, 3)), 3, axis=0)
    values[:, :3] += SIGMA * (
        np.sqrt(together) * common + np.sqrt(1.0 - together) * rng.normal(size=(len(table), 3))
    )
    return replace(table, values=values, sigma=np.where(np.isfinite(values), SIGMA, np.nan))


def laboratory(poses: int = 28) -> Measurements:
    """Four loads a pose, three markers."""
    return design("ur10", "deflection", poses, (0.25, 0.5, 0.75, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_moves_all_markers_of_a_reading_is_no_missing_effect(seed: int) -> None:
    found = diagnose(Task(load("ur10"), shaken(laboratory(), truth_of("ur10"), seed, 0.64)))
    assert found.verdict == "nothing_missing"
    noise = found.first.noise
    assert noise.reading == pytest.approx(0.64, abs=0.12)
    assert noise.settling == ()
    assert noise.sigma == pytest.approx(SIGMA, rel=0.12)
    assert any("the markers of one reading share" in remark for remark in found.remarks)
    assert verdict_table(found)["noise"]["reading_share"] == noise.reading
    largest = max(found.steps[-1].strata, key=lambda s: s.degrees_of_freedom)
    assert largest.ratio == pytest.approx(1.0, abs=0.25)


@pytest.mark.slow
def test_an_effect_is_named_beside_what_moves_all_markers_of_a_reading() -> None:
    truth = Truth(
        load("ur10"), nominal_truth(load("ur10")),
        (Effect("nonlinear_stiffness", {"joint": 2}, "tanh", {"a": 4e-4, "tau0": 60.0}),),
    )  # fmt: skip
    found = diagnose(Task(load("ur10"), shaken(laboratory(), truth, 4, 0.5)))
    assert found.verdict == "named"
    assert [(e.effect, dict(e.where)) for e in found.effects] == [("nonlinear_stiffness", {"joint": 2})]
    assert found.first.noise.reading == pytest.approx(0.5, abs=0.15)


@pytest.mark.slow
def test_markers_that_read_alone_share_nothing() -> None:
    found = diagnose(Task(load("ur10"), shaken(laboratory(16), truth_of("ur10"), 5, 0.0)))
    assert found.first.noise.reading == 0.0
    assert not any("the markers of one reading" in remark for remark in found.remarks)


@pytest.mark.parametrize("markers", [0.0, 0.5])
def test_a_robot_that_comes_back_to_its_poses_for_every_repeat_does_not_shake(markers: float) -> None:
    """Five loads, three markers, three repeats: what a repeat's readings share is how the robot missed its pose.

    The markers of a reading share half of the noise's variance or none.
    """
    rng, tables = np.random.default_rng(70), []
    for k in range(3):
        table = small(poses=12, stated=1.0 / np.sqrt(1.0 - markers), seed=20 + k)
        reading = np.unique(np.column_stack([table.pose, table.w]), axis=0, return_inverse=True)[1]
        values = table.values.copy()
        values[:, :3] += 3e-5 * rng.normal(size=(12, 3))[table.pose]
        values[:, :3] += 2e-5 * np.sqrt(markers / (1.0 - markers)) * rng.normal(size=(60, 3))[reading]
        tables.append(replace(table, values=values, repeat=np.full(len(table), k + 1)))
    noise = diagnose(Task(load("planar2r"), concatenate(tables))).first.noise
    assert noise.reading == pytest.approx(markers, abs=0.1)
    assert noise.anew == pytest.approx(1.0, abs=0.15)
    assert noise.approach == pytest.approx(3e-5, rel=0.25)
    assert noise.ratio == pytest.approx(1.0, abs=0.06)
    assert noise.settling == ()
    assert not noise.misstated


@pytest.mark.parametrize("joints", [(), ((1, 3e-7), (4, 5e-6))])
@pytest.mark.parametrize("way", [AXES, JOINTS])
def test_roots_of_the_noise_are_those_of_its_covariance(
    way: str, joints: tuple[tuple[int, float], ...]
) -> None:
    """Against matrices put together entry by entry; uneven sigmas."""
    table = shaken(laboratory(4), truth_of("ur10"), 6, 0.5)
    problem = assemble(complete("ur10"), table, effects=()).problem
    sigma = SIGMA * (1.0 + 0.3 * np.sin(np.arange(problem.rows)))
    problem = replace(problem, sigma=sigma)
    plain, both = (noises.start(problem, Split(reading=r)) for r in (Shaken(), Shaken(0.8, joints)))
    sharing, eye = Sharing(way, 3.0), np.eye(problem.rows)
    colour = plain.apply(plain.root(sharing, 0.5), eye)
    u = np.sqrt(np.mean(sigma**2)) / sigma
    together = readings(problem)[:, None] == readings(problem)[None, :]
    covariance = colour @ colour.T + 0.8 * together * u[:, None] * u[None, :]
    pose_and_load = np.column_stack([problem.pose, problem.case])
    at_once = (pose_and_load[:, None] == pose_and_load[None, :]).all(axis=2)
    assert problem.J is not None
    for joint, variance in joints:
        moved = problem.J[:, problem.joint_of.index(joint)] / sigma
        covariance += variance * at_once * moved[:, None] * moved[None, :]
    found = both.apply(both.root(sharing, 0.5), eye)
    np.testing.assert_allclose(found @ found.T, covariance, atol=1e-9 * np.abs(covariance).max())
    white = both.apply(both.root(sharing, -0.5), eye)
    np.testing.assert_allclose(white @ found, eye, atol=1e-9)
    np.testing.assert_allclose(both.apply(both.root(sharing, -0.5)[::-1], eye), white.T, atol=1e-9)
    assert both.log_determinant(sharing) == pytest.approx(np.linalg.slogdet(covariance)[1])
