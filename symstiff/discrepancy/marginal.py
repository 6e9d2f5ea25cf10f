"""Evidence of an effect's columns against none: the noise's scale integrated, the effect's size averaged over.

Two beliefs about a group of columns count half each: that every direction of their space is as likely (the
g-prior), and that the parameters are as large as such parameters usually are. By the second, a block of many
parameters that data see in a few directions competes as those few, and a fit by unusual sizes is no evidence.
"""

from __future__ import annotations

import numpy as np

from symstiff.discrepancy.problem import Array, Index

EXPECTED = (12.0, 48.0, 200.0, 1000.0)
"""Noncentralities that an effect is expected to have; the evidence averages over them."""
_TABLE = 400
_FEW = 4000


def log_bayes(explained: Array, rss: Array, rank: Array, freedom: int) -> Array:
    """Evidence of a linear effect of given rank, all its directions alike; arrays broadcast.

    log BF = (n-k)/2 log(1+g) - n/2 log(1 + g(1-R²)), averaged over g = EXPECTED/k.
    """
    k = np.maximum(rank, 1.0)
    left = np.clip(1.0 - explained / np.maximum(rss, 1e-300), 1e-12, 1.0)
    n = float(freedom)
    total = np.full(np.broadcast_shapes(left.shape, k.shape), -np.inf)
    for expected in EXPECTED:
        g = expected / k
        total = np.logaddexp(total, 0.5 * (n - k) * np.log1p(g) - 0.5 * n * np.log1p(g * left))
    return np.asarray(np.where(rank > 0, total - np.log(len(EXPECTED)), -np.inf))


def of_rank(share: Array, rank: float, freedom: int) -> Array:
    """``log_bayes`` of shares R², by interpolation in log(1 - R²) where there are many: draws need few ranks."""
    if share.size < _FEW or rank == 0:
        return log_bayes(share, np.ones_like(share), np.array(rank), freedom)
    left = -np.log1p(-np.clip(share, 0.0, 1 - 1e-12))
    grid = np.linspace(0.0, float(left.max()) + 1e-12, _TABLE)
    return np.asarray(
        np.interp(left, grid, log_bayes(-np.expm1(-grid), np.ones(_TABLE), np.array(rank), freedom))
    )


def of_sizes(shares: Array, variance: Array, start: Index, freedom: int) -> Array:
    """Evidence of groups of directions with variances of their own, that sum to one within a group.

    ``shares`` (K, B) of the residual's square by direction, ``variance`` (K,), ``start`` (S,) first direction of
    each group: (S, B). log BF = -Σ log(1+gv)/2 - n/2 log(1 - Σ gv/(1+gv) R²), averaged over g = EXPECTED.
    """
    total = np.full((len(start), shares.shape[1]), -np.inf)
    for expected in EXPECTED:
        gain = expected * variance
        seen = np.add.reduceat(shares * (gain / (1.0 + gain))[:, None], start, axis=0)
        price = 0.5 * np.add.reduceat(np.log1p(gain), start)[:, None]
        total = np.logaddexp(total, -0.5 * freedom * np.log(np.clip(1.0 - seen, 1e-12, 1.0)) - price)
    return np.asarray(total - np.log(len(EXPECTED)))
