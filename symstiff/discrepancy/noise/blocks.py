"""Covariances in blocks of rows: the identity and what is added to it along a few directions of each block."""

from __future__ import annotations

import numpy as np

from symstiff.arrays import Array, Index

_AT_ONCE = 1 << 17
"""Numbers that are worked on together, so that they stay near the processor."""

Roots = tuple[tuple[Index, Array, Array], ...]
"""Batches of blocks: (n, m) rows, (n, m, k) orthonormal directions, (n, k) what is added along them."""


def blocks(label: Index, factor: Array) -> Roots:
    """Eigenvalues and vectors of the blocks of factor·factorᵀ, rows with one label each."""
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    out = []
    for size in sorted({len(g) for g in groups}):
        rows = np.array([g for g in groups if len(g) == size], dtype=np.intp)
        U, s, _ = np.linalg.svd(factor[rows], full_matrices=False)
        out.append((rows, U, s**2))
    return tuple(out)


def raised(blocks: Roots, power: float, ratio: float = 1.0) -> Roots:
    """(I + ratio·blocks)^power, less the identity."""
    return tuple((rows, U, (1.0 + ratio * value) ** power - 1.0) for rows, U, value in blocks)


def applied(roots: Roots, X: Array) -> Array:
    """The rows of X (M, k) multiplied by the block matrices, one after the other."""
    out = np.array(X)
    for rows, U, gain in roots:
        if not np.any(gain):
            continue
        at_once = max(1, _AT_ONCE // max(rows.shape[1] * X.shape[1], 1))
        for k in range(0, len(rows), at_once):
            some = slice(k, k + at_once)
            part = out[rows[some]]
            along = gain[some, :, None] * np.matmul(U[some].transpose(0, 2, 1), part)
            out[rows[some]] = part + np.matmul(U[some], along)
    return out
