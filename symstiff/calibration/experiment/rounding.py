"""Columns that are nothing but the rounding of others."""

from __future__ import annotations

import numpy as np

from symstiff.arrays import Array

ROUNDING = 1e-10
"""Length of a parameter's column, at usual sizes, against the longest below which it is rounding and nothing else."""


def without_rounding(block: Array, sizes: Array) -> Array:
    """The block (M, k) with zeros where a column, at its usual size (k,), is nothing but the others' rounding."""
    found = sizes * np.linalg.norm(block, axis=0)
    return np.asarray(np.where(found > ROUNDING * np.max(found, initial=0.0), block, 0.0))
