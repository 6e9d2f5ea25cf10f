"""How large an effect has to be to be seen: the size at which the search's own score exceeds its threshold.

The score of an effect beside noise is that of the effect with what noise does to it in one case of five: along the
signal it is 0.84 standard deviations against it, a little more where an effect has many directions, and in all others
as large as on average. So every belief that the search weighs is counted: shared errors that may take the signal's
place, shapes that share a prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from symstiff.arrays import Array, Index
from symstiff.discrepancy.statistics.bank import Bank
from symstiff.discrepancy.statistics.evidence import candidate_evidence, entry_evidence
from symstiff.discrepancy.statistics.scan import Layer, Scan, back, outside

POWER = 0.8
"""Share of cases in which an effect of the size that is told is seen."""
_AGAINST = float(ndtri(POWER))
_MOST, _STEPS = 300.0, 24
"""Length of a signal, in standard deviations, beyond which none is looked for; halvings of the interval below."""
VISIBLE = 1e-9
"""Share of a column's squared length that the model has to leave for it to be seen at any size."""


@dataclass(frozen=True)
class Visible:
    """What is seen of one candidate in 80 % of cases."""

    sizes: Array
    """(k,) of each parameter alone, in its unit; inf where never."""
    noncentrality: float
    """Of the parameter that is seen best."""


@dataclass(frozen=True)
class _Question:
    """Parameters that are asked for, one a place: signals, their candidates' entries side by side, and the layers."""

    scan: Scan
    """Its bank holds, for every parameter, the entries of the candidate: with their shares, without columns."""
    length: tuple[Array, ...]
    """By layer (P,): of each signal outside the model, for a parameter that moves the data by one."""
    along: tuple[Array, ...]
    """By layer (K,): square of the signal in each direction of the entries' bases."""
    place: Index
    """(K,) parameter of each direction."""
    rank: Array
    """(P,) directions of each parameter's entry."""
    best: int
    sigma2: float

    def score(self, x: Array) -> Array:
        """(P,) score of each parameter's candidate where its signal has a length of x standard deviations."""
        against = _AGAINST * np.sqrt(1.0 + 0.5 * (self.rank - 1.0) / np.maximum(x, 1.0) ** 2)
        size = np.maximum(x - against, 0.0) ** 2 * self.sigma2 / self.length[self.best] ** 2
        squares, rss = [], []
        for layer, length, along in zip(self.scan.layers, self.length, self.along, strict=True):
            noise = layer.rss / max(self.scan.freedom, 1)
            inside = along / length[self.place] ** 2
            squares.append(along * size[self.place] + noise * np.clip(layer.bases.alive - inside, 0.0, 1.0))
            rss.append(layer.rss - noise + size * length**2)
        bank = self.scan.bank
        by_entry = np.stack(rss)[:, bank.owner, None]
        entry = entry_evidence(self.scan, [s[:, None] for s in squares], by_entry)
        return np.asarray(candidate_evidence(bank, entry)[:, 0] + bank.log_prior)

    def needed(self, threshold: float) -> Array:
        """(P,) length of each signal, in standard deviations, from which its score exceeds a threshold; inf: never."""
        low, high = np.zeros(len(self.length[0])), np.full(len(self.length[0]), np.log1p(_MOST))
        never = self.score(np.expm1(high)) < threshold
        for _ in range(_STEPS):
            middle = 0.5 * (low + high)
            seen = self.score(np.expm1(middle)) >= threshold
            low, high = np.where(seen, low, middle), np.where(seen, middle, high)
        return np.where(never, np.inf, np.expm1(high))


def visible(scan: Scan, entries: Sequence[int], threshold: float) -> list[Visible]:
    """What is seen in 80 % of cases of candidates, each by one of its entries, where scores exceed a threshold."""
    bank, best = scan.bank, scan.best
    columns = [bank.columns_of([e]) for e in entries]
    shown = [best.left2[c] > VISIBLE * best.length2[c] for c in columns]
    asked = [(e, int(k)) for e, s in zip(entries, shown, strict=True) for k in np.flatnonzero(s)]
    if not asked:
        return [Visible(np.full(len(c), np.inf), np.inf) for c in columns]
    question = _question(scan, asked)
    needed = question.needed(threshold)
    size = needed * np.sqrt(question.sigma2) / question.length[question.best]
    out, at = [], 0
    for own, seen in zip(columns, shown, strict=True):
        count = int(seen.sum())
        sizes = np.full(len(own), np.inf)
        sizes[seen] = size[at : at + count] / bank.scale[own[seen]]
        out.append(Visible(sizes, float(np.min(needed[at : at + count], initial=np.inf)) ** 2))
        at += count
    return out


def _question(scan: Scan, asked: Sequence[tuple[int, int]]) -> _Question:
    bank = scan.bank
    owner = [int(bank.owner[e]) for e, _ in asked]
    first, last = bank.first_entry, bank.last_entry
    members = [np.arange(first[c], last[c]) for c in owner]
    entry = np.concatenate(members)
    place = np.repeat(np.arange(len(asked)), [len(m) for m in members])
    own = [bank.columns_of(m) for m in members]
    direction = np.concatenate(own)
    signal = np.array([bank.start[e] + k for e, k in asked])
    layers, length, along = [], [], []
    for layer in scan.layers:
        S = _signals(scan, layer, [e for e, _ in asked], signal)
        length.append(np.linalg.norm(S, axis=0))
        along.append(_along(scan, layer, own, S))
        layers.append(replace(layer, bases=layer.bases.of(direction, entry)))
    thin = replace(
        bank,
        candidates=tuple(bank.candidates[c] for c in owner),
        generic=bank.generic[owner],
        log_prior=bank.log_prior[owner],
        columns=np.zeros((0, len(direction))),
        scale=bank.scale[direction],
        start=np.concatenate([[0], np.cumsum(bank.width[entry])[:-1]]).astype(np.intp),
        width=bank.width[entry],
        owner=place,
        shape=bank.shape[entry],
        usual=bank.usual[direction],
        sized=bank.sized[entry],
        share=bank.share[entry],
        place=(),
    )
    best = int(np.argmax(scan.log_likelihood))
    return _Question(
        replace(scan, bank=thin, layers=tuple(layers)), tuple(length), tuple(along),
        np.repeat(place, bank.width[entry]), scan.layers[best].bases.rank[[e for e, _ in asked]], best,
        scan.layers[best].rss / max(scan.freedom, 1),
    )  # fmt: skip


def _signals(scan: Scan, layer: Layer, entries: Sequence[int], columns: Index) -> Array:
    """(M, P) whitened columns of single parameters, projected off the model."""
    distinct = list(dict.fromkeys(entries))
    bank: Bank = scan.bank
    held = bank.columns_of(distinct)
    return outside(scan, layer, distinct)[:, [int(np.flatnonzero(held == c)[0]) for c in columns]]


def _along(scan: Scan, layer: Layer, own: Sequence[Index], S: Array) -> Array:
    """Squares of signals (M, P) in the directions of their own candidates' entries, one after the other.

    Each candidate's first signal goes with the others' first, so that few vectors are mixed.
    """
    whitened = back(scan.noise, layer.sharing, S)
    first = [int(o[0]) for o in own]
    turn = [first[:k].count(f) for k, f in enumerate(first)]
    products = np.zeros((scan.columns.shape[1], max(turn) + 1))
    for o, k, s in zip(own, turn, whitened.T, strict=True):
        products[o, k] = s @ scan.columns[:, o]
    seen = layer.bases(products) ** 2
    return np.concatenate([seen[o, k] for o, k in zip(own, turn, strict=True)])
