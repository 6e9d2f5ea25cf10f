"""Decompositions that fits and tests stand on, of columns that may depend on each other."""

from __future__ import annotations

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.fits.compact import triangular
from symstiff.reduction.svd import independent


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
