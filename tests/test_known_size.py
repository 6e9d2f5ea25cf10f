"""An effect of known size that is too small to be looked for is counted as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.tables.measurements import Measurements
from tests.test_assemble import assemble, complete, design, measured, of, outside, truth_of

WHERE = {"robot": "all"}


def stated(table: Measurements, sigma: float) -> Measurements:
    """The table with a standard deviation of its positions [m], and noise of that size."""
    values = table.values + np.random.default_rng(1).normal(size=table.values.shape) * sigma
    return replace(table, values=values, sigma=np.where(np.isfinite(values), sigma, np.nan))


@pytest.fixture(scope="module")
def table() -> Measurements:
    """A heavy robot that gives way by millimetres, as the nonlinear simulator has it."""
    heavy = design("kuka_kr270", "deflection")
    return measured(truth_of("kuka_kr270"), replace(heavy, w=3.0 * heavy.w))


def noise_for(table: Measurements, noncentrality: float) -> float:
    """The noise [m] in which so much is to be seen of what is beyond the linear model."""
    problem = assemble(complete("kuka_kr270"), table, effects=()).problem
    return float(np.linalg.norm(outside(problem.y, problem.A)) / np.sqrt(noncentrality))


def test_what_is_too_small_to_be_seen_is_counted(table: Measurements) -> None:
    read = stated(
        table, noise_for(table, 6.0)
    )  # half as much again under an arm that the file may not tell of
    found = assemble(complete("kuka_kr270"), read)
    candidate = of(found, "large_deflection", WHERE)
    assert candidate.unavailable == "its known size is below the noise: it is counted as it is"
    assert candidate.counted is not None
    without = assemble(complete("kuka_kr270"), read, effects=())
    np.testing.assert_allclose(found.problem.y, without.problem.y - candidate.counted, atol=1e-12)
    signal, A = candidate.counted, without.problem.A
    clean = assemble(complete("kuka_kr270"), table, effects=()).problem
    assert np.linalg.norm(outside(clean.y - signal, A)) < 0.1 * np.linalg.norm(outside(clean.y, A))


def test_what_is_to_be_seen_is_looked_for_instead(table: Measurements) -> None:
    found = assemble(complete("kuka_kr270"), stated(table, noise_for(table, 40.0)))
    candidate = of(found, "large_deflection", WHERE)
    assert not candidate.unavailable
    assert candidate.counted is None


def test_a_shape_too_small_to_be_seen_is_not_looked_for(table: Measurements) -> None:
    """As of the arm without the weight that would make it visible: what fits there by another size is another thing."""
    kept = of(
        assemble(complete("kuka_kr270"), stated(table, noise_for(table, 8.0))), "large_deflection", WHERE
    )
    every = of(
        assemble(complete("kuka_kr270"), stated(table, noise_for(table, 40.0))), "large_deflection", WHERE
    )
    assert not kept.unavailable
    assert {} in every.shapes
    assert kept.shapes
    assert {} not in kept.shapes


def test_data_without_noise_are_no_reason_to_count_it(table: Measurements) -> None:
    """Deflections that a linear model computed have none of it, whatever noise the table states."""
    computed = assemble(complete("kuka_kr270"), table, effects=())
    exact = computed.problem.y - outside(computed.problem.y, computed.problem.A)
    values = table.values.copy()
    view = computed.situation.view
    values[view.state, view.component] = exact
    sigma = np.where(np.isfinite(values), noise_for(table, 9.0), np.nan)
    found = assemble(complete("kuka_kr270"), replace(table, values=values, sigma=sigma))
    assert of(found, "large_deflection", WHERE).counted is None
