"""What the data say for every entry and candidate of a scan: their evidence, by all hypotheses of the shared error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from symstiff.arrays import TINY, Array, Index
from symstiff.discrepancy.statistics.bank import Bank
from symstiff.discrepancy.statistics.bases import Single
from symstiff.discrepancy.statistics.marginal import of_ranks, of_sizes
from symstiff.discrepancy.statistics.scan import Layer, Scan, log_likelihood, sum_entries


def entry_evidence(scan: Scan, squares: Sequence[Array | Single], rss: Array) -> Array:
    """Evidence of each entry at its likeliest sharing: R squares by direction (K, B), rss (R, B) -> (S, B).

    ``rss`` may differ between entries, (R, S, B).
    """
    each = rss.ndim == 3
    weight = log_likelihood(scan, rss)
    weight = weight - weight.max(axis=0)
    total = np.full((len(scan.bank.start), rss.shape[-1]), -np.inf)
    for r, layer in enumerate(scan.layers):
        left = np.maximum(rss[r], TINY).astype(squares[r].dtype)
        shares = squares[r] / (np.repeat(left, scan.bank.width, axis=0) if each else left)
        total = np.maximum(total, weight[r] + _of_layer(scan.bank, layer, shares, scan.freedom))
    return total


def _of_layer(bank: Bank, layer: Layer, shares: Array, freedom: int) -> Array:
    """Evidence (S, B) of each entry at one sharing, by both beliefs about its directions."""
    share = sum_entries(bank, shares)
    value = of_ranks(share, layer.bases.rank, freedom)
    several = bank.sized & (layer.bases.rank > 1)
    sized = np.flatnonzero(several)
    if len(sized):
        own = np.flatnonzero(np.repeat(several, bank.width))
        start = np.concatenate([[0], np.cumsum(bank.width[sized])[:-1]]).astype(np.intp)
        known = of_sizes(shares[own], layer.bases.variance[own], start, freedom)
        value[sized] = np.logaddexp(value[sized], known) - np.log(2.0)
    return value


def candidate_evidence(bank: Bank, entries: Array) -> Array:
    """Average over a candidate's shapes by their prior shares: (S, B) -> (candidates, B)."""
    if not len(bank.start):
        return np.zeros((0, entries.shape[1]))
    first = bank.first_entry
    count = bank.last_entry - first
    if np.all(count == 1):
        return entries
    top = np.maximum.reduceat(entries, first, axis=0)
    several = np.flatnonzero(count > 1)
    for c in several:
        own = slice(first[c], first[c] + count[c])
        block = entries[own]
        base = np.where(np.isfinite(top[c]), top[c], 0.0)
        with np.errstate(divide="ignore"):
            top[c] = base + np.log(bank.share[own] @ np.exp(block - base))
    return np.asarray(top)


@dataclass(frozen=True)
class Evidence:
    """Evidence on the data."""

    entry: Array
    """(S,)"""
    candidate: Array
    """(candidates,) without the prior."""
    score: Array
    """(candidates,) with the catalogue-size penalty."""
    best_entry: Index
    """(candidates,) likeliest shape of each, with its prior share."""


@dataclass(frozen=True)
class Own:
    """Evidence of one candidate on the data."""

    first: int
    """Number of its first entry."""
    entry: Array
    """Of its shapes."""
    score: float
    """With the catalogue-size penalty."""
    best: int
    """Number of its likeliest entry."""

    def at(self, entry: int) -> float:
        """The score with the best shape replaced by one that another effect beside it asks for."""
        if not np.isfinite(self.score):
            return -np.inf
        return float(self.score + self.entry[entry - self.first] - self.entry[self.best - self.first])


def evidence(scan: Scan) -> Evidence:
    """Evidence for every candidate given the data."""
    rss = np.array([[layer.rss] for layer in scan.layers])
    entry = entry_evidence(scan, list(scan.squares[:, :, None]), rss)
    candidate = candidate_evidence(scan.bank, entry)[:, 0]
    entry = entry[:, 0]
    likely = entry + np.log(np.maximum(scan.bank.share, TINY))
    ends = zip(scan.bank.first_entry, scan.bank.last_entry, strict=True)
    best = np.array([a + int(np.argmax(likely[a:b])) for a, b in ends], dtype=np.intp)
    return Evidence(entry, candidate, candidate + scan.bank.log_prior, best)
