"""Decompositions that fits and tests stand on, of columns that may depend on each other."""

from __future__ import annotations

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.fits.compact import triangular
from symstiff.reduction.svd import independent, svd

RANK = 1e-9
"""Singular value, of the largest one, below which columns depend on each other."""


def unit_columns(A: Array) -> tuple[Array, Array]:
    """A (M, N) with columns of length one, and their lengths (N,); columns of zeros stay, as if of length one."""
    length = np.linalg.norm(A, axis=0)
    length[length == 0.0] = 1.0
    return A / length, length


def own_columns(A: Array, least: float) -> list[int]:
    """Columns of A (M, N) with more than ``least`` of their length outside those taken before them, in order.

    The triangle of A has the same angles between its columns, and few rows.
    """
    return independent(unit_columns(triangular(A))[0], least)


def column_space(A: Array, tolerance: float = RANK) -> Array:
    """Orthonormal basis (M, rank) of the columns of A (M, P), each scaled to unit length first."""
    length = np.linalg.norm(A, axis=0)
    used = A[:, length > 0] / length[length > 0]
    if used.shape[1] == 0:
        return np.zeros((len(A), 0))
    U, s, _ = svd(used)
    return np.asarray(U[:, s > tolerance * s[0]])
