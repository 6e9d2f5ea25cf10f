"""What data do not determine: dependent and drowned directions, too few rows, columns that nothing fills."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.calibration.doubts.soundness import check_determined, missing_information
from symstiff.calibration.fits.estimate import estimate
from symstiff.errors import UserError
from tests.small_chain import observation, sample, truth
from tests.test_estimate import ROW_SIGMA, identified


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(-3, 3).filter(lambda c: abs(c) > 1e-2))
def test_a_dependent_column_is_found_and_its_sum_with_the_others_stays_determined(seed, c):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(50, 6))
    A[:, 4] = c * A[:, 1] - 2.0 * A[:, 2]
    x = rng.normal(size=6)
    fit = estimate(A, A @ x, np.full(50, 1e-6), list("abcdef"))
    assert fit.rank.rank == 5
    assert fit.rank.gap > 1e8
    assert fit.rank.affected == ("b", "c", "e")
    assert np.isinf(fit.std[[1, 2, 4]]).all()
    assert np.isfinite(fit.std[[0, 3, 5]]).all()
    for combination in fit.combinations:
        weights = {combination.kept: 1.0} | combination.others
        exact = sum(weight * x["abcdef".index(name)] for name, weight in weights.items())
        assert combination.value == pytest.approx(exact, abs=1e-6)
        assert combination.std < 1e-5 * max(map(abs, weights.values()))
    np.testing.assert_allclose(A @ fit.values, A @ x, atol=1e-9)


def test_a_direction_drowned_in_noise_is_dropped_and_said_so_and_kept_on_demand():
    rng = np.random.default_rng(4)
    A = rng.normal(size=(60, 3))
    A[:, 2] = A[:, 1] + 1e-5 * rng.normal(size=60)
    y = A @ [1.0, 2.0, 3.0] + 0.1 * rng.normal(size=60)
    fit = estimate(A, y, np.full(60, 0.1), list("abc"))
    assert (fit.rank.rank, fit.rank.numerical_rank) == (2, 3)
    assert fit.rank.affected == ("b", "c")
    assert "noise" in str(fit.rank)
    assert estimate(A, y, np.full(60, 0.1), list("abc"), truncate="rounding").rank.rank == 3


def test_a_dropped_direction_leaves_open_what_it_would_at_least_double_the_variance_of():
    """Orthonormal columns but for the last, which is the one before it, a little of the others, and a rest of ε.

    With that direction the variance of a column of which δ is in the last one grows by the factor 1 + (δ/ε)².
    """
    rng, rest = np.random.default_rng(2), 1e-5
    basis = np.linalg.qr(rng.normal(size=(80, 7)))[0]
    shares = rest * np.array([0.5, 0.9, 1.2, 2.5, 5.0])
    last = basis[:, 5] + basis[:, :5] @ shares + rest * basis[:, 6]
    A, sigma = np.column_stack([basis[:, :6], last]), np.full(80, 1e-3)
    y = A @ np.ones(7) + sigma * rng.normal(size=80)
    fit, whole = (estimate(A, y, sigma, list("abcdefg"), truncate=by) for by in ("noise", "rounding"))
    assert (fit.rank.rank, whole.rank.rank) == (6, 7)
    grown = np.diag(whole.covariance) / np.diag(fit.covariance)
    np.testing.assert_allclose(grown[:5], 1.0 + (shares / rest) ** 2, rtol=1e-3)
    assert fit.rank.affected == tuple("cdefg") == tuple(np.array(list("abcdefg"))[grown > 2.0])


def test_too_few_rows_name_the_parameters_that_stay_open_and_what_would_help():
    A, x, kept, _ = identified(poses=30)
    few = estimate(A[:12], (A @ x)[:12], np.tile(ROW_SIGMA, 2), kept)
    message = missing_information(few.rank, kept, 12)
    assert message is not None
    assert message.startswith("12 measured values for 32 parameters; 12 of 32")
    assert "poses with more values of joint" in message
    with pytest.raises(UserError, match="do not determine the model"):
        check_determined(few.rank, kept, 12)
    full = estimate(A, A @ x, np.tile(ROW_SIGMA, 30), kept)
    assert missing_information(full.rank, kept, 180) is None


def test_a_joint_that_no_load_turns_asks_for_a_moment_about_its_axis():
    joints = [f"c{j}" for j in range(1, 7)]
    q, w = sample(20, 16, gravity=True)
    A = observation(q, w, joints)
    fit = estimate(A, A @ truth(joints), None, joints)
    assert fit.rank.silent == ("c1",)
    assert "a moment about the axis of joint 1" in str(missing_information(fit.rank, joints, 120))
    assert "a force along the axis of joint 1" in str(missing_information(fit.rank, joints, 120, {1}))
    told = str(missing_information(fit.rank, joints, 120, (), ("dx", "dy")))
    assert "in no reading: c1; needed:" in told
    assert told.endswith(", or dx and dy measured as well")


def test_what_one_axis_does_not_tell_apart_asks_for_the_others_first():
    """Under weights along z alone, read along z alone: more values of the joints change nothing."""
    A, x, kept, _ = identified(poses=30)
    few = estimate(A[:12], (A @ x)[:12], np.tile(ROW_SIGMA, 2), kept)
    told = str(missing_information(few.rank, kept, 12, (), ("dx", "dy")))
    assert told.endswith(
        "needed: dx and dy measured as well, or rotations: more poses alone may not tell them"
    )
    assert "more values of joint" not in told


def test_columns_that_no_row_fills_are_all_silent_and_nothing_overflows():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = estimate(np.zeros((9, 2)), np.ones(9), None, ["c1", "c2"])
    assert (fit.rank.rank, fit.rank.silent, fit.rank.affected) == (0, ("c1", "c2"), ("c1", "c2"))
