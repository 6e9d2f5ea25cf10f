"""M4–M5, numeric: the seed's SVD rules on the observation matrix of given configurations (seed eq. 15–21).

Columns are scaled to unit length, since compliances differ by orders of magnitude; the rank decision shows the gap in
the singular values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from symstiff.arrays import Array
from symstiff.reduction.structural import Couplings, Partition, partition


@dataclass(frozen=True)
class NumericRank:
    """Singular values of the scaled matrix, the rank, and the gap σ_r / σ_{r+1}."""

    singular_values: np.ndarray
    rank: int

    @property
    def gap(self) -> float:
        """Ratio of the last singular value kept to the first one dropped (inf where none is dropped)."""
        s = self.singular_values
        if self.rank in (0, len(s)):
            return float("inf")
        return float(s[self.rank - 1] / max(s[self.rank], np.finfo(float).tiny))


def numeric_rank(singular_values: np.ndarray, rows: int) -> NumericRank:
    """Count the singular values above rounding."""
    s = np.asarray(singular_values, dtype=float)
    largest = float(s[0]) if s.size else 0.0
    threshold = largest * max(rows, s.size) * np.finfo(float).eps * 100
    return NumericRank(s, int((s > threshold).sum()))


def numeric_partition(
    matrix: np.ndarray, names: Sequence[str], preference: Sequence[str]
) -> tuple[Partition, NumericRank]:
    """Groups by the rows of V (rules 1–3) and couplings by L (eq. 21), for an aggregated matrix (rows × parameters).

    ``matrix`` is weighted already.
    """
    lengths = np.linalg.norm(matrix, axis=0)
    scale = np.where(lengths > lengths.max(initial=0.0) * 1e-14, lengths, 1.0)
    _, s, vt = svd(matrix / scale)
    decision = numeric_rank(s, len(matrix))
    row_space = vt[: decision.rank]
    order = [names.index(n) for n in preference]
    kept = [order[k] for k in independent(row_space[:, order], 1e-8)]
    mixing = np.linalg.solve(row_space[:, kept], row_space) if kept else np.zeros((0, len(names)))
    # rule 2 comes out by itself: where the row of [V_1 … V_r] vanishes, nothing is left of any kept one
    couplings: Couplings = {
        name: {
            names[k]: float(mixing[r, c] * scale[c] / scale[k])
            for r, k in enumerate(kept)
            if abs(mixing[r, c]) > 1e-7
        }
        for c, name in enumerate(names)
        if c not in kept
    }
    return partition(names, [names[k] for k in kept], couplings), decision


def svd(A: Array, full: bool = False) -> tuple[Array, Array, Array]:
    """Thin U (M, k), s (k,), Vt (k, N) of A (M, N), or full U (M, M) and Vt (N, N).

    LAPACK's divide-and-conquer may not converge where columns depend on each other beside a few that are nothing but
    rounding, though all of them are finite; the slower QR iteration does then.
    """
    try:
        U, s, Vt = np.linalg.svd(A, full_matrices=full)
    except np.linalg.LinAlgError:
        U, s, Vt = linalg.svd(A, full_matrices=full, lapack_driver="gesvd")
    return np.asarray(U), np.asarray(s), np.asarray(Vt)


def independent(A: np.ndarray, least: float) -> list[int]:
    """Columns of A (M, N), of length one at most, with more than ``least`` outside those taken before them, in order.

    No pivots: where columns tie, rounding would choose among them, another one on each machine.
    """
    basis = np.zeros((len(A), min(A.shape)))
    taken: list[int] = []
    for k, column in enumerate(A.T):
        left, found = column, basis[:, : len(taken)]
        for _ in range(2):  # once more against rounding
            left = left - found @ (found.T @ left)
        size = float(np.linalg.norm(left))
        if size > least and len(taken) < basis.shape[1]:
            basis[:, len(taken)] = left / size
            taken.append(k)
    return taken
