"""Identification at the level of arrays: least squares, rank, robustness, constraints, residuals, checks."""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.optimize
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.calibration.doubts.axes import assignment, axis_hint_refit, signed_permutations
from symstiff.calibration.doubts.soundness import check_loads, check_poses
from symstiff.calibration.fits.components import component_sigma
from symstiff.calibration.fits.constrained import constrain
from symstiff.calibration.fits.estimate import estimate, unit_of
from symstiff.calibration.fits.robust import robust_estimate
from symstiff.calibration.residuals import residual_table, split
from symstiff.errors import UserError
from symstiff.reduction.admissible import admissible_set
from tests.small_chain import names, observation, reduction, sample, truth

ROW_SIGMA = np.array([20e-6] * 3 + [10e-6] * 3)


def identified(poses: int = 30, seed: int = 0, gravity: bool = False):
    """A reduced observation matrix, its true parameters and names."""
    complete = names()
    values = truth(complete)
    P, kept = reduction(complete, np.abs(values), gravity)
    q, w = sample(poses, seed, gravity)
    A = observation(q, w, [complete[i] for i in kept])
    return A, P @ values, [complete[i] for i in kept], P


def test_noise_free_data_give_back_every_parameter_to_rounding():
    A, truth_, kept, _ = identified()
    fit = estimate(A, A @ truth_, np.tile(ROW_SIGMA, 30), kept)
    assert fit.rank.full
    np.testing.assert_allclose(fit.values, truth_, rtol=1e-8)


def test_the_estimate_agrees_with_an_independent_least_squares_solver():
    rng = np.random.default_rng(1)
    A, sigma = rng.normal(size=(200, 7)), rng.uniform(0.5, 2.0, 200)
    y = rng.normal(size=200)
    fit = estimate(A, y, sigma)
    W = np.diag(1 / sigma)
    np.testing.assert_allclose(fit.values, np.linalg.lstsq(W @ A, W @ y, rcond=None)[0], rtol=1e-10)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(A.T @ W @ W @ A), rtol=1e-9)
    unknown = estimate(A, y)
    slopes = scipy.optimize.curve_fit(lambda A, *p: A @ np.array(p), A, y, p0=np.zeros(7))
    np.testing.assert_allclose(unknown.std, np.sqrt(np.diag(slopes[1])), rtol=1e-5)
    half = scipy.stats.t.ppf(0.975, 193) * unknown.std
    np.testing.assert_allclose(unknown.upper - unknown.values, half, rtol=1e-10)


@pytest.mark.parametrize("known", [True, False])
def test_ninety_percent_intervals_hold_the_truth_ninety_times_in_a_hundred(known: bool):
    rng = np.random.default_rng(2)
    A, x = rng.normal(size=(12, 4)) * [1.0, 1e3, 1e-4, 10.0], np.array([1.0, 2e-3, 3e4, -0.1])
    inside = 0
    for _ in range(1500):
        fit = estimate(
            A, A @ x + 0.3 * rng.normal(size=12), np.full(12, 0.3) if known else None, confidence=0.9
        )
        inside += int(np.sum((fit.lower <= x) & (x <= fit.upper)))
    assert abs(inside / 6000 - 0.9) < 0.02


def test_deviations_are_those_of_repeated_experiments_on_a_robot():
    A, x, kept, _ = identified(poses=15)
    rng, sigma = np.random.default_rng(3), np.tile(ROW_SIGMA, 15)
    fits = [estimate(A, A @ x + sigma * rng.normal(size=len(sigma)), sigma, kept) for _ in range(400)]
    assert all(fit.rank.full for fit in fits)
    spread = np.std([fit.values for fit in fits], axis=0) / fits[0].std
    assert np.all(np.abs(spread - 1) < 0.2)
    p = np.array([fit.fit_p for fit in fits])
    assert 0.4 < np.mean(p) < 0.6


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(-9, 9), min_size=5, max_size=5), st.integers(-6, 6), st.integers(0, 10**6))
def test_units_of_parameters_and_measurements_change_no_prediction(powers, power, seed):
    rng = np.random.default_rng(seed)
    A, y = rng.normal(size=(40, 5)), rng.normal(size=40)
    units, unit = 10.0 ** np.array(powers), 10.0**power
    one, other = estimate(A, y, np.ones(40)), estimate(A * units * unit, y * unit, np.full(40, unit))
    np.testing.assert_allclose(other.values * units, one.values, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(other.std * units, one.std, rtol=1e-8)
    np.testing.assert_allclose(other.rank.singular_values, one.rank.singular_values, rtol=1e-8)


def test_metres_and_radians_are_weighed_by_what_their_residuals_show():
    A, x, kept, _ = identified(poses=60)
    rng, sigma = np.random.default_rng(5), np.tile(ROW_SIGMA, 60)
    y = A @ x + sigma * rng.normal(size=len(sigma))
    found = component_sigma(A, y, ["m", "m", "m", "rad", "rad", "rad"] * 60)
    assert found[0] == pytest.approx(20e-6, rel=0.2)
    assert found[3] == pytest.approx(10e-6, rel=0.2)
    weighed, plain = estimate(A, y, found, kept), estimate(A, y, None, kept)
    assert np.median(weighed.std / plain.std) < 1.0


def test_the_report_is_valid_json_with_units_and_no_infinities():
    A, x, kept, _ = identified()
    A[:, 3] = 0.0
    record = json.loads(json.dumps(estimate(A, A @ x, None, kept).to_dict(), allow_nan=False))
    assert record["parameters"][kept[3]]["std"] is None
    assert record["parameters"]["k0_22"]["unit"] == "m/N"
    assert record["rank"]["silent"] == [kept[3]]
    assert [unit_of(n) for n in ("k1_15", "k12_46", "c3", "backlash_3_gap")] == [
        "rad/N",
        "rad/(N*m)",
        "rad/(N*m)",
        "",
    ]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda A, y, s: (A[:-1], y, s), "one row each"),
        (lambda A, y, s: (A, np.where(np.arange(20) == 7, np.nan, y), s), "row 7 is not finite"),
        (lambda A, y, s: (A, y, np.where(np.arange(20) == 3, 0.0, s)), "sigma: row 3"),
        (lambda A, y, s: (A[:0], y[:0], None), "no measured value"),
    ],
)
def test_data_that_cannot_be_used_name_the_row_and_the_cause(change, words):
    rng = np.random.default_rng(0)
    with pytest.raises(UserError, match=words):
        estimate(*change(rng.normal(size=(20, 3)), rng.normal(size=20), np.ones(20)), list("abc"))


def test_huber_keeps_the_truth_where_least_squares_is_dragged_away():
    A, x, kept, _ = identified(poses=40)
    rng, sigma = np.random.default_rng(6), np.tile(ROW_SIGMA, 40)
    y = A @ x + sigma * rng.normal(size=len(sigma))
    poses = np.repeat(np.arange(40), 6)
    y[poses == 17] += 40 * sigma[poses == 17]
    y[5] += 100 * sigma[5]
    robust = robust_estimate(A, y, sigma, kept, groups=poses, labels=[f"P{i}" for i in range(40)])
    dragged = np.abs(estimate(A, y, sigma, kept).values - x)
    assert robust.converged
    assert np.max(np.abs(robust.estimate.values - x) / robust.estimate.std) < 5
    assert np.median(np.abs(robust.estimate.values - x) / dragged) < 0.6
    assert {s.label for s in robust.poses} == {"pose P17", "pose P0"}
    assert 5 in {s.rows[0] for s in robust.rows}
    json.dumps(robust.to_dict(), allow_nan=False)


def test_clean_data_raise_no_suspicion_and_lose_little_precision():
    rng, alarms, spread = np.random.default_rng(7), 0, []
    A, x, groups = rng.normal(size=(120, 5)), np.arange(5.0), np.repeat(np.arange(20), 6)
    for _ in range(300):
        fit = robust_estimate(A, A @ x + rng.normal(size=120), None, groups=groups)
        alarms += bool(fit.rows) + bool(fit.poses)
        spread.append((fit.estimate.values - x) / fit.estimate.std)
    assert alarms < 12
    assert np.std(spread) == pytest.approx(1.0, abs=0.08)


def test_an_exact_majority_is_reproduced_whatever_the_others_say():
    rng = np.random.default_rng(8)
    A, x = rng.normal(size=(90, 4)), np.array([1.0, -2.0, 3.0, 0.5])
    y = A @ x
    y[::9] += 5.0
    np.testing.assert_allclose(robust_estimate(A, y).estimate.values, x, atol=1e-6)


def test_nonnegative_joints_agree_with_bounded_least_squares_and_its_multipliers():
    rng = np.random.default_rng(9)
    A = rng.normal(size=(40, 5))
    y = A @ [1.0, -2.0, 0.5, -0.3, 2.0] + 0.1 * rng.normal(size=40)
    fit = estimate(A, y, np.full(40, 0.1), [f"c{j}" for j in range(1, 6)])
    bounded = constrain(fit, nominal={f"c{j}": 1.0 for j in range(1, 6)})
    oracle = scipy.optimize.lsq_linear(A, y, (0, np.inf), tol=1e-12)
    np.testing.assert_allclose(bounded.values, oracle.x, atol=1e-6)
    assert {a.label for a in bounded.active} == {"joint 2 (c2)", "joint 4 (c4)"}
    pull = A.T @ (A @ oracle.x - y) / 0.01  # gradient of ½χ²: equals the multipliers at the bounds
    for active, index in (("joint 2 (c2)", 1), ("joint 4 (c4)", 3)):
        assert bounded.multipliers[active].item() == pytest.approx(pull[index], rel=1e-4)
    assert bounded.chi2 == pytest.approx(2 * oracle.cost / 0.01, rel=1e-6)
    assert bounded.implausible_p < 1e-6


def test_a_link_at_its_bound_satisfies_the_optimality_conditions_and_agrees_with_ipopt():
    casadi = pytest.importorskip("casadi")
    rng = np.random.default_rng(10)
    kept = ["k2_22", "k2_66", "k2_26", "k2_11"]
    A, x = rng.normal(size=(60, 4)), np.array([1.0, 1.0, 1.4, -0.5])  # 1·1 < 1.4², k11 < 0
    y = A @ x + 0.01 * rng.normal(size=60)
    fit = estimate(A, y, np.full(60, 0.01), kept)
    found = constrain(fit, nominal=dict.fromkeys(kept, 1.0))
    k22, k66, k26, k11 = found.values
    K = np.array([[k22, k26], [k26, k66]])
    Z = found.multipliers["link 2 (k2_22, k2_26, k2_66)"]
    slope = A.T @ (A @ found.values - y) / 1e-4
    size = np.linalg.norm(slope)
    assert np.linalg.eigvalsh(K)[0] > -1e-7
    assert np.linalg.eigvalsh(Z)[0] > -1e-6 * size
    assert abs(np.trace(Z @ K)) < 1e-5 * size
    stationary = [Z[0, 0], Z[1, 1], 2 * Z[0, 1], found.multipliers["link 2 (k2_11)"].item()]
    np.testing.assert_allclose(slope, stationary, atol=1e-4 * size)
    assert k11 == pytest.approx(0.0, abs=1e-7)
    # The oracle writes the link as L·Lᵀ and k11 as a square.
    v = casadi.MX.sym("v", 4)
    p = casadi.vertcat(v[0] ** 2, v[1] ** 2 + v[2] ** 2, v[0] * v[1], v[3] ** 2)
    cost = casadi.sumsqr(casadi.DM(A) @ p - casadi.DM(y))
    solver = casadi.nlpsol("s", "ipopt", {"x": v, "f": cost}, {"ipopt.print_level": 0, "print_time": False})
    best = np.array(casadi.Function("p", [v], [p])(solver(x0=[1.0, 0.5, 0.5, 0.5])["x"])).ravel()
    np.testing.assert_allclose(found.values, best, atol=1e-4)


def test_data_from_an_admissible_robot_press_against_no_bound_beyond_the_noise():
    A, x, kept, P = identified(poses=40)
    rng, sigma = np.random.default_rng(11), np.tile(ROW_SIGMA, 40)
    fit = estimate(A, A @ x + sigma * rng.normal(size=len(sigma)), sigma, kept)
    complete = names()
    nominal = dict(zip(complete, truth(complete, seed=1), strict=True))
    found = constrain(fit, P, complete, nominal=nominal)
    assert found.chi2 >= found.free_chi2 - 1e-6
    assert found.implausible_p > 0.01
    np.testing.assert_allclose(P @ found.complete, found.values, rtol=1e-12)
    sizes = np.abs(truth(complete, seed=1))
    assert min(admissible_set(complete).smallest(found.complete, sizes).values()) > -1e-6
    assert np.max(np.abs(found.values - x) / fit.std) < 6


def test_deviations_from_the_residuals_make_no_test_of_the_fit_and_wider_intervals():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(9, 3))
    y = A @ [1.0, 2.0, 3.0] + 0.1 * rng.normal(size=9)
    given_, found = (estimate(A, y, np.full(9, 0.1), estimated=known) for known in (False, True))
    assert given_.fit_p is not None
    assert found.fit_p is None
    np.testing.assert_allclose(
        (found.upper - found.lower) / (given_.upper - given_.lower), 2.4469 / 1.95996, rtol=1e-4
    )


def test_noise_alone_seldom_makes_the_conditions_look_contradicted():
    """At the corner of the cone, where a matrix of two rows can go on in three directions."""
    rng, kept = np.random.default_rng(12), ["k2_22", "k2_66", "k2_26"]
    found = []
    for _ in range(160):
        A = rng.normal(size=(30, 3))
        fit = estimate(A, 0.1 * rng.normal(size=30), np.full(30, 0.1), kept)
        found.append(constrain(fit, nominal=dict.fromkeys(kept, 1.0)).implausible_p)
    assert np.mean(np.array(found) < 0.05) < 0.08
    assert np.mean(np.array(found) < 0.01) < 0.03


def test_residual_tables_count_axes_positions_and_the_compensated_share():
    measured = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, -1.0], [np.nan, 1.0, 1.0]])
    table = residual_table(measured, np.nan_to_num(0.9 * measured))
    assert table.before["positional"].max == pytest.approx(5.0)
    assert table.before["positional"].rms == pytest.approx(np.sqrt(26 / 2))
    assert table.before["y"].rms == pytest.approx(np.sqrt(17 / 3))
    assert table.compensated == pytest.approx(0.9)
    assert "rx" not in table.before


@given(
    st.lists(st.integers(0, 8), min_size=2, max_size=60).filter(lambda g: len(set(g)) > 1), st.integers(0, 99)
)
@settings(max_examples=40, deadline=None)
def test_all_rows_of_a_pose_are_held_out_together(groups, seed):
    groups = np.array(groups)
    fit, held = split(groups, 0.3, seed)
    assert not set(groups[fit]) & set(groups[held])
    assert sorted([*fit, *held]) == list(range(len(groups)))


@pytest.mark.parametrize("change", signed_permutations()[1:], ids=assignment)
def test_every_swap_of_the_measured_axes_is_named(change):
    A, x, kept, _ = identified(poses=40)
    rows = np.flatnonzero(np.arange(len(A)) % 6 < 3)
    true = (A @ x).reshape(-1, 6)[:, :3] + 1e-5 * np.random.default_rng(13).normal(size=(40, 3))
    positive = [name[0] == "c" or name[-1] == name[-2] for name in kept]
    hint = axis_hint_refit(A[rows], true @ change, positive=positive)
    assert hint is not None
    np.testing.assert_array_equal(hint.signed, change)


def test_axes_that_fit_as_they_are_give_no_hint_and_an_axis_turned_round_does():
    A, x, kept, _ = identified(poses=25)
    rows = np.flatnonzero(np.arange(len(A)) % 6 < 3)
    true = (A @ x).reshape(-1, 6)[:, :3] + 1e-5 * np.random.default_rng(14).normal(size=(25, 3))
    positive = [name[0] == "c" or name[-1] == name[-2] for name in kept]
    assert axis_hint_refit(A[rows], true, positive=positive) is None
    swap = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    hint = axis_hint_refit(A[rows], true @ swap, positive=positive)
    assert hint is not None
    np.testing.assert_array_equal(hint.signed, swap)
    negated = axis_hint_refit(A[rows], -true, positive=positive)
    assert negated is not None
    assert assignment(negated.signed) == "x = -x, y = -y, z = -z"
    assert axis_hint_refit(A[rows], -true, positive=positive, force=true) is not None
    another_robots = axis_hint_refit(
        A[rows], -true, positive=positive, force=-true
    )  # the forces do positive work
    assert another_robots is None


def test_loads_that_say_little_are_named_and_no_load_at_all_is_refused():
    down = np.tile([0, 0, -2500.0, 0, 0, 0], (5, 1))
    assert "one direction" in check_loads(down)[0]
    assert "carry no load" in check_loads(np.vstack([np.zeros(6), sample(5, 0)[1]]))[0]
    assert check_loads(sample(5, 0)[1]) == []
    with pytest.raises(UserError, match="every wrench is zero"):
        check_loads(np.zeros((4, 6)))


def test_a_pose_measured_again_under_a_new_name_is_a_warning():
    q, w = sample(4, 0)
    q[3], w[3] = q[1], w[1]
    assert "P4 = P2" in check_poses(q, w, ["P1", "P2", "P3", "P4"])[0]
    assert check_poses(q, w, ["P1", "P2", "P3", "P2"]) == []


def test_sixteen_thousand_poses_need_no_matrix_of_rows_by_rows():
    rng = np.random.default_rng(17)
    A = rng.normal(size=(96_000, 60)) * 10.0 ** rng.uniform(-9, -4, 60)
    x = 10.0 ** rng.uniform(-9, -4, 60)
    fit = estimate(A, A @ x + 1e-12 * rng.normal(size=96_000), None)
    assert fit.dof == 95_940
    assert np.max(np.abs(fit.values - x) / fit.std) < 5
