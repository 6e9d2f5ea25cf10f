"""Orthonormal bases of the candidates' columns outside a model, kept as mixes of the columns and never formed.

A basis is an entry's columns whitened, projected off the model and mixed. Its products with a vector outside the model
are the same mixes of the columns' own products, so that one pass over the columns serves every hypothesis of the noise,
and another set of effects in the model asks for small matrices only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from symstiff.arrays import TINY, Array, Index, Mask
from symstiff.discrepancy.statistics.bank import Bank

Single = np.ndarray[tuple[int, ...], np.dtype[np.float32]]
Numbers = TypeVar("Numbers", Array, Single)

NUMERIC_ZERO = 1e-9
"""Share of a column's squared length below which nothing of it is left outside the model."""
_NOTHING = 1e-8
"""Squared length of a unit direction below which nothing of it is left."""
_AT_ONCE = 64
"""Rows that are multiplied together, so that they stay near the processor."""


@dataclass(frozen=True, eq=False)
class Bases:
    """How the columns of every entry are mixed to an orthonormal basis."""

    scale: Array
    """(K,) of the entries of one column."""
    of_several: tuple[tuple[Index, Array], ...]
    """For each batch of entries of several columns these (n, w) and their mixes (n, w, w)."""
    variance: Array
    """(K,) how usual sizes spread over an entry's directions, where they are known; sums to one within an entry."""
    rank: Array
    """(S,)"""
    alive: Mask
    """(K,) whether a direction is there."""

    def __call__(self, products: Numbers) -> Numbers:
        """The bases' products with vectors outside the model, from those of the whitened columns (K, B)."""
        out: Numbers = products * self.scale.astype(products.dtype)[:, None]
        for columns, mix in self.of_several:
            mixed = np.matmul(np.swapaxes(mix, 1, 2).astype(products.dtype), products[columns])
            out[columns.ravel()] = mixed.reshape(columns.size, products.shape[1])
        return out

    def mix(self, columns: slice) -> Array:
        """(w, w) how one entry's columns are mixed."""
        if columns.stop - columns.start == 1:
            return self.scale[columns][:, None]
        first = ((held, mix, np.flatnonzero(held[:, 0] == columns.start)) for held, mix in self.of_several)
        return next(np.asarray(mix[at[0]]) for _, mix, at in first if len(at))

    def of(self, directions: Index, entries: Index) -> Bases:
        """What is known of some entries' directions, as if they were the columns."""
        scale = np.ones(len(directions))
        return Bases(scale, (), self.variance[directions], self.rank[entries], self.alive[directions])

    def alone(self, columns: slice, entries: slice) -> Bases:
        """Those of some entries one after the other, and of their columns."""
        held = [
            (of, mix, (of[:, 0] >= columns.start) & (of[:, 0] < columns.stop)) for of, mix in self.of_several
        ]
        several = tuple((of[own] - columns.start, mix[own]) for of, mix, own in held if np.any(own))
        return Bases(
            self.scale[columns], several, self.variance[columns], self.rank[entries], self.alive[columns]
        )

    def without(self, bank: Bank, inside: Array) -> Bases:
        """The bases once orthonormal directions are taken out, of which ``inside`` (K, p) are their products."""
        length2 = self.alive - np.einsum("kp,kp->k", inside, inside)
        there = length2 > _NOTHING
        scale = np.where(there, self.scale / np.sqrt(np.where(there, length2, 1.0)), 0.0)
        several = []
        for columns, mix in self.of_several:
            V, alive = inside[columns], self.alive[columns]
            gram = alive[:, :, None] * np.eye(columns.shape[1]) - np.matmul(V, np.swapaxes(V, 1, 2))
            usual = np.sqrt(self.variance[columns] * alive)
            more = turned(gram, usual if _sized(bank, columns) else None, _NOTHING)
            several.append((columns, replace(more, mix=np.matmul(mix, more.mix))))
        return _bases(bank, scale, there, several)


@dataclass(frozen=True, eq=False)
class Turned:
    """How the columns of entries of one width are mixed."""

    mix: Array
    """(n, w, w)"""
    share: Array
    """(n, w) of every direction in the square of a signal of usual size."""
    alive: Mask
    """(n, w)"""


def bases_of(bank: Bank, products: Array, reference: Array) -> Bases:
    """The bases from products of columns projected off a model.

    ``products`` (K + Q,) as of ``inner``, ``reference`` (K,) the columns' squared lengths before the projection.
    """
    K = len(reference)
    floor = np.maximum(reference, TINY)
    there = products[:K] > NUMERIC_ZERO * floor
    scale = np.where(there, 1.0 / np.sqrt(np.where(there, products[:K], 1.0)), 0.0)
    several, at = [], K
    for columns in bank.batches:
        width = columns.shape[1]
        one, other = np.triu_indices(width, 1)
        count = len(columns) * len(one)
        gram = np.empty((len(columns), width, width))
        gram[:, np.arange(width), np.arange(width)] = products[columns]
        gram[:, one, other] = gram[:, other, one] = products[at : at + count].reshape(len(columns), -1)
        at += count
        unit = np.where(reference[columns] > 0, 1.0 / np.sqrt(floor[columns]), 0.0)
        usual = bank.usual[columns] if _sized(bank, columns) else None
        found = turned(gram * unit[:, :, None] * unit[:, None, :], usual, NUMERIC_ZERO)
        several.append((columns, replace(found, mix=unit[:, :, None] * found.mix)))
    return _bases(bank, scale, there, several)


def _sized(bank: Bank, columns: Index) -> bool:
    """Whether usual sizes are known of a batch."""
    return bool(bank.sized[np.searchsorted(bank.start, columns[0, 0])])


def _bases(bank: Bank, scale: Array, there: Mask, several: list[tuple[Index, Turned]]) -> Bases:
    """Bases from what entries of one column and of several have."""
    variance, alive = np.ones(len(scale)), np.array(there)
    rank = there[bank.start].astype(float)
    for columns, found in several:
        variance[columns], alive[columns] = found.share, found.alive
        rank[np.searchsorted(bank.start, columns[:, 0])] = found.alive.sum(axis=1)
    return Bases(scale, tuple((c, found.mix) for c, found in several), variance, rank, alive)


def inner(bank: Bank, X: Array, weight: Array) -> Array:
    """Products of the columns of each entry, weighted sums over rows: X (M, K), weight (R, M) -> (R, K + Q).

    Squares come first, and then the products of different columns, in the order of ``pairs``.
    """
    one, other = bank.pairs
    out = np.zeros((len(weight), X.shape[1] + len(one)))
    for k in range(0, len(X), _AT_ONCE):
        part, w = X[k : k + _AT_ONCE], weight[:, k : k + _AT_ONCE]
        out[:, : X.shape[1]] += w @ part**2
        out[:, X.shape[1] :] += w @ (part[:, one] * part[:, other])
    return out


def turned(gram: Array, usual: Array | None, zero: float) -> Turned:
    """How to mix the columns of entries so that they are orthonormal, and independent at their usual sizes if known.

    From products ``gram`` (n, w, w) and sizes ``usual`` (n, w); directions no longer than ``zero`` are nothing.
    """
    value, vector = np.linalg.eigh(gram)
    ok = value > zero
    root = np.sqrt(np.where(ok, value, 1.0))
    along = vector * np.where(ok, 1.0 / root, 0.0)[:, None, :]
    if usual is None:
        return Turned(along, ok / np.maximum(ok.sum(axis=1, keepdims=True), 1), ok)
    seen = np.where(ok, root, 0.0)[:, :, None] * np.swapaxes(vector, 1, 2) * usual[:, None, :]
    share, axes = np.linalg.eigh(np.matmul(seen, np.swapaxes(seen, 1, 2)))
    share = np.maximum(share, 0.0)
    # of unit length where something is there
    alive = np.matmul(ok[:, None, :].astype(float), axes**2)[:, 0] > 0.5
    return Turned(np.matmul(along, axes), share / np.maximum(share.sum(axis=1, keepdims=True), TINY), alive)
