"""The error that a pose's rows share, in the deviations of an identification."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.estimate import estimate
from symstiff.calibration.robust import robust_estimate
from symstiff.calibration.shared import shared_error

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
        sizes.append(np.sqrt(found.shared_variance))
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
