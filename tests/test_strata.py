"""The lack of fit by strata: what they share out, what shows in which, and p-values adjusted by Holm's definition."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from symstiff.arrays import Array
from symstiff.discrepancy.noise.scales import start
from symstiff.discrepancy.noise.sharing import Sharing, Split
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.statistics.bank import build
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.statistics.scan import open_scan
from symstiff.discrepancy.statistics.strata import lack_of_fit, strata
from tests.test_discrepancy_engine import arm, measured, scaled


def test_strata_know_loads_that_are_told_to_few_digits() -> None:
    """The model's columns are proportional to the load but for rounding: they stay within that stratum."""
    a = arm(15)
    jitter = 1.0 + 1e-4 * np.random.default_rng(3).normal(size=a.problem.A.shape)
    problem = measured(a.problem)
    exact, rounded = (
        {s.name: s.degrees_of_freedom for s in strata(p, prepare(p, ()).scan)}
        for p in (problem, replace(problem, A=problem.A * jitter))
    )
    assert exact == rounded


def test_strata_share_out_the_whole_residual() -> None:
    """Against nested dense least squares, rows that share nothing."""
    problem = measured(arm(10).problem)
    assert problem.time is not None
    assert problem.load is not None
    noise = replace(start(problem, Split()), sharings=(Sharing(),))
    parts = strata(problem, open_scan(build(problem, (), ()), noise, problem.y, problem.A))
    axes = (problem.axis[:, None] == np.unique(problem.axis)).astype(float)
    each = np.hstack([axes * (problem.pose == p)[:, None] for p in range(problem.poses)])
    clock = problem.time - problem.time.mean()
    further = {
        "time": np.hstack([axes * clock[:, None], axes * clock[:, None] ** 2]),
        "loading against unloading": each * problem.branch[:, None],  # type: ignore[index]
        "proportional to load, by pose": each * problem.load[:, None],
        "common to a pose's load cases": each,
        "nonlinear in load": each * problem.load[:, None] ** 2,
    }
    X, left = problem.A, [_left_of(problem, problem.A)]
    for columns in further.values():
        X = np.hstack([X, columns])
        left.append(_left_of(problem, X))
    assert [s.name for s in parts] == [*further, "rest"]
    assert [s.degrees_of_freedom for s in parts[:-1]] == [a[1] - b[1] for a, b in pairwise(left)]
    reference = left[-1][0] / left[-1][1]
    wanted = [(a[0] - b[0]) / reference for a, b in pairwise(left)]
    assert [s.sum_of_squares for s in parts[:-1]] == pytest.approx(wanted, rel=1e-6)
    assert parts[-1].sum_of_squares == pytest.approx(left[-1][1])


def _left_of(problem: Problem, X: Array) -> tuple[float, int]:
    """Sum of squares that columns leave, and its degrees of freedom."""
    scaled_to_one = X / np.linalg.norm(X, axis=0)
    fitted, _, rank, _ = np.linalg.lstsq(scaled_to_one, problem.y, rcond=1e-10)
    rest = problem.y - scaled_to_one @ fitted
    return float(rest @ rest), problem.rows - int(rank)


def test_load_nonlinearity_shows_in_its_own_stratum() -> None:
    a = arm(20)
    signal = scaled(a.problem, a.problem.J[:, 1] * a.problem.tau[:, 1] ** 3, 900.0)
    ready = prepare(measured(a.problem, signal), a.candidates)
    p = {s.name: s.p_value for s in strata(a.problem, ready.scan)}
    assert p["nonlinear in load"] < 1e-3


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


@pytest.mark.parametrize("levels", [(-1.0, -0.5, 0.5, 1.0), (-1.0, -0.6, -0.2, 0.2, 0.6, 1.0)])
def test_what_is_odd_in_the_load_is_told_as_nonlinear_and_hides_no_other_part(
    levels: tuple[float, ...],
) -> None:
    """A gear that hardens shows in no square of the load; without repeats the noise that was learned is the scale."""
    a = arm(20, levels=levels)
    signal = scaled(a.problem, a.problem.J[:, 1] * a.problem.tau[:, 1] ** 3, 900.0)
    problem = measured(a.problem, signal)
    ready = prepare(problem, a.candidates)
    told = {s.name: s for s in lack_of_fit(problem, ready.scan, ready.report)}
    assert told["nonlinear in load"].p_value < 1e-6
    assert told["proportional to load, by pose"].p_value < 1e-6
    clean = measured(a.problem)
    ready = prepare(clean, a.candidates)
    for s in lack_of_fit(clean, ready.scan, ready.report):
        assert s.ratio == pytest.approx(1.0, abs=4.5 * np.sqrt(2.0 / s.degrees_of_freedom))
        assert s.p_value is not None
