"""M4–M5, numeric: the seed's SVD rules on the observation matrix of given configurations (seed eq. 15–21).

Columns are scaled to unit length, since compliances differ by orders of magnitude; the rank decision shows the gap in
the singular values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from symstiff.reduction.structural import Couplings, Partition, partition


@dataclass(frozen=True)
class NumericRank:
    """Singular values of the scaled matrix, the threshold used, the rank, and the gap σ_r / σ_{r+1}."""

    singular_values: np.ndarray
    threshold: float
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
    return NumericRank(s, threshold, int((s > threshold).sum()))


def numeric_partition(
    matrix: np.ndarray, names: Sequence[str], preference: Sequence[str]
) -> tuple[Partition, NumericRank]:
    """Groups by the rows of V (rules 1–3) and couplings by L (eq. 21), for an aggregated matrix (rows × parameters).

    ``matrix`` is weighted already.
    """
    lengths = np.linalg.norm(matrix, axis=0)
    scale = np.where(lengths > lengths.max(initial=0.0) * 1e-14, lengths, 1.0)
    _, s, vt = np.linalg.svd(matrix / scale, full_matrices=False)
    decision = numeric_rank(s, len(matrix))
    row_space = vt[: decision.rank]
    kept = _independent(row_space, [names.index(n) for n in preference])
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


def _independent(row_space: np.ndarray, order: Sequence[int]) -> list[int]:
    """Columns in order of preference that are independent of those before them (orthogonal projection, twice)."""
    basis = np.zeros((0, row_space.shape[0]))
    kept: list[int] = []
    for c in order:
        v = row_space[:, c]
        rest = v - basis.T @ (basis @ v)
        rest = rest - basis.T @ (basis @ rest)
        size = np.linalg.norm(rest)
        if size > 1e-8 * max(1.0, float(np.linalg.norm(v))) and len(kept) < row_space.shape[0]:
            basis = np.vstack([basis, rest / size])
            kept.append(c)
    return kept
