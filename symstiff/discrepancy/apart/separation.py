"""How far the predictions of rivals stay apart whatever the other one fits, and the poses that widen it most."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from symstiff.arrays import TINY, Array, Index
from symstiff.threads import in_threads

_HARD, _SOFT = 1e-10, 1e-3
"""Shares of the largest column by which directions count as not determined: in truth, and with too few poses yet."""
_GUIDE = 1e-2
"""Weight of the soft fit: it guides the choice as long as the model could still explain anything."""
_NEVER = 1e-9
"""Share of a signal below which no pose on offer separates it from a rival (one set holds the other)."""
_HOPELESS = 1.0
"""D_ij of all poses on offer together below which few of them tell nothing either."""


@dataclass(frozen=True)
class Decider:
    """Poses that would tell the members of an ambiguous set apart."""

    poses: tuple[int, ...]
    """Chosen, in order."""
    separation: tuple[float, ...]
    """Smallest D_ij over all ordered pairs after each choice."""


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Columns of M rows: the current model's (M, P), every rival's signal, and the blocks that its law may take.

    ``signals`` (M, R) are what the rivals predict beside the model, ``laws`` (M, L) the columns of all effects, each
    once: rivals have effects in common. ``blocks`` hold for each rival the numbers (k,) of the laws that it may fit
    with, once for each shape of its law.
    """

    model: Array
    signals: Array
    laws: Array
    blocks: tuple[tuple[Index, ...], ...]

    @property
    def columns(self) -> Array:
        """All columns side by side: model, signals, laws."""
        return np.hstack([self.model, self.signals, self.laws])

    def rows(self, some: Array | Index) -> Hypotheses:
        """The same of some rows."""
        return replace(self, model=self.model[some], signals=self.signals[some], laws=self.laws[some])

    def of(self, blocks: tuple[tuple[Index, ...], ...]) -> Hypotheses:
        """The same with some of the blocks, and the laws that those need."""
        needed = np.unique(np.concatenate([b for rival in blocks for b in rival]))
        kept = tuple(tuple(np.searchsorted(needed, b) for b in rival) for rival in blocks)
        return replace(self, laws=self.laws[:, needed], blocks=kept)


def deciding_poses(
    offered: Hypotheses, pose: Index, sigma: float, count: int, have: Hypotheses | None = None,
    least: int = 1, enough: float = np.inf, tell: Callable[[str], None] = lambda stage: None,
) -> Decider:  # fmt: skip
    """Greedy T-optimal choice: the poses that maximise the smallest D_ij between rivals.

    ``offered`` are the columns at the poses on offer, ``pose`` (M,) their numbers, ``have`` the same on the data
    already taken. The choice ends after ``count`` poses, or from ``least`` on where D_ij reaches ``enough``.
    """
    X = offered.columns
    taken = np.zeros((0, X.shape[1])) if have is None else have.columns
    length = np.sqrt(np.einsum("mk,mk->k", X, X) + np.einsum("mk,mk->k", taken, taken))
    length[length == 0] = 1.0
    signals = slice(offered.model.shape[1], offered.model.shape[1] + offered.signals.shape[1])
    length[signals] = sigma  # D_ij in units of the noise variance
    numbers = np.unique(pose)
    gram = np.stack([_gram(X[pose == p] / length) for p in numbers])
    base = _gram(taken / length)
    layout = _layout(offered)
    pairs = _separable(base + gram.sum(axis=0), layout)
    chosen: list[int] = []
    separation: list[float] = []
    for step in range(min(count, len(numbers)) if pairs else 0):
        tell(f"deciding poses: {step + 1} of up to {count}")
        now = base + gram
        value = _apart(now, layout, pairs, _HARD)
        rank = value + _GUIDE * _apart(now, layout, pairs, _SOFT)
        rank[chosen] = -np.inf
        best = int(np.argmax(rank))
        chosen.append(best)
        separation.append(float(value[best]))
        base = now[best]
        if len(chosen) >= least and separation[-1] >= enough:
            break
    return Decider(tuple(int(numbers[c]) for c in chosen), tuple(separation))


@dataclass(frozen=True)
class _Layout:
    """Which columns are whose: P of the model, then R signals, then the rivals' laws (numbers after the model's)."""

    model: int
    signals: int
    blocks: tuple[tuple[Index, ...], ...]


def _layout(columns: Hypotheses) -> _Layout:
    first = columns.signals.shape[1]
    blocks = tuple(tuple(first + b for b in rival) for rival in columns.blocks)
    return _Layout(columns.model.shape[1], first, blocks)


def _separable(total: Array, layout: _Layout) -> list[tuple[int, int]]:
    """Ordered pairs (i, j) such that all poses together leave something of i's signal outside j, above the noise."""
    out = []
    for i in range(layout.signals):
        least = max(_NEVER * float(total[layout.model + i, layout.model + i]), _HOPELESS)
        for j in range(layout.signals):
            if i != j and float(_apart(total[None], layout, [(i, j)], _HARD)[0]) > least:
                out.append((i, j))
    return out


def _gram(X: Array) -> Array:
    return np.asarray(X.T @ X)


def _apart(gram: Array, layout: _Layout, pairs: list[tuple[int, int]], share: float) -> Array:
    """Smallest D_ij (n,) over the pairs, from Gram matrices (n, K, K) of all columns."""
    P = layout.model
    rest = np.array(gram[:, P:, P:])
    if P:
        inner = _ridged(gram[:, :P, :P], share)
        rest -= gram[:, P:, :P] @ np.linalg.solve(inner, gram[:, :P, P:])
    floor = share * np.einsum("nkk->nk", gram[:, P:, P:])
    least = np.full(len(gram), np.inf)
    for j in dict.fromkeys(j for _, j in pairs):
        own = [i for i, other in pairs if other == j]
        inside = np.max(in_threads(partial(_inside, rest, floor, own), layout.blocks[j]), axis=0)
        left = np.maximum(rest[:, own, own] - inside, 0.0)
        least = np.minimum(least, left.min(axis=1))
    return least


def _inside(rest: Array, floor: Array, signals: list[int], block: Index) -> Array:
    """(n, signals) squared lengths of signals inside a block, both outside the model."""
    cross = rest[:, block[:, None], signals]
    if len(block) == 1:
        own = np.maximum(rest[:, block[0], block[0]], 0.0) + floor[:, block[0]]
        return np.asarray(cross[:, 0] ** 2 / np.where(own > 0, own, 1.0)[:, None])
    own = rest[:, block[:, None], block] + np.eye(len(block)) * np.maximum(
        floor[:, block].max(axis=1), TINY
    )[:, None, None]  # fmt: skip
    return np.asarray(np.einsum("nki,nki->ni", cross, np.linalg.solve(own, cross)))


def _ridged(gram: Array, share: float) -> Array:
    """Gram matrices (n, P, P) with what they do not determine held down by a share of their largest entry."""
    top = np.maximum(np.einsum("nkk->nk", gram).max(axis=1), TINY)
    return np.asarray(gram + share * top[:, None, None] * np.eye(gram.shape[1]))
