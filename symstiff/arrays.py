"""Names for the types of arrays that all rooms use, whose shapes docstrings tell, and numbers for their rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TINY = 1e-300
"""Size that stands for none where something is divided by it, or its logarithm is taken."""
Array = NDArray[np.float64]
Index = NDArray[np.intp]
Mask = NDArray[np.bool_]


def numbered(*labels: NDArray[np.generic]) -> Index:
    """(M,) a number for each label, or for labels (M,) side by side: rows that agree in all have one, ascending."""
    keys = labels[0] if len(labels) == 1 else np.column_stack(labels)
    axis = None if len(labels) == 1 else 0
    return np.asarray(np.unique(keys, axis=axis, return_inverse=True)[1].reshape(-1), dtype=np.intp)
