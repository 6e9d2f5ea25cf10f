"""Criteria of a design, updates and exchange, against recomputing and every choice there is."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.calibration.planning.approximate import approximate_design
from symstiff.calibration.planning.criteria import Criterion, basis, best_gain, gains
from symstiff.calibration.planning.exchange import exchange, greedy


def information(rows: np.ndarray, chosen: tuple[int, ...]) -> np.ndarray:
    return sum(rows[:, i].T @ rows[:, i] for i in chosen)


def brute_score(matrix: np.ndarray, weight: np.ndarray | None) -> float:
    if weight is None:
        return float(np.linalg.slogdet(matrix)[1])
    return -float(np.trace(np.linalg.solve(matrix, weight)))


def criteria(width: int) -> tuple[Criterion, ...]:
    some = np.random.default_rng(9).normal(size=(width, width))
    return Criterion("D"), Criterion("A", np.eye(width) / width), Criterion("test", some @ some.T)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(0, 2))
def test_a_rank_k_update_equals_recomputing_the_criterion(seed: int, m: int, which: int):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(m, 12, 5))
    criterion = criteria(5)[which]
    base = rng.normal(size=(9, 5))
    before = base.T @ base + 0.1 * np.eye(5)
    predicted = gains(rows, basis(criterion, before))
    for j in range(12):
        change = brute_score(before + rows[:, j].T @ rows[:, j], criterion.weight) - brute_score(
            before, criterion.weight
        )
        assert predicted[j] == pytest.approx(change, rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_the_screened_search_finds_the_candidate_of_the_largest_gain(which: int):
    rows = np.random.default_rng(4).normal(size=(3, 20_000, 6)) * 0.3
    coordinates = basis(criteria(6)[which], np.eye(6))
    every = gains(rows, coordinates)
    barred = np.zeros(20_000, dtype=bool)
    barred[every.argmax()] = True
    second = np.argsort(-every)[1]
    assert best_gain(rows, coordinates, -np.inf)[0] == every.argmax()
    assert best_gain(rows, coordinates, -np.inf, barred) == (second, pytest.approx(every[second]))
    assert best_gain(rows, coordinates, float(every.max()) * 1.001)[0] == -1


@pytest.mark.parametrize("which", [0, 1, 2])
def test_exchange_from_several_starts_reaches_the_exhaustive_optimum(which: int):
    rng = np.random.default_rng(7)
    rows = rng.normal(size=(3, 16, 5)) * rng.uniform(0.2, 2.0, size=(1, 16, 1))
    criterion = criteria(5)[which]
    sets = list(itertools.combinations(range(16), 4))
    best = max(brute_score(information(rows, s), criterion.weight) for s in sets)
    starts = [greedy(rows, 4, criterion, 1e-9)]
    starts += [tuple(int(i) for i in rng.choice(16, 4, replace=False)) for _ in range(5)]
    found = max(exchange(rows, start, criterion).score for start in starts)
    assert found == pytest.approx(best, rel=1e-9)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_the_bound_of_the_approximate_design_holds_for_every_choice(which: int):
    rows = np.random.default_rng(3).normal(size=(2, 14, 4))
    criterion = criteria(4)[which]
    design = approximate_design(rows, criterion, 4, 0, 1e-9)
    best = max(
        brute_score(information(rows, s), criterion.weight) for s in itertools.combinations(range(14), 4)
    )
    assert best <= design.bound + 1e-6 * abs(design.bound)
    assert criterion.efficiency(best, design.bound, 4) > 0.8


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_exchange_never_lowers_the_criterion_and_keeps_poses_distinct(seed: int):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(2, 60, 6))
    found = exchange(rows, tuple(range(5)), Criterion("D"))
    assert np.all(np.diff(found.history) > 0)
    assert len(set(found.chosen)) == 5
    assert found.score == pytest.approx(brute_score(information(rows, found.chosen), None))
