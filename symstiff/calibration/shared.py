"""The error that a pose's rows share: the robot stands a little elsewhere than told, for all load cases and points.

A least squares fit stays what it is, but its deviations are too small where rows are taken for independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.optimize
import scipy.stats

from symstiff.calibration.compact import Array

Index = npt.NDArray[np.intp]
LEVEL = 0.05
"""Probability under independent rows below which a shared error is taken into account."""
_RANGE = (-7.0, 10.0)
"""Natural logarithm of the ratios that are looked at."""


@dataclass(frozen=True, eq=False)
class SharedError:
    """Variance components of whitened residuals: each row's own, and one that the rows of a block share.

    variance: each row's own; ratio: shared over own; p_value: of a ratio this large when rows are independent;
    spread: (r, r) what the shared part adds to the covariance of an orthonormal fit, in units of its variance.
    """

    variance: float
    ratio: float
    p_value: float
    spread: Array

    @property
    def shared_variance(self) -> float:
        """Variance of the shared error, in units of the rows' sigma."""
        return self.ratio * self.variance


def shared_error(Q: Array, z: Array, blocks: npt.ArrayLike, sigma: Array | None = None) -> SharedError | None:
    """Estimate a shared error by restricted maximum likelihood; None where rows look independent, or stand alone.

    Q: (M, r) orthonormal whitened columns, z: (M,) whitened data, blocks: (M,) numbers of rows that share an error,
    sigma: (M,) their deviations: the shared error has one size in m or rad, whatever the rows' own.
    """
    _, block = np.unique(blocks, return_inverse=True)
    count = np.bincount(block)
    rows, rank = Q.shape
    if rows - len(count) < 10 or rows <= rank + 2:
        return None
    u = np.ones(rows) if sigma is None else np.sqrt(np.bincount(block, sigma**2) / count)[block] / sigma
    G = _sums(Q * u[:, None], block)
    h = np.bincount(block, u * z)
    m = np.bincount(block, u**2)
    along, square = Q.T @ z, float(z @ z)

    def fitted(ratio: float) -> tuple[float, float]:
        """Twice the negative log-likelihood, and the rows' own variance."""
        c = ratio / (1.0 + ratio * m)
        F = np.eye(rank) - G.T @ (c[:, None] * G)
        b = along - G.T @ (c * h)
        factor = scipy.linalg.cho_factor(F, lower=True)
        rss = square - float(c @ h**2) - float(b @ scipy.linalg.cho_solve(factor, b))
        rss = max(rss, 1e-12 * square, 1e-300)
        determinant = float(np.log1p(ratio * m).sum() + 2.0 * np.log(np.diag(factor[0])).sum())
        return (rows - rank) * float(np.log(rss)) + determinant, rss / (rows - rank)

    found = scipy.optimize.minimize_scalar(
        lambda x: fitted(float(np.exp(x)))[0], bounds=_RANGE, method="bounded", options={"xatol": 1e-3}
    )
    p = 0.5 * float(scipy.stats.chi2.sf(max(fitted(0.0)[0] - float(found.fun), 0.0), 1))
    if p >= LEVEL:
        return None
    ratio = float(np.exp(found.x))
    return SharedError(fitted(ratio)[1], ratio, p, G.T @ G)


def _sums(X: Array, block: Index) -> Array:
    """Sums of the rows (M, r) of each block."""
    order = np.argsort(block, kind="stable")
    first = np.flatnonzero(np.diff(block[order], prepend=-1))
    return np.asarray(np.add.reduceat(X[order], first, axis=0))
