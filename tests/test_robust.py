"""Huber's estimate against his textbook."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.fits.robust import HUBER, robust_estimate


def test_the_deviations_of_a_robust_fit_count_how_few_rows_each_parameter_has():
    """Huber, Robust Statistics, 7.6: K²·(Σψ²/(n − p))/m²·(XᵀX)⁻¹, K = 1 + p/n·(1 − m)/m, m the share of ψ' = 1."""
    rng = np.random.default_rng(5)
    n, p = 24, 8
    A = rng.normal(size=(n, p))
    y = A @ rng.normal(size=p) + rng.standard_t(2, n)
    found = robust_estimate(A, y)
    z = (y - A @ found.estimate.values) / found.scale
    inside = np.mean(np.abs(z) <= HUBER)
    assert inside < 0.9  # else the factor says nothing
    spread = found.scale**2 * np.sum(np.clip(z, -HUBER, HUBER) ** 2) / (n - p)
    factor = 1.0 + p / n * (1.0 - inside) / inside
    expected = factor * np.sqrt(spread * np.diag(np.linalg.inv(A.T @ A))) / inside
    np.testing.assert_allclose(found.estimate.std, expected, rtol=1e-6)
