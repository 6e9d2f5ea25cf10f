"""Evidence of an effect's columns against none: the noise's scale integrated, the effect's size averaged over.

Two beliefs about a group of columns count half each: that every direction of their space is as likely (the
g-prior), and that the parameters are as large as such parameters usually are. By the second, a block of many
parameters that data see in a few directions competes as those few, and a fit by unusual sizes is no evidence.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix

from symstiff.discrepancy.problem import Array, Index

EXPECTED = (12.0, 48.0, 200.0, 1000.0)
"""Noncentralities that an effect is expected to have; the evidence averages over them."""
_TABLE = 1000
_FEW = 4000
_SMALL = 0.5
"""Share R² up to which values even in R² serve: draws of noise have less."""


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
    """``log_bayes`` of shares R², read between ``_TABLE`` values where there are many: draws need few ranks.

    The values are even in R², or, where some R² are near one, in log(1 - R²).
    """
    if share.size < _FEW or rank == 0:
        return log_bayes(share, np.ones_like(share), np.array(rank), freedom)
    top = float(share.max())
    if top <= _SMALL:
        return _read(share, top, lambda r: log_bayes(r, np.ones_like(r), np.array(rank), freedom))
    left = -np.log1p(-np.clip(share, 0.0, 1 - 1e-12))
    return _read(
        left, float(left.max()), lambda x: log_bayes(-np.expm1(-x), np.ones_like(x), np.array(rank), freedom)
    )


def _read(x: Array, top: float, law: Callable[[Array], Array]) -> Array:
    """A law at many x from 0 to ``top``, linear between even values."""
    value = law(np.linspace(0.0, top, _TABLE + 1))
    place = x * (_TABLE / max(top, 1e-300))
    k = np.minimum(place.astype(np.intp), _TABLE - 1)
    return np.asarray(value[k] + (place - k) * np.diff(value)[k])


def of_groups(values: Array, start: Index, weight: Array | None = None) -> Array:
    """Sums over groups of rows, (K, B) -> (S, B), with weights (W, K) (W·S, B); ``start`` (S,): first row of each."""
    rows = len(values)
    weight = np.ones((1, rows)) if weight is None else weight
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
