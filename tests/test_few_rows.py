"""Stated probabilities hold in tables of few rows: intervals cover the truth, clean tables show no suspect."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.fits.components import component_sigma
from symstiff.calibration.fits.estimate import estimate
from symstiff.calibration.fits.robust import robust_estimate


@pytest.mark.parametrize("poses", [4, 5, 8])
def test_intervals_hold_with_few_rows_though_their_deviations_come_from_the_same_rows(poses):
    """19 parameters of 24 to 48 rows: a fit may pass through all translations and make their deviation zero."""
    rng = np.random.default_rng(poses)
    kinds, sigma = ["m", "m", "m", "rad", "rad", "rad"] * poses, np.tile([1e-5] * 3 + [3e-5] * 3, poses)
    inside, least = [], []
    for _ in range(150):
        A = (
            rng.normal(size=(6 * poses, 19))
            * np.linspace(0.1, 1.0, 19) ** np.tile([1.0] * 3 + [-1.0] * 3, poses)[:, None]
        )
        x = 1e-3 * rng.normal(size=19)
        y = A @ x + sigma * rng.normal(size=len(sigma))
        found = component_sigma(A, y, kinds)
        fit = estimate(A, y, found, estimated=True)
        inside.append((fit.lower <= x) & (x <= fit.upper))
        least.append(found[0])
    assert 0.93 <= np.mean(inside) <= 0.98
    assert np.min(np.mean(inside, axis=0)) > 0.86
    assert np.quantile(least, 0.05) > 1e-7


def test_intervals_count_the_degrees_of_freedom_of_the_rows_that_tell_a_parameter():
    """Two parameters that share no row: each has its own rows' deviation, with one degree of freedom less than rows."""
    rng, rows = np.random.default_rng(1), (40, 400)
    A = np.zeros((sum(rows), 2))
    A[: rows[0], 0], A[rows[0] :, 1] = rng.normal(size=rows[0]), rng.normal(size=rows[1])
    y = A @ [2.0, 3.0] + np.repeat([1.0, 0.5], rows) * rng.normal(size=sum(rows))
    fit = estimate(A, y, component_sigma(A, y, np.repeat(["m", "rad"], rows).tolist()), estimated=True)
    np.testing.assert_allclose(fit.freedom, [39, 399], rtol=0.1)
    alone = [estimate(A[a:b, [k]], y[a:b]).std[0] for k, (a, b) in enumerate([(0, 40), (40, 440)])]
    np.testing.assert_allclose(fit.std, alone, rtol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "columns", "tables"), [(30, 5, 1500), (60, 20, 1500), (600, 25, 300)])
def test_clean_tables_small_and_large_show_a_suspect_as_seldom_as_told(rows, columns, tables):
    """One in a hundred; the median of few residuals is a poorer scale than their mean square."""
    rng = np.random.default_rng(rows)
    A = rng.normal(size=(rows, columns)) * rng.choice(
        [1.0, 3.0], size=(rows, 1)
    )  # some rows are nearly fitted
    groups, found = np.arange(rows) // 6, []
    for _ in range(tables):
        fit = robust_estimate(A, rng.normal(size=rows), np.ones(rows), groups=groups)
        found.append((bool(fit.rows), bool(fit.poses)))
    assert np.all(np.sum(found, axis=0) <= 0.01 * tables + 2.33 * np.sqrt(0.01 * tables))
    assert np.sum(found) >= 0.004 * tables


def test_clean_tables_of_few_rows_raise_suspicion_as_often_as_told():
    """A scale from the median tells less than its degrees of freedom: with all of these it were twice as often."""
    rng, rows, poses = np.random.default_rng(1), 0, 0
    A, groups = rng.normal(size=(30, 6)), np.repeat(np.arange(10), 3)
    for _ in range(500):
        fit = robust_estimate(A, rng.normal(size=30), None, groups=groups, significance=0.05)
        rows += bool(fit.rows)
        poses += bool(fit.poses)
    assert 12 < rows < 38
    assert 12 < poses < 38
