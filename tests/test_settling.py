"""A joint that settles at another place at every reading: no effect, learned as noise, and told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.readings import experiment_of
from symstiff.calibration.identify import start_model
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.noise.shaking import shaken as learned
from symstiff.discrepancy.workflow import diagnose
from symstiff.report.verdict import verdict_table
from symstiff.report.words import headline, sentence
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured
from tests.test_assemble import design, truth_of
from tests.test_assemble import measured as measured_at


def shaken(
    table: Measurements, joint: int, size: float, by_pose: bool = False, seed: int = 5
) -> Measurements:
    """The planar arm's readings with a joint that stands off by another angle of that size at every load, or pose."""
    robot, rng = load(ROBOT), np.random.default_rng(seed)
    first, both = table.q[:, 0], table.q.sum(axis=1)
    elbow = float(robot.joint[0].a) * np.stack([np.cos(first), np.sin(first)], axis=1)
    marker = np.array(
        [next(m.xyz for m in robot.marker if m.name == table.points[k])[:2] for k in table.point], float
    )
    at = float(robot.joint[1].a) * np.eye(2)[0] + marker
    beyond = np.stack(
        [
            np.cos(both) * at[:, 0] - np.sin(both) * at[:, 1],
            np.sin(both) * at[:, 0] + np.cos(both) * at[:, 1],
        ],
        axis=1,
    )
    lever = beyond if joint == 2 else elbow + beyond
    keys = table.pose[:, None] if by_pose else np.column_stack([table.pose, table.w])
    number = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    angle = size * rng.standard_normal(number.max() + 1)[number]
    values = table.values.copy()
    values[:, 0] -= angle * lever[:, 1]
    values[:, 1] += angle * lever[:, 0]
    return replace(table, values=values)


def remarks_of(found: Finding) -> list[str]:
    """The remarks of a diagnosis on joints that stop elsewhere at every reading."""
    return [r for r in found.remarks if "stops elsewhere" in r]


def sizes_of(found: Finding) -> dict[int, float]:
    """Those joints, and by how much."""
    return {s.joint: s.std for s in found.last.noise.settling}


@pytest.mark.parametrize("joint", [1, 2])
def test_a_joint_that_sticks_and_slips_is_no_missing_effect_and_is_told(joint: int) -> None:
    found = diagnose(Task(load(ROBOT), shaken(measured(poses=14), joint, 4e-5)))
    assert found.verdict == "nothing_missing"
    assert sizes_of(found) == {joint: pytest.approx(4e-5, rel=0.25)}
    (remark,) = remarks_of(found)
    assert f"joint {joint} stops elsewhere at every reading of a pose, by 0.0" in remark
    (told,) = verdict_table(found)["noise"]["settling"]
    assert (told["joint"], told["unit"]) == (joint, "rad")
    assert told["std"] == sizes_of(found)[joint]


@pytest.mark.slow
def test_both_joints_are_told_where_both_do() -> None:
    found = diagnose(Task(load(ROBOT), shaken(shaken(measured(poses=24), 1, 8e-5), 2, 1.2e-4, seed=6)))
    assert sizes_of(found) == {1: pytest.approx(8e-5, rel=0.3), 2: pytest.approx(1.2e-4, rel=0.3)}


def test_a_joint_that_scatters_more_than_sigma_allows_is_where_the_unexplained_comes_from() -> None:
    found = diagnose(Task(load(ROBOT), shaken(measured(poses=14), 2, 3e-4)))
    assert (found.verdict, found.accused, found.effects) == ("unexplained", "joint 2", ())
    assert headline(found) == "Joint 2 stops elsewhere at every reading, which no law tells"
    assert sizes_of(found) == {2: pytest.approx(3e-4, rel=0.25)}
    assert "joint 2" in sentence(found).lower()
    assert "read each load several times" in sentence(found)
    assert not remarks_of(found)  # the verdict says so


def test_a_slide_is_told_in_millimetres() -> None:
    table, rng = design("scara", "deflection", 20, (0.3, 0.6, 1.0)), np.random.default_rng(9)
    values = measured_at(truth_of("scara"), table).values.copy()
    values[:, :3] += 3e-5 * rng.standard_normal((len(table), 3))
    stops = rng.standard_normal((20, 3))
    stops -= stops.mean(axis=1, keepdims=True)
    stops *= 1.2e-4 * np.sqrt(40 / np.sum(stops**2))  # about the means of the poses, as many are free
    values[:, 2] += np.repeat(stops.ravel(), 3)
    (settling,) = diagnose(Task(load("scara"), replace(table, values=values))).last.noise.settling
    assert (settling.joint, settling.slide) == (3, True)
    assert settling.std == pytest.approx(1.2e-4, rel=0.2)
    assert "mm (standard deviation)" in str(settling)


@pytest.mark.slow
def test_an_effect_is_named_beside_it_and_noise_and_missed_poses_are_not_taken_for_it() -> None:
    beside = diagnose(Task(load(ROBOT), shaken(measured(HARDENING, poses=14), 1, 4e-5)))
    assert [(e.effect, e.where) for e in beside.effects] == [("nonlinear_stiffness", {"joint": 2})]
    assert list(sizes_of(beside)) == [1]
    for table in (
        measured(HARDENING, poses=14),
        measured(poses=14),
        shaken(measured(poses=14), 2, 4e-5, by_pose=True),
    ):
        assert sizes_of(diagnose(Task(load(ROBOT), table))) == {}


def test_a_load_that_swings_is_no_joint_that_settles_anew() -> None:
    table, rng = measured(poses=14), np.random.default_rng(8)
    number = np.unique(np.column_stack([table.pose, table.w]), axis=0, return_inverse=True)[1].reshape(-1)
    swing = np.zeros((number.max() + 1, 6))
    swing[:, :3] = 6e-5 * rng.standard_normal((len(swing), 3))
    found = diagnose(Task(load(ROBOT), replace(table, values=table.values + swing[number])))
    assert found.last.noise.reading > 0.5
    assert sizes_of(found) == {}


def test_one_reading_that_slipped_is_no_habit_of_a_joint() -> None:
    """Under the same noise, without the look at single rows that leaves slips out before anything is learned."""
    table = measured(poses=14)
    slipped = shaken(table, 1, 2e-3).values - table.values
    one = (table.pose == 3) & (np.abs(table.w - table.w[table.pose == 3][0]).max(axis=1) < 1e-9)
    values = table.values + np.where(one[:, None], slipped, 0.0)
    problem = assemble(
        start_model(load(ROBOT), "complete", experiment_of(table, load(ROBOT)))[0],
        replace(table, values=values),
    ).problem
    z, spread = (
        problem.y - problem.A @ np.linalg.lstsq(problem.A, problem.y, rcond=None)[0],
        np.full(problem.rows, 2e-5),
    )
    assert np.abs(z).max() > 10 * 2e-5
    assert learned(problem, z / spread, spread, problem.pose).joints == ()
