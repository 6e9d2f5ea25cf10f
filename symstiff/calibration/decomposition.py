"""The singular value decomposition that fits and tests stand on, of columns that may depend on each other."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from symstiff.calibration.compact import Array


def svd(A: Array) -> tuple[Array, Array, Array]:
    """Thin U (M, k), s (k,), Vt (k, N) of A (M, N).

    LAPACK's divide-and-conquer may not converge where columns depend on each other beside a few that are nothing but
    rounding, though all of them are finite; the slower QR iteration does then.
    """
    try:
        U, s, Vt = np.linalg.svd(A, full_matrices=False)
    except np.linalg.LinAlgError:
        U, s, Vt = linalg.svd(A, full_matrices=False, lapack_driver="gesvd")
    return np.asarray(U), np.asarray(s), np.asarray(Vt)
