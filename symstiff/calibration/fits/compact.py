"""Whitened, column-scaled, triangular form of a least-squares problem: what every fit starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from symstiff.arrays import Array
from symstiff.errors import UserError
from symstiff.threads import one_thread

_BLOCK = 4096
"""Rows that are reduced together."""


@dataclass(frozen=True, eq=False)
class Compact:
    """The problem min ‖(A·π − y)/σ‖² after QR: ‖R·(scale∘π) − z‖² + rest.

    R: (k, P), k = min(M, P), columns of unit norm; z: (k,); scale: (P,), norms of the whitened columns;
    rest: what no parameters can explain; signal: ‖y/σ‖; rows: M.
    """

    R: Array
    z: Array
    scale: Array
    rest: float
    signal: float
    rows: int


def compact(A: Array, y: Array, sigma: Array | None = None, weights: Array | None = None) -> Compact:
    """Reduce (M, P) rows to a triangle, by QR of [A y] (seed eq. 7–8 without its normal equations).

    A: (M, P), y: (M,) in m and rad; sigma: (M,) standard deviations, 1 where absent; weights: (M,) extra
    factors on squared residuals (robust fits).
    """
    row = np.ones(len(y)) if sigma is None else 1.0 / sigma
    if weights is not None:
        row = row * np.sqrt(weights)
    columns = A.shape[1]
    stacked = np.empty((A.shape[0], columns + 1))
    np.multiply(A, row[:, None], out=stacked[:, :columns])
    np.multiply(y, row, out=stacked[:, columns])
    scale = np.sqrt(np.einsum("mp,mp->p", stacked[:, :columns], stacked[:, :columns]))
    scale[scale == 0.0] = 1.0
    stacked[:, :columns] /= scale
    signal = float(np.linalg.norm(stacked[:, columns]))
    triangle = triangular(stacked)
    rest = float(triangle[columns, columns] ** 2) if len(triangle) > columns else 0.0
    return Compact(triangle[:columns, :columns], triangle[:columns, columns], scale, rest, signal, len(y))


def checked(
    A: Array, y: Array, sigma: Array | None, names: Sequence[str]
) -> tuple[Array, Array, Array | None, tuple[str, ...]]:
    """The arrays as floats of fitting shapes, or a UserError that names the first row that cannot be used."""
    A, y = np.asarray(A, dtype=float), np.asarray(y, dtype=float)
    if A.ndim != 2 or y.shape != A.shape[:1]:
        raise UserError(
            f"observation matrix of shape {A.shape} does not fit {y.shape} measured values: one row each"
        )
    if len(names) != A.shape[1]:
        raise UserError(f"{len(names)} parameter names for {A.shape[1]} columns: give one name a column")
    if not len(y):
        raise UserError("no measured value at all: the table has no row for this model")
    for what, values in (("observation matrix", A), ("measured deflection", y)):
        bad = np.flatnonzero(~np.isfinite(values).reshape(len(y), -1).all(axis=1))
        if bad.size:
            raise UserError(
                f"{what}: row {bad[0]} is not finite ({bad.size} such rows): correct or drop them"
            )
    if sigma is not None:
        sigma = np.broadcast_to(np.asarray(sigma, dtype=float), y.shape)
        bad = np.flatnonzero(~(np.isfinite(sigma) & (sigma > 0)))
        if bad.size:
            raise UserError(
                f"sigma: row {bad[0]} is {sigma[bad[0]]:g}: a standard deviation is finite and above zero"
            )
    return A, y, sigma, tuple(names)


def triangular(stacked: Array) -> Array:
    """R of a QR decomposition, by blocks of rows: the triangles of blocks are stacked and reduced again."""
    if len(stacked) > _BLOCK + stacked.shape[1]:
        with one_thread():  # several threads lose on narrow blocks, badly so on a busy machine
            parts = [np.linalg.qr(stacked[k : k + _BLOCK], mode="r") for k in range(0, len(stacked), _BLOCK)]
        stacked = np.vstack(parts)
    return np.asarray(np.linalg.qr(stacked, mode="r"))
