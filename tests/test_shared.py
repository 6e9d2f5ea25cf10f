"""The error that a pose's rows share, in the deviations of an identification."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from symstiff.calibration.fits.constrained import constrain
from symstiff.calibration.fits.decomposition import own_columns
from symstiff.calibration.fits.estimate import estimate
from symstiff.calibration.fits.robust import robust_estimate
from symstiff.calibration.fits.shared import Blocks, Joints, _Components, _searched, shared_error
from symstiff.calibration.fitting import fit_model
from symstiff.calibration.simulation.experiment import simulate
from symstiff.calibration.simulation.truth import truth_from_table
from symstiff.calibration.tables.poses import with_markers
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load

POSES, CASES = 20, 4
ROWS = POSES * CASES * 3
BLOCK = np.repeat(np.arange(POSES * 3).reshape(POSES, 1, 3), CASES, axis=1).ravel()


def experiment(shared: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Columns that follow the load, values, deviations, and data with an error of ``shared`` sigmas in each block."""
    fixed, rng = np.random.default_rng(0), np.random.default_rng(seed)
    load = np.tile(np.repeat([0.25, 0.5, 0.75, 1.0], 3), POSES)
    A = fixed.normal(size=(POSES, 1, 3, 5)).repeat(CASES, axis=1).reshape(ROWS, 5) * load[:, None]
    sigma = 1e-5 * (1.0 + 0.5 * fixed.random(ROWS))
    truth = fixed.normal(size=5) * 1e-3
    y = A @ truth + sigma * rng.normal(size=ROWS) + shared * 1.25e-5 * rng.normal(size=POSES * 3)[BLOCK]
    return A, truth, sigma, y


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("robust", [True, False])
@pytest.mark.parametrize("shared", [0.0, 3.0])
def test_deviations_hold_what_the_rows_of_a_pose_share(shared: float, robust: bool, known: bool) -> None:
    z, careless = [], []
    for seed in range(60):
        A, truth, sigma, y = experiment(shared, seed)
        given = sigma if known else None
        if robust:
            fit = robust_estimate(A, y, given, list("abcde"), blocks=BLOCK).estimate
        else:
            fit = estimate(A, y, given, list("abcde"), blocks=BLOCK)
        z.append((fit.values - truth) / fit.std)
        careless.append((fit.values - truth) / estimate(A, y, given, list("abcde")).std)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)
    if shared:
        assert np.sqrt(np.mean(np.square(careless))) > 1.3


def test_its_size_is_found_and_independent_rows_share_none() -> None:
    sizes = []
    for seed in range(10):
        A, _, sigma, y = experiment(3.0, seed)
        found = estimate(A, y, sigma, list("abcde"), blocks=BLOCK).shared
        assert found is not None
        assert found.p_value < 1e-6
        sizes.append(np.sqrt(found.shared_variance(np.ones(ROWS, bool))))
    assert np.median(sizes) == pytest.approx(3.0, rel=0.2)
    quiet = [estimate(*_data(seed), list("abcde"), blocks=BLOCK).shared for seed in range(40)]
    assert sum(s is not None for s in quiet) <= 6


def _data(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    A, _, sigma, y = experiment(0.0, seed)
    return A, y, sigma


def test_rows_that_stand_alone_say_nothing_of_a_shared_error() -> None:
    A, _, sigma, y = experiment(3.0, 0)
    Q = np.linalg.qr(A / sigma[:, None])[0]
    assert shared_error(Q, y / sigma, np.arange(ROWS), sigma) is None
    assert shared_error(Q, y / sigma, BLOCK, sigma) is not None


POINTS, REPEATS = 3, 2


def of_several_points(pose: float, approach: float, unloaded: float, seed: int):
    """Three points of each pose, measured twice: an error of the pose, of each approach, of each zero reading."""
    fixed, rng = np.random.default_rng(1), np.random.default_rng(seed)
    shape = (POSES, CASES, REPEATS, POINTS, 3)
    load = np.array([0.25, 0.5, 0.75, 1.0])[None, :, None, None, None]
    A = fixed.normal(size=(POSES, 1, 1, POINTS, 3, 5)) * load[..., None] * np.ones((*shape, 1))
    truth = fixed.normal(size=5) * 1e-3
    noise = rng.normal(size=shape) + pose * rng.normal(size=(POSES, 1, 1, 1, 3))
    noise = noise + approach * rng.normal(size=(POSES, 1, REPEATS, 1, 3))
    noise = noise + unloaded * rng.normal(size=(POSES, 1, REPEATS, POINTS, 3))
    p, _, r, m, k = np.indices(shape).reshape(5, -1)
    come = p * REPEATS + r
    blocks = np.stack(
        [p * 3 + k, come * 3 + k, (p * POINTS + m) * 3 + k, (come * POINTS + m) * 3 + k], axis=1
    )
    return A.reshape(-1, 5), truth, (A @ truth + 1e-5 * noise).ravel(), blocks, p


@pytest.mark.slow
@pytest.mark.parametrize("errors", [(2.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0), (1.0, 1.0, 1.0)])
@pytest.mark.parametrize("robust", [True, False])
def test_what_a_pose_an_approach_and_a_point_share_is_told_apart(errors, robust: bool) -> None:
    z, ratios = [], []
    for seed in range(16):
        A, truth, y, blocks, _ = of_several_points(*errors, seed)
        fit = estimate(A, y, np.full(len(y), 1e-5), list("abcde"), blocks=blocks)
        if robust:
            fit = robust_estimate(A, y, np.full(len(y), 1e-5), list("abcde"), blocks=blocks).estimate
        assert fit.shared is not None
        z.append((fit.values - truth) / fit.std)
        ratios.append(fit.shared.ratios)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.2)
    pose, approach, beside, point = np.median(ratios, axis=0)
    assert (pose, approach, point) == pytest.approx(np.square(errors), abs=0.6 if max(errors) < 2 else 1.2)
    assert beside < 0.1


def test_deviations_hold_what_joints_move_that_stop_beside_their_targets() -> None:
    """Joints move a parameter's column most where it is their own: an error of each component alone says less of it."""
    rng = np.random.default_rng(2)
    pose = np.repeat(np.arange(POSES), CASES * 3)
    moved = np.repeat(rng.normal(size=(POSES, 1, 3, 5)) * [3.0, 2.0, 1.0, 0.5, 0.2], CASES, axis=1).reshape(
        ROWS, 5
    )
    A = moved * np.tile(np.repeat([0.25, 0.5, 0.75, 1.0], 3), POSES)[:, None]
    alone = Blocks.of(BLOCK)
    beside = Blocks(alone.labels, alone.kind, Joints(pose[:, None], moved))
    z: dict[bool, list[np.ndarray]] = {True: [], False: []}
    for _ in range(60):
        y = 1e-5 * (rng.normal(size=ROWS) + np.sum(moved * rng.normal(size=(POSES, 5))[pose], axis=1))
        for known, blocks in ((True, beside), (False, alone)):
            fit = estimate(A, y, np.full(ROWS, 1e-5), list("abcde"), blocks=blocks)
            z[known].append(fit.values / fit.std)
            assert fit.shared is not None
            assert fit.shared.mostly_joints == known
            if known:
                np.testing.assert_allclose(
                    fit.shared.covariance_times(np.eye(ROWS)), fit.shared.among(np.arange(ROWS)), atol=1e-9
                )
    of_each = np.sqrt(np.mean(np.square(z[True]), axis=0))
    assert of_each == pytest.approx(np.ones(5), abs=0.3)
    assert np.sqrt(np.mean(np.square(z[False]), axis=0)).max() > 1.4


def test_a_search_that_begins_among_some_poses_ends_where_one_among_all_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng, poses = np.random.default_rng(6), 500
    pose = np.repeat(np.arange(poses), 6)
    moved = np.repeat(rng.normal(size=(poses, 1, 3, 2)), 2, axis=1).reshape(-1, 2)
    blocks = Blocks.of(pose * 3 + np.tile([0, 1, 2], 2 * poses))
    both = Blocks(blocks.labels, blocks.kind, Joints(pose[:, None], moved))
    Q = np.linalg.qr(rng.normal(size=(len(pose), 4)))[0]
    z = rng.normal(size=len(pose)) + rng.normal(size=3 * poses)[blocks.labels[:, 0]]
    z += np.sum(moved * rng.normal(size=(poses, 2))[pose], axis=1)
    found = []
    for near in (50, 10**6):
        monkeypatch.setattr("symstiff.calibration.fits.shared._NEAR", near)
        found.append(shared_error(Q, z, both))
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].ratios == pytest.approx(found[1].ratios, rel=1e-3)
    assert found[0].ratios == pytest.approx((1.0, 2.0), rel=0.35)


def test_groupings_that_say_nothing_new_are_left_out() -> None:
    pose = np.repeat([0, 1, 2], 4)
    assert Blocks.of(np.stack([pose, pose + 7, 5 - pose, np.arange(12)], axis=1)).by_kind.shape == (12, 1)
    assert Blocks.of(np.stack([pose, np.arange(12) // 2], axis=1)).by_kind.shape == (12, 2)


def test_deviations_from_residuals_hold_a_shared_error_once() -> None:
    z = []
    for seed in range(60):
        A, truth, _, y = experiment(3.0, seed)
        scale = float(np.std(y - A @ np.linalg.lstsq(A, y, rcond=None)[0]))
        given = np.full(len(y), scale)
        z.append(
            (lambda f: (f.values - truth) / f.std)(
                estimate(A, y, given, list("abcde"), blocks=BLOCK, estimated=True)
            )
        )
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("shared", [0.0, 3.0])
def test_noise_that_rows_share_does_not_contradict_physics(shared: float, known: bool) -> None:
    """Springs that do not give way at all: half of the estimates fall below zero by noise alone."""
    names, low = ["c1", "c2", "c3", "c4", "c5"], 0
    for seed in range(60):
        A, truth, sigma, y = experiment(shared, seed)
        fit = estimate(A, y - A @ truth, sigma if known else None, names, blocks=BLOCK)
        low += constrain(fit).implausible_p < 0.05
    assert low <= 5
    A, truth, sigma, y = experiment(shared, 0)
    wrong = estimate(A, y - A @ (truth + 1e-3), sigma if known else None, names, blocks=BLOCK)
    assert constrain(wrong).implausible_p < 1e-6


@pytest.mark.slow
def test_poses_that_share_an_error_are_no_outliers_and_one_that_was_moved_is() -> None:
    suspects, found = 0, 0
    for seed in range(12):
        A, _, y, blocks, pose = of_several_points(3.0, 0.0, 0.0, seed)
        given = np.full(len(y), 1e-5)
        fit = robust_estimate(A, y, given, list("abcde"), groups=pose, blocks=blocks)
        suspects += bool(fit.poses) + bool(fit.rows)
        moved = robust_estimate(A, y + 4e-4 * (pose == 7), given, list("abcde"), groups=pose, blocks=blocks)
        found += [s.label for s in moved.poses] == ["pose 7"]
    assert suspects <= 1
    assert found >= 11


def test_many_rows_of_absolute_data_take_little_memory() -> None:
    columns = np.random.default_rng(0).normal(size=(30_000, 8))
    columns[:, 5] = columns[:, 1] - columns[:, 2]
    tracemalloc.start()
    kept = own_columns(columns, 1e-6)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert kept == [0, 1, 2, 3, 4, 6, 7]
    assert peak < 10 * columns.nbytes


@pytest.mark.slow
@pytest.mark.parametrize("uneven", ["poses", "kinds", "kinds apart"])
def test_a_shared_error_has_one_size_whatever_the_rows_own_sigma_is(uneven: str) -> None:
    """Of poses that are measured worse, or of translations and rotations, which may share as much or nothing."""
    z, axis = [], np.arange(ROWS) % 3
    for seed in range(60):
        A, truth, _, _ = experiment(0.0, 0)
        rng = np.random.default_rng(seed)
        sigma = np.where((BLOCK // 3) % 2 if uneven == "poses" else axis == 2, 1e-6, 1e-5)
        size = np.where(axis == 2, 0.0, 1e-5) if uneven == "kinds apart" else np.full(ROWS, 1e-5)
        y = A @ truth + sigma * rng.normal(size=ROWS) + size * rng.normal(size=POSES * 3)[BLOCK]
        kind = np.zeros(ROWS, dtype=np.intp) if uneven == "poses" else (axis == 2).astype(np.intp)
        fit = estimate(A, y, sigma, list("abcde"), blocks=Blocks(BLOCK[:, None], kind))
        z.append((fit.values - truth) / fit.std)
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.15)


def best(problem: _Components, start: np.ndarray) -> float:
    return float(
        scipy.optimize.minimize(
            lambda x: problem.fitted(np.exp(x))[0], start, method="Powell", bounds=[(-7.0, 10.0)] * len(start)
        ).fun
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_search_ends_at_the_least_deviance_wherever_it_begins(seed: int) -> None:
    """With the slope of too small a step it ends anywhere, and deviations differ by tens of percents."""
    A, _, y, blocks, _ = of_several_points(0.6, 0.4, 0.0, seed)
    given = Blocks.of(blocks)
    problem = _Components.of(np.linalg.qr(A)[0], y / 1e-5, given.wide, given.columns(None))
    count = given.by_kind.shape[1]
    least = best(problem, np.zeros(count))
    for start in (-2.0, 1.0, 4.0):
        assert problem.fitted(np.exp(_searched(problem, np.full(count, start))))[0] < least + 1e-3


@pytest.mark.slow
def test_a_large_error_does_not_hide_a_small_one_from_the_search() -> None:
    missed = 0
    for seed in range(6):
        A, _, y, blocks, _ = of_several_points(20.0, 0.5, 20.0, seed)
        Q, z = np.linalg.qr(A)[0], y / 1e-5
        found = shared_error(Q, z, blocks)
        assert found is not None
        given = Blocks.of(blocks)
        problem = _Components.of(Q, z, given.wide, given.columns(None))
        starts = np.random.default_rng(seed).uniform(-3.0, 7.0, (4, 4))
        least = min(best(problem, start) for start in starts)
        missed += problem.fitted(np.array(found.ratios))[0] > least + 0.01
    assert missed <= 1


def test_one_pose_that_was_measured_often_costs_the_others_nothing() -> None:
    poses, often = 40, 200
    pose = np.concatenate([np.repeat(np.arange(poses), 4), np.full(4 * often, poses)])
    come = np.concatenate([np.repeat(np.arange(poses), 4), poses + np.repeat(np.arange(often), 4)])
    blocks = Blocks.of(np.stack([pose, come], axis=1))
    rng = np.random.default_rng(0)
    Q = np.linalg.qr(rng.normal(size=(len(pose), 4)))[0]
    problem = _Components.of(Q, rng.normal(size=len(pose)), blocks.wide, blocks.columns(None))
    assert sum(batch.inner.size for batch in problem.batches) < 2 * (poses * 4 + (2 * often) ** 2)


@pytest.mark.slow
def test_no_parameters_deviation_is_far_too_small_where_joints_stop_beside_their_targets(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Repeated virtual experiments on a UR10: what its worst told parameter scatters by, over what is stated."""
    robot, poses = load("ur10"), 15
    rng = np.random.default_rng(33)
    q = np.array([rng.uniform(*joint.range, poses) for joint in robot.joint]).T
    w = np.zeros((poses, 3, 6))
    w[:, :, :3] = 60.0 * (d := rng.normal(size=(poses, 1, 3))) / np.linalg.norm(d, axis=2, keepdims=True)
    w *= np.array([0.4, 0.7, 1.0])[:, None]
    design = with_markers(np.repeat(q, 3, axis=0), w.reshape(-1, 6), ("p1", "p2", "p3"))
    design = replace(design, pose=np.repeat(np.arange(poses), 9), labels=tuple(f"p{k}" for k in range(poses)))
    noise = {"sigma_mm": 0.03, "approach_mrad": 0.05}
    truth = truth_from_table({"format": 1, "robot": "ur10", "noise": noise})
    tables = [simulate(truth, design, seed) for seed in range(60)]
    model = StiffnessModel.of(reduce(robot, "force", "position", points=("p1", "p2", "p3")))

    def worst() -> float:
        fits = [fit_model(model, table).estimate for table in tables]
        values, told = (np.array([getattr(fit, what) for fit in fits]) for what in ("values", "std"))
        return float(np.sqrt(np.mean(((values - values.mean(axis=0)) / told) ** 2, axis=0)).max())

    assert worst() < 1.35
    monkeypatch.setattr(
        "symstiff.calibration.fitting.moved_by_joints", lambda m, t, e: np.zeros((len(e.y), 6))
    )
    assert worst() > 1.4
