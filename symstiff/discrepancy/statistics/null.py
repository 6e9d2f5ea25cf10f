"""The greatest score of all candidates when nothing is missing, by simulated noise: the family-wise p-values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from symstiff.arrays import Array, Mask
from symstiff.discrepancy.statistics.evidence import candidate_evidence, entry_evidence
from symstiff.discrepancy.statistics.scan import Scan, back
from symstiff.threads import in_threads

_AT_ONCE = 128
"""Draws that are scored together."""
_NUMBERS = 3e7
"""Numbers of scores and errors that are held at a time."""
_TWENTIETH, _LEAST_TAIL, _EXCESS = 20, 20, (0.5, 1.6)
"""Share of a sample, and draws at least, that its tail is fitted to; bounds of the mean excess there, which for the
evidence is about one."""


@dataclass(frozen=True)
class Null:
    """Distribution of the greatest score when nothing is missing."""

    named: Array
    """(B,) sorted maxima over the catalogue."""
    generic: Array
    """(B,) sorted maxima over the laws that have no name."""

    def p_named(self, score: float) -> float:
        """Family-wise p-value of a candidate's score."""
        return tail(self.named, score)

    def p_two(self, score: float) -> float:
        """Family-wise p-value of the score of two candidates together.

        What noise leaves beside one of them is noise again: their score is the sum of two such maxima.
        """
        return float(np.mean([tail(self.named, score - other) for other in self.named]))

    def p_generic(self, score: float) -> float:
        """Family-wise p-value of an unnamed law's score."""
        return tail(self.generic, score)


def null(scan: Scan, draws: int, seed: int, allowed: Array | None = None) -> Null:
    """Parametric bootstrap of the maximum over candidates and shapes.

    Each draw has a shared error by its likelihood: the likeliest alone would claim to know it.
    ``allowed`` (candidates,) masks candidates out of both maxima.
    """
    rng = np.random.default_rng(seed)
    rows = len(scan.best.y)
    weight = np.exp(scan.log_likelihood - scan.log_likelihood.max())
    mask = np.ones(len(scan.bank.candidates), bool) if allowed is None else allowed.astype(bool)
    named, generic = [], []
    chunk = max(1, min(draws, int(_NUMBERS // max(len(scan.bank.start), rows, 1))))
    for begin in range(0, draws, chunk):
        counts = rng.multinomial(min(chunk, draws - begin), weight / weight.sum())
        errors = [
            scan.noise.apply(layer.colour, rng.standard_normal((rows, n)))
            for layer, n in zip(scan.layers, counts, strict=True)
            if n
        ]
        score = simulated_scores(scan, np.hstack(errors))
        named.append(_maximum(score, mask & ~scan.bank.generic))
        generic.append(_maximum(score, mask & scan.bank.generic))
    return Null(np.sort(np.concatenate(named)), np.sort(np.concatenate(generic)))


def simulated_scores(scan: Scan, errors: Array) -> Array:
    """Scores of all candidates for residuals (M, B) in units of the noise's spread: (candidates, B)."""
    parts = [errors[:, k : k + _AT_ONCE] for k in range(0, errors.shape[1], _AT_ONCE)]
    return np.hstack(in_threads(lambda part: _scores(scan, part), parts))


def _scores(scan: Scan, errors: Array) -> Array:
    """The same for few enough residuals that what each direction explains of them stays near the processor."""
    squares, rss = [], []
    for layer in scan.layers:
        e = scan.noise.apply(layer.whiten, errors)
        e = e - layer.basis @ (layer.basis.T @ e)
        rss.append(np.einsum("mb,mb->b", e, e))
        whitened = back(scan.noise, layer.sharing, e).astype(np.float32)
        squares.append(layer.bases(scan.single.T @ whitened) ** 2)
    entry = entry_evidence(scan, squares, np.stack(rss))
    return candidate_evidence(scan.bank, entry) + scan.bank.log_prior[:, None]


def _maximum(score: Array, mask: Mask) -> Array:
    return np.max(score[mask], axis=0) if np.any(mask) else np.full(score.shape[1], -np.inf)


def tail(sample: Array, value: float) -> float:
    """P(maximum >= value): counted, and beyond the upper twentieth by an exponential tail.

    Twice the evidence grows like a chi-square, whose tail is close to exponential.
    """
    n = len(sample)
    if n == 0 or not np.isfinite(sample[-1]):
        return 1.0
    cut = min(n, max(_LEAST_TAIL, n // _TWENTIETH))
    level = sample[-cut]
    if value <= level:
        return float((1 + np.sum(sample >= value)) / (n + 1))
    excess = float(np.clip(np.mean(sample[-cut:] - level), *_EXCESS))
    return float((cut + 1) / (n + 1) * np.exp(-(value - level) / excess))


def critical(sample: Array, alpha: float) -> float:
    """Score that the maximum exceeds with probability alpha."""
    return float(np.quantile(sample, 1.0 - alpha)) if len(sample) and np.isfinite(sample[-1]) else np.inf
