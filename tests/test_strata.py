"""The p-values of the strata hold together: Holm's adjustment, written here once more from its definition."""

from __future__ import annotations

import pytest
from scipy import stats

from symstiff.discrepancy.prepare import prepare
from symstiff.discrepancy.strata import strata
from tests.test_discrepancy_engine import arm, measured, scaled


@pytest.mark.parametrize("noncentrality", [0.0, 30.0, 60.0])
def test_the_p_values_of_the_strata_are_adjusted_for_how_many_there_are(noncentrality: float) -> None:
    """Of m strata the k-th least p-value counts m + 1 - k times, and never less than one before it."""
    a = arm(20)
    signal = scaled(a.problem, a.problem.J[:, 1] * a.problem.tau[:, 1] ** 3, max(noncentrality, 1.0))
    problem = measured(a.problem, signal * (noncentrality > 0))
    *parts, reference = strata(problem, prepare(problem, a.candidates).scan)
    raw = [float(stats.f.sf(s.ratio, s.degrees_of_freedom, reference.degrees_of_freedom)) for s in parts]
    assert len(raw) >= 4
    for own, stratum in zip(raw, parts, strict=True):
        before = [(len(raw) - sum(q < p for q in raw)) * p for p in raw if p <= own]
        assert stratum.p_value == pytest.approx(min(1.0, max(before)), rel=1e-9)
    assert reference.p_value is None
