"""Loading and unloading: what a table's branches mean where the load passes through zero."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.loading import as_loading, load_factor, turn_of
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.effects.instance import EffectInstance
from symstiff.model import joints_only
from symstiff.robot import load


def driven(*factors: float, branch: tuple[float, ...]) -> Measurements:
    w = np.array([[0.0, 3.0, -4.0, 0.0, 0.0, 0.0]]) * np.array(factors)[:, None]
    q = np.zeros((len(factors), 2))
    return measurements(q, w, pose=np.zeros(len(factors), int), branch=np.array(branch))


def test_a_load_driven_through_zero_falls_before_it_grows() -> None:
    table = driven(-1, -0.5, 0.5, 1, 0.5, -0.5, -1, branch=(1, 1, 1, 1, -1, -1, -1))
    found = as_loading(table)
    # the size of the load falls to zero and grows again, on both ways
    assert found.branch == pytest.approx([-1, -1, 1, 1, -1, 1, 1])
    assert np.array_equal(as_loading(found).branch, found.branch)


def test_the_way_up_may_go_to_negative_loads() -> None:
    table = driven(1, 0.5, -0.5, -1, -0.5, 0.5, 1, branch=(1, 1, 1, 1, -1, -1, -1))
    assert as_loading(table).branch == pytest.approx([-1, -1, 1, 1, -1, 1, 1])


def test_an_arm_that_had_no_load_is_loaded_before_its_load_runs_to_and_fro() -> None:
    table = driven(0.5, 1, 0.5, -0.5, -1, -0.5, 0.5, 1, branch=(1, 1, -1, -1, -1, 1, 1, 1))
    found = as_loading(table)
    assert found.branch == pytest.approx([1, 1, -1, 1, 1, -1, 1, 1])
    assert as_loading(found) is found


@pytest.mark.parametrize(
    ("factors", "branch"),
    [
        ((0.5, 1, 0.5), (1, 1, -1)),
        ((0.5, 1, -0.5, -1, -0.5), (1, 1, 1, 1, -1)),  # loaded from zero to both sides
        ((1, 0.5, -1, -0.5), (1, -1, 1, -1)),  # push and pull
        ((1, -1, 0.5, -0.5), (1, 1, -1, -1)),  # the same, sorted by branch
        ((-1, -0.5, 0.5, 1), (np.nan,) * 4),
        ((-1, -0.5, 0.5, 1), (1, 1, 1, 1)),  # never unloaded: nothing to tell
    ],
)
def test_tables_that_tell_loading_from_unloading_stay_as_they_are(
    factors: tuple[float, ...], branch: tuple[float, ...]
) -> None:
    table = driven(*factors, branch=branch)
    assert as_loading(table) is table


def test_a_short_way_there_and_back_is_driven_through_zero() -> None:
    table = driven(-1, 1, 0.5, -0.5, branch=(1, 1, -1, -1))
    found = as_loading(table)
    assert found.branch == pytest.approx([-1, 1, -1, 1])
    assert as_loading(found) is found


@pytest.mark.parametrize(
    ("factors", "branch"),
    [((-1, -0.5, 0.5, 1, 0.5, -0.5), (1, 1, 1, 1, -1, -1)), ((1, 0.5, -1, -0.5), (1, -1, 1, -1))],
)
def test_a_virtual_experiment_gives_back_the_loop_that_was_put_in(
    factors: tuple[float, ...], branch: tuple[float, ...]
) -> None:
    """Driven through zero, and by push and pull."""
    robot, rng, poses = load("ur10"), np.random.default_rng(3), 25
    q = np.repeat(rng.uniform(-2, 2, (poses, 6)), len(factors), axis=0)
    w = np.outer(np.tile(factors, poses), [30.0, 60.0, -100.0, 0.0, 0.0, 0.0])
    design = measurements(q, w, pose=np.repeat(np.arange(poses), len(factors)), branch=np.tile(branch, poses),
                          joint_units=["rad"] * 6)  # fmt: skip
    loop = Effect("hysteresis", {"joint": 3}, "constant", {"width": 1e-4})
    values = {n: 0.0 if n.startswith("k") else v for n, v in nominal_truth(robot).items()}
    made = simulate(Truth(robot, values, (loop,), Noise((0.002,) * 3)), design, 1)
    assert np.array_equal(made.branch, design.branch)
    law = EffectInstance("hysteresis", {"joint": 3}, {"width": 5.0, "weights": 1.0})
    found = identify(robot, made, joints_only(robot, "force", "pose").with_effect(law)).model
    assert found.values["hysteresis_3_width"] == pytest.approx(1e-4, rel=0.1)


def test_a_load_turned_where_it_was_largest_to_its_side() -> None:
    there_and_back = driven(
        0.25, 0.5, 1, 0.5, 0.25, -0.5, -1, -0.25, 0, branch=(1, 1, 1, -1, -1, 1, 1, -1, -1)
    )
    assert turn_of(there_and_back) == pytest.approx([1, 1, 1, 2, 4, 1, 1, 4, 1])
    assert turn_of(driven(0.5, 1, 1, branch=(1, 1, -1))) == pytest.approx([1, 1, 1])
    assert np.isnan(turn_of(driven(0.5, 1, branch=(np.nan, np.nan)))).all()


def test_a_way_down_alone_turned_at_the_largest_load_of_the_table() -> None:
    """As in a trajectory, whose rows are poses of their own."""
    q, w = np.zeros((3, 2)), np.zeros((3, 6))
    w[:, 2] = -100.0, -25.0, -50.0
    table = measurements(q, w, pose=np.arange(3), branch=np.array([1.0, -1.0, -1.0]))
    assert turn_of(table) == pytest.approx([1, 4, 2])


def test_load_factors_are_shares_of_the_largest_load_with_their_side() -> None:
    table = driven(-0.5, 0.25, 1.0, branch=(1, 1, 1))
    assert load_factor(table) == pytest.approx([-0.5, 0.25, 1.0])


def test_a_table_of_many_poses_is_split_once_with_the_same_result() -> None:
    rng = np.random.default_rng(3)
    n = 4000
    pose = rng.permutation(np.repeat(np.arange(n // 4), 4))
    w = rng.choice([-1.0, -0.5, 0.5, 1.0], n)[:, None] * np.array([0.0, 3.0, -4.0, 0.0, 0.0, 0.0])
    table = measurements(
        np.zeros((n, 2)),
        w,
        pose=pose,
        branch=rng.choice([1.0, -1.0], n),
        labels=[str(k) for k in range(n // 4)],
    )
    share = np.zeros(n)
    for number in np.unique(pose):
        rows = pose == number
        largest = w[rows][np.argmax(np.linalg.norm(w[rows], axis=1))]
        share[rows] = w[rows] @ largest / (largest @ largest)
    assert np.array_equal(load_factor(table), np.round(share, 9))
    one_by_one = np.array(table.branch)
    for number in np.unique(pose):
        rows = np.flatnonzero(pose == number)
        one_by_one[rows] = as_loading(table.select(rows)).branch
    assert np.array_equal(as_loading(table).branch, one_by_one)


class Counted(np.ndarray):
    """Numbers of poses that count how many of them are looked at."""

    looked_at = 0

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **more: Any) -> Any:
        plain = [np.asarray(x) for x in inputs]
        Counted.looked_at += max(x.size for x in plain)
        return getattr(ufunc, method)(*plain, **more)


def looked_at(poses: int) -> int:
    w = np.array([[0.0, 3.0, -4.0, 0.0, 0.0, 0.0]]).repeat(poses, axis=0)
    table = measurements(np.zeros((poses, 2)), w, pose=np.arange(poses), branch=np.ones(poses))
    table = replace(table, pose=np.arange(poses).view(Counted))
    Counted.looked_at = 0
    as_loading(table)
    return Counted.looked_at


def test_work_does_not_grow_with_the_square_of_the_poses() -> None:
    assert 0 < looked_at(400) <= 5 * looked_at(100)
