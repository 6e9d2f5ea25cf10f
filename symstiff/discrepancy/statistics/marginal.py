"""Evidence of an effect's columns against none: the noise's scale integrated, the effect's size averaged over.

Two beliefs about a group of columns count half each: that every direction of their space is as likely (the
g-prior), and that the parameters are as large as such parameters usually are. By the second, a block of many
parameters that data see in a few directions competes as those few, and a fit by unusual sizes is no evidence.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.sparse import csr_matrix

from symstiff.arrays import TINY, Array, Index

EXPECTED = (12.0, 48.0, 200.0, 1000.0)
"""Noncentralities that an effect is expected to have; the evidence averages over them."""
_FEW = 4000
"""Values of the evidence from which it is read from tables: draws have few ranks."""
_TABLE, _FARTHEST = 1 << 14, -float(np.log(1e-12))
"""Steps of a table, and -log(1 - R²) where it ends."""


def log_bayes(explained: Array, rss: Array, rank: Array, freedom: int) -> Array:
    """Evidence of a linear effect of given rank, all its directions alike; arrays broadcast.

    log BF = (n-k)/2 log(1+g) - n/2 log(1 + g(1-R²)), averaged over g = EXPECTED/k.
    """
    k = np.maximum(rank, 1.0)
    left = np.clip(1.0 - explained / np.maximum(rss, TINY), 1e-12, 1.0)
    n = float(freedom)
    total = np.full(np.broadcast_shapes(left.shape, k.shape), -np.inf)
    for expected in EXPECTED:
        g = expected / k
        total = np.logaddexp(total, 0.5 * (n - k) * np.log1p(g) - 0.5 * n * np.log1p(g * left))
    return np.asarray(np.where(rank > 0, total - np.log(len(EXPECTED)), -np.inf))


def of_ranks(share: Array, rank: Array, freedom: int) -> Array:
    """``log_bayes`` of shares R² (S, B) by ranks (S,), read between tabled values where there are many."""
    if share.size < _FEW:
        return log_bayes(share, np.ones_like(share), rank[:, None], freedom)
    ranks, which = np.unique(rank, return_inverse=True)
    value = np.stack([_table(float(r), freedom) for r in ranks]).astype(share.dtype)
    rise = np.diff(np.where(ranks[:, None] > 0, value, 0.0))  # the others stay at -inf
    with np.errstate(divide="ignore"):
        place = np.minimum(np.log1p(-np.clip(share, 0.0, 1.0)) * (-_TABLE / _FARTHEST), _TABLE)
    k = np.minimum(place.astype(np.int32), _TABLE - 1)
    place -= k
    row = which.astype(np.int32)[:, None]
    return np.asarray(value.ravel()[k + row * (_TABLE + 1)] + place * rise.ravel()[k + row * _TABLE])


@lru_cache(maxsize=256)
def _table(rank: float, freedom: int) -> Array:
    """(_TABLE + 1,) of a rank, even in log(1 - R²)."""
    explained = -np.expm1(-np.linspace(0.0, _FARTHEST, _TABLE + 1))
    return log_bayes(explained, np.ones_like(explained), np.array(rank), freedom)


def of_groups(values: Array, start: Index, weight: Array | None = None) -> Array:
    """Sums over groups of rows, (K, B) -> (S, B), with weights (W, K) (W·S, B); ``start`` (S,): first row of each."""
    rows = len(values)
    weight = (np.ones((1, rows)) if weight is None else weight).astype(values.dtype)
    ends = np.append(start, rows)[1:]
    first = np.concatenate([[0], *(ends + k * rows for k in range(len(weight)))])
    shape = (len(weight) * len(start), rows)
    which = np.tile(np.arange(rows), len(weight))
    return np.asarray(csr_matrix((weight.ravel(), which, first), shape=shape) @ values)


def of_sizes(shares: Array, variance: Array, start: Index, freedom: int) -> Array:
    """Evidence of groups of directions with variances of their own, that sum to one within a group.

    ``shares`` (K, B) of the residual's square by direction, ``variance`` (K,), ``start`` (S,) first direction of
    each group: (S, B). log BF = -Σ log(1+gv)/2 - n/2 log(1 - Σ gv/(1+gv) R²), averaged over g = EXPECTED.
    """
    gain = np.array(EXPECTED)[:, None] * variance
    seen = of_groups(shares, start, gain / (1.0 + gain)).reshape(len(gain), len(start), -1)
    price = 0.5 * np.add.reduceat(np.log1p(gain), start, axis=1)[:, :, None]
    each = -0.5 * freedom * np.log(np.clip(1.0 - seen, 1e-12, 1.0)) - price
    top = each.max(axis=0)
    return np.asarray(top + np.log(np.exp(each - top).mean(axis=0)))
