"""What the data can and cannot tell: noncentrality, confusability, smallest detectable size, deciding poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from symstiff.discrepancy.problem import Array, Index
from symstiff.discrepancy.scan import Scan, detectable_noncentrality


def share_left(scan: Scan, entry: int) -> float:
    """Share of the squared length of an entry's columns that the model leaves, its best column."""
    layer, cols = scan.best, scan.bank.slice(entry)
    left = np.einsum("mk,mk->k", layer.outside[:, cols], layer.outside[:, cols])
    return float(np.max(left / np.maximum(layer.length2[cols], 1e-300)))


def smallest_detectable(scan: Scan, entry: int, threshold: float, sigma2: float) -> Array:
    """(k,) size of each parameter alone that the search would see in 80 % of cases; inf where never.

    ``threshold`` is the score to exceed, ``sigma2`` the whitened residual's mean square.
    """
    bank, layer = scan.bank, scan.best
    rank = float(layer.rank[entry])
    cols = bank.slice(entry)
    if rank == 0:
        return np.full(int(bank.width[entry]), np.inf)
    prior = float(bank.log_prior[bank.owner[entry]])
    needed = detectable_noncentrality(threshold, prior, rank, scan.freedom)
    left = np.einsum("mk,mk->k", layer.outside[:, cols], layer.outside[:, cols])
    visible = left > 1e-9 * layer.length2[cols]
    size = np.sqrt(needed * sigma2 / np.where(visible, left, 1.0)) / bank.scale[cols]
    return np.asarray(np.where(visible, size, np.inf))


def confusability(scan: Scan, entries: Sequence[int]) -> Array:
    """D_ij, (n, n): what is left of the fitted signal i after the model and j; D_ii is the noncentrality itself."""
    layer, bank = scan.best, scan.bank
    scale2 = layer.rss / max(scan.freedom, 1)
    Q = [layer.Q[:, bank.slice(e)] for e in entries]
    signal = [q @ (q.T @ layer.y) for q in Q]
    D = np.empty((len(Q), len(Q)))
    for i, s in enumerate(signal):
        for j, q in enumerate(Q):
            inside = q.T @ s if i != j else np.zeros(1)
            D[i, j] = max(float(s @ s - inside @ inside), 0.0) / scale2
    return D


@dataclass(frozen=True)
class Decider:
    """Poses that would tell the members of an ambiguous set apart."""

    poses: tuple[int, ...]
    """Chosen, in order."""
    separation: tuple[float, ...]
    """Smallest D_ij over all ordered pairs after each choice."""


def deciding_poses(
    model: Array, rivals: Sequence[Array], theta: Sequence[Array], pose: Index, sigma: float,
    count: int, have: tuple[Array, Sequence[Array]] | None = None,
) -> Decider:  # fmt: skip
    """Greedy T-optimal choice: the poses that maximise the smallest D_ij between rivals.

    ``model`` (M', P) and ``rivals`` (M', k_i) are columns at the poses on offer, ``pose`` (M',) their numbers,
    ``theta`` the fitted coefficients, ``have`` the same columns on the data already taken.
    """
    pairs = [(i, j) for i in range(len(rivals)) for j in range(len(rivals)) if i != j]
    length = np.linalg.norm(np.vstack([model] if have is None else [model, have[0]]), axis=0)
    length[length == 0] = 1.0
    offered = np.unique(pose)

    def stack(A: Array, C: Sequence[Array], i: int, j: int) -> Array:
        width = np.linalg.norm(rivals[j], axis=0)
        return np.column_stack([A / length, C[j] / np.where(width > 0, width, 1.0), C[i] @ theta[i]])

    gram, base = [], []
    for i, j in pairs:
        X = stack(model, rivals, i, j)
        gram.append(np.stack([X[pose == p].T @ X[pose == p] for p in offered]))
        base.append(np.zeros(gram[-1].shape[1:]) if have is None else _gram(stack(have[0], have[1], i, j)))
    chosen: list[int] = []
    separation: list[float] = []
    for _ in range(min(count, len(offered))):
        value = np.min([_left(b + g) for b, g in zip(base, gram, strict=True)], axis=0)
        value[chosen] = -np.inf
        best = int(np.argmax(value))
        chosen.append(best)
        separation.append(float(value[best]) / sigma**2)
        base = [b + g[best] for b, g in zip(base, gram, strict=True)]
    return Decider(tuple(int(offered[c]) for c in chosen), tuple(separation))


def _gram(X: Array) -> Array:
    return np.asarray(X.T @ X)


def _left(gram: Array) -> Array:
    """Squared length of the last column outside the others, from Gram matrices (n, m, m)."""
    G, c, s = gram[:, :-1, :-1], gram[:, :-1, -1], gram[:, -1, -1]
    value, vector = np.linalg.eigh(G)
    keep = value > 1e-10 * value[:, -1:]
    part = np.einsum("nab,na->nb", vector, c)
    inside = np.sum(np.where(keep, part**2 / np.where(keep, value, 1.0), 0.0), axis=1)
    return np.asarray(np.maximum(s - inside, 0.0))
