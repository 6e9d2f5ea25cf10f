"""The approximate design: weights on candidates instead of a choice, and the bound that it proves.

Where poses may be measured in fractions the problem is convex; its solution bounds every exact design and
shows which candidates matter. Solved by the multiplicative algorithm on a working set that grows by the
candidates which violate the optimality condition.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from symstiff.calibration.planning.criteria import Criterion, basis, directional

_ROUNDS = 4
_STEPS = 30
_WORKING = 2000


@dataclass(frozen=True)
class Approximate:
    """Support (indices), weights that sum to one, the bound of any exact score, every derivative (N,)."""

    support: np.ndarray
    weights: np.ndarray
    bound: float
    derivative: np.ndarray


def approximate_design(
    rows: np.ndarray, criterion: Criterion, poses: int, seed: int, ridge: float
) -> Approximate:
    """Return a nearly optimal approximate design of ``poses`` poses on candidates (m, N, P).

    ``ridge`` is added to the information matrix while the working set may be rank-deficient.
    """
    count, width = rows.shape[1:]
    working = np.random.default_rng(seed).choice(count, min(count, _WORKING), replace=False)
    weights = np.full(len(working), 1.0 / len(working))
    bound, derivative = np.inf, np.zeros(count)
    for _ in range(_ROUNDS):
        local = np.ascontiguousarray(rows[:, working])
        weights = _multiply(local, weights, criterion, ridge)
        information = poses * _weighted(local, weights) + ridge * np.eye(width)
        derivative = directional(rows, basis(criterion, information))
        score = criterion.score(information)
        bound = min(bound, criterion.bound(score, float(derivative.max()), poses, width))
        working, weights = _grow(working, weights, derivative)
    used = weights > 0
    return Approximate(working[used], weights[used] / weights[used].sum(), bound, derivative)


def _multiply(rows: np.ndarray, weights: np.ndarray, criterion: Criterion, ridge: float) -> np.ndarray:
    identity = np.eye(rows.shape[2])
    power = 1.0 if criterion.weight is None else 0.5
    for _ in range(_STEPS):
        information = _weighted(rows, weights) + ridge * identity
        weights = weights * directional(rows, basis(criterion, information)) ** power
        weights = weights / weights.sum()
    return weights


def _weighted(rows: np.ndarray, weights: np.ndarray) -> np.ndarray:
    flat = (rows * np.sqrt(weights)[None, :, None]).reshape(-1, rows.shape[2])
    return np.asarray(flat.T @ flat)


def _grow(working: np.ndarray, weights: np.ndarray, derivative: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Keep what carries weight, take in the candidates of the largest derivative."""
    carried = weights > 1e-6
    best = np.argsort(-derivative, kind="stable")[: _WORKING // 2]
    merged = np.union1d(working[carried], best)
    new = np.full(len(merged), 1e-3 / len(merged))
    new[np.searchsorted(merged, working[carried])] += weights[carried]
    return merged, new / new.sum()
