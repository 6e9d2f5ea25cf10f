"""Decompositions that fits and tests stand on, of columns that may depend on each other."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from symstiff.calibration.compact import Array, triangular


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


def independent(A: Array, least: float) -> list[int]:
    """Columns of A (M, N) with more than ``least`` of their length outside those taken before them, in order.

    No pivots: where columns tie, rounding would choose among them, another one on each machine. The triangle of A has
    the same angles between its columns, and few rows.
    """
    A = triangular(A)
    length = np.linalg.norm(A, axis=0)
    basis = np.zeros((len(A), min(A.shape)))
    taken: list[int] = []
    for k in np.flatnonzero(length):
        left, found = A[:, k] / length[k], basis[:, : len(taken)]
        for _ in range(2):  # once more against rounding
            left = left - found @ (found.T @ left)
        size = float(np.linalg.norm(left))
        if size > least and len(taken) < basis.shape[1]:
            basis[:, len(taken)] = left / size
            taken.append(int(k))
    return taken
