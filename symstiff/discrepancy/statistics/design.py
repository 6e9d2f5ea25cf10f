"""What the data can and cannot tell: noncentrality, confusability, smallest detectable size."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy import optimize, special

from symstiff.arrays import TINY, Array
from symstiff.discrepancy.statistics.marginal import log_bayes
from symstiff.discrepancy.statistics.power import POWER, VISIBLE
from symstiff.discrepancy.statistics.scan import Scan, basis_of

_TENTH = 1
"""Digits of an effective rank: one more moves a noncentrality by less than a hundredth."""


def detectable_noncentrality(score: float, log_prior: float, rank: float, freedom: int) -> float:
    """Noncentrality at which an effect of this rank exceeds ``score`` with ``POWER``; inf where none does.

    With few degrees of freedom no signal, however large, is held for one that stands out.
    """

    def gap(square: float) -> float:
        value = log_bayes(np.array(square), np.array(freedom + square - rank), np.array(rank), freedom)
        return float(value) + log_prior - score

    high = 50.0
    while gap(high) < 0 and high < 1e6:
        high *= 2.0
    if gap(high) < 0:
        return np.inf
    square = optimize.brentq(gap, 1e-9, high) if gap(1e-9) < 0 else 1e-9
    low, top = 0.0, 4.0 * square + 50.0
    return float(optimize.brentq(lambda lam: 1.0 - special.chndtr(square, rank, lam) - POWER, low, top))


def effective_rank(scan: Scan, entry: int) -> float:
    """Number of directions that a signal by parameters of usual size is spread over; all where none are known."""
    if not scan.bank.sized[entry]:
        return float(scan.best.bases.rank[entry])
    return 1.0 / max(float(np.sum(scan.best.bases.variance[scan.bank.slice(entry)] ** 2)), TINY)


_needed = lru_cache(maxsize=4096)(detectable_noncentrality)
"""Candidates of one effect ask the same question at all their places."""


def share_left(scan: Scan, entry: int) -> float:
    """Share of the squared length of an entry's columns that the model leaves, its best column."""
    layer, cols = scan.best, scan.bank.slice(entry)
    return float(np.max(layer.left2[cols] / np.maximum(layer.length2[cols], TINY)))


def needed(scan: Scan, entry: int) -> float:
    """Noncentrality from which a score exceeds zero in 80 % of cases; inf where nothing can be seen."""
    rank = float(scan.best.bases.rank[entry])
    if rank == 0:
        return float("inf")
    prior = float(scan.bank.log_prior[scan.bank.owner[entry]])
    if not scan.bank.sized[entry]:
        return _needed(0.0, prior, rank, scan.freedom)
    fewer = min(rank, round(effective_rank(scan, entry), _TENTH))
    return min(_needed(float(np.log(2.0)), prior, r, scan.freedom) for r in (rank, fewer))


def least_sizes(scan: Scan, entry: int, sigma2: float) -> Array:
    """(k,) size of each parameter alone below which the search would not see it in 80 % of cases; inf where never.

    A quick bound: at the likeliest shared error, and as if the entry were the candidate's only shape. What is seen
    (``power.visible``) may have to be larger. ``sigma2`` is the whitened residual's mean square.
    """
    bank, layer = scan.bank, scan.best
    cols = bank.slice(entry)
    least = needed(scan, entry)
    if not np.isfinite(least):
        return np.full(int(bank.width[entry]), np.inf)
    left = layer.left2[cols]
    visible = left > VISIBLE * layer.length2[cols]
    size = np.sqrt(least * sigma2 / np.where(visible, left, 1.0)) / bank.scale[cols]
    return np.asarray(np.where(visible, size, np.inf))


def confusability(scan: Scan, entries: Sequence[int]) -> Array:
    """D_ij, (n, n): what is left of the fitted signal i after the model and j; D_ii is the noncentrality itself."""
    layer = scan.best
    scale2 = layer.rss / max(scan.freedom, 1)
    Q = [basis_of(scan, layer, e) for e in entries]
    signal = [q @ (q.T @ layer.y) for q in Q]
    D = np.empty((len(Q), len(Q)))
    for i, s in enumerate(signal):
        for j, q in enumerate(Q):
            inside = q.T @ s if i != j else np.zeros(1)
            D[i, j] = max(float(s @ s - inside @ inside), 0.0) / scale2
    return D
