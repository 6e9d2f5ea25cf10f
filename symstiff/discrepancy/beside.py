"""What a scan would say with some entries in the model, from inner products with the bases that it has.

A search asks this of many sets. New bases cost a pass over all columns each; here only their products with the few
added directions are formed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.discrepancy.bank import Bank, turned
from symstiff.discrepancy.problem import Array
from symstiff.discrepancy.scan import Evidence, Layer, Scan, directions, evidence, of_squares

_NOTHING = 1e-8
"""Squared length of a unit direction below which nothing of it is left."""


def evidence_beside(scan: Scan, entries: tuple[int, ...]) -> Evidence:
    """The evidence of everything else once some entries have joined the model: that of the extended scan."""
    if not entries:
        return evidence(scan)
    layers, squares, gained = [], [], 0
    for layer in scan.layers:
        U, s = directions(scan.bank, layer, entries)
        y = layer.y - U @ (U.T @ layer.y)
        explained, variance, rank = _left(scan.bank, layer, U.T @ layer.Q, layer.Q.T @ y)
        squares.append(explained)
        determinant = layer.determinant + 2.0 * float(np.log(s).sum())
        layers.append(
            replace(layer, y=y, variance=variance, rank=rank, rss=float(y @ y), determinant=determinant)
        )
        gained = len(s)
    return of_squares(Scan(scan.bank, scan.noise, tuple(layers), scan.freedom - gained), np.stack(squares))


def _left(bank: Bank, layer: Layer, inside: Array, along: Array) -> tuple[Array, Array, Array]:
    """Squares (K,), usual variances (K,) and ranks (S,) of the entries outside the added directions.

    ``inside`` (p, K) are the bases' products with these directions, ``along`` (K,) with the residual.
    """
    length2 = layer.alive - np.einsum("pk,pk->k", inside, inside)
    there = length2 > _NOTHING
    squares = np.where(there, along**2 / np.where(there, length2, 1.0), 0.0)
    variance = np.ones(len(along))
    rank = there[bank.start].astype(float)
    for width, cols in bank.batches():
        if width == 1:
            continue
        V, alive = inside[:, cols], layer.alive[cols]
        gram = alive[:, :, None] * np.eye(width) - np.einsum("pnw,pnv->nwv", V, V)
        mix, share, found = turned(gram, np.sqrt(layer.variance[cols] * alive), _NOTHING)
        squares[cols.ravel()] = (np.einsum("nwi,nw->ni", mix, along[cols]) ** 2).ravel()
        variance[cols.ravel()] = share.ravel()
        rank[np.flatnonzero(bank.width == width)] = found
    return squares, variance, rank
