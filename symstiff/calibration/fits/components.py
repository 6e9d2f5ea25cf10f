"""Deviations of metres and radians that residuals alone tell, and what is in doubt where rows are few.

A fit may pass through all rows of one class and leave the residuals to the other, so that the likeliest deviation of
few rows can be nearly zero. The ratio of two deviations is therefore its mean over what residuals (restricted
likelihood) and the readings' own ratio leave possible; the doubt about it enters covariances and degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.fits.compact import triangular
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.reduction.svd import svd

_EXPECTED = 1.0
"""Standard deviation of log(sigma ratio) about the ratio of the readings, before residuals are looked at."""
_FARTHEST = 15.0  # of log(sigma ratio) from there; beyond it rounding decides
_POINTS = 101
_NEGLIGIBLE = 25.0  # below the largest log-density


def component_sigma(A: Array, y: Array, labels: Sequence[str]) -> Array:
    """Standard deviation of every row, estimated from the residuals of its class when none is known.

    A: (M, P), y: (M,); labels: (M,) class of each row, "translation" or "rotation": two at most, rows of one share one
    deviation. Returns (M,), which give whitened residuals the variance 1. So metres and radians are weighed without
    being asked for.
    """
    A, y = np.asarray(A, dtype=float), np.asarray(y, dtype=float)
    members = [np.flatnonzero(np.asarray(labels) == label) for label in dict.fromkeys(labels)]
    start = np.array([np.sqrt(np.mean(y[rows] ** 2)) or 1.0 for rows in members])
    columns = A.shape[1]
    triangles = [
        triangular(np.column_stack([A[rows], y[rows]]) / s) for rows, s in zip(members, start, strict=True)
    ]
    stacked = np.vstack(triangles)
    U, s, _ = svd(unit_columns(stacked[:, :columns])[0])
    Q = U[:, s > s.max(initial=0.0) * max(A.shape) * np.finfo(float).eps]
    left = stacked[:, columns] - Q @ (Q.T @ stacked[:, columns])
    free = len(y) - Q.shape[1]
    found = start
    if free > 0 and len(members) == 1:
        found = start * np.sqrt(left @ left / free)
    elif free > 0:
        profile = _Profile.of(Q, left, len(triangles[0]), len(members[1]), free)
        found = start * profile.deviations()
    sigma = np.empty(len(y))
    for rows, one, first in zip(members, found, start, strict=True):
        sigma[rows] = max(one, 1e-12 * first)
    return sigma


@dataclass(frozen=True, eq=False)
class _Profile:
    """Restricted likelihood of the ratio of two classes' deviations, in the basis where both classes are diagonal.

    share: (r,) of each direction that the second class tells; first, second: (·, r + 1) both classes' orthonormal
    columns in that basis, and what a fit with equal deviations left; rows: of the second class; free: degrees of
    freedom of all.
    """

    share: Array
    first: Array
    second: Array
    rows: int
    free: int

    @classmethod
    def of(cls, Q: Array, left: Array, split: int, rows: int, free: int) -> _Profile:
        """From a fit: orthonormal columns (·, r) and residuals, of the first class up to ``split``."""
        share, basis = np.linalg.eigh(Q[split:].T @ Q[split:])
        turned = np.column_stack([Q @ basis, left])
        return cls(np.clip(share, 0.0, 1.0), turned[:split], turned[split:], rows, free)

    def fitted(self, x: Array) -> tuple[Array, Array]:
        """Log-density (G,) of x = log(sigma₂/sigma₁) (G,), and the residual sums (G,) with rows weighed by it."""
        weight = np.exp(-2.0 * x)[:, None]
        normal = (1.0 - self.share) + weight * self.share
        told = [(part[:, :-1], part[:, -1]) for part in (self.first, self.second)]
        pulls = [left @ Q for Q, left in told]
        move = (pulls[0] + weight * pulls[1]) / np.maximum(normal, np.finfo(float).eps * (1.0 + weight))
        squares = [np.sum((left - move @ Q.T) ** 2, axis=1) for Q, left in told]
        rest = np.maximum(squares[0] + weight[:, 0] * squares[1], np.finfo(float).tiny)
        likely = -self.rows * x - 0.5 * np.log(normal).sum(axis=1) - 0.5 * self.free * np.log(rest)
        return likely - 0.5 * (x / _EXPECTED) ** 2, rest

    def deviations(self) -> Array:
        """(2,) deviations at the mean of the ratio's logarithm."""
        x = np.linspace(-_FARTHEST, _FARTHEST, _POINTS)
        for _ in range(6):  # the density may be as narrow as many rows make it
            density = self.fitted(x)[0]
            near = x[density > density.max() - _NEGLIGIBLE]
            step = x[1] - x[0]
            x = np.linspace(near[0] - step, near[-1] + step, _POINTS)
        density = self.fitted(x)[0]
        mean = np.average(x, weights=np.exp(density - density.max()))
        first = np.sqrt(self.fitted(np.array([mean]))[1][0] / self.free)
        return np.asarray(first * np.array([1.0, np.exp(mean)]))


@dataclass(frozen=True, eq=False)
class Doubt:
    """What estimated deviations leave in doubt: covariance (P, P) to add, freedom (P,) of each parameter's interval."""

    covariance: Array
    freedom: Array


def doubt_of(A: Array, residuals: Array, sigma: Array, root: Array) -> Doubt:
    """Doubt of parameters where rows of one sigma are a class, whose variance their residuals told.

    A: (M, P), residuals, sigma: (M,), more rows than the rank r; root: (P, r) whose square is the covariance. The
    estimate moves with the variances' logarithms by D (first order), so that their covariance C adds D·C·Dᵀ; freedom as
    of Satterthwaite, 2·v²/(gᵀ·C·g) with v the variance of a parameter and g the classes' shares in it.
    """
    classes = [sigma == s for s in np.unique(sigma)]
    parts = [(A[rows] / sigma[rows, None]) @ root for rows in classes]
    gram = np.array([S.T @ S for S in parts])
    moves = np.column_stack(
        [-root @ (S.T @ (residuals[c] / sigma[c])) for S, c in zip(parts, classes, strict=True)]
    )
    count = len(classes)
    rows = np.diag([float(c.sum()) for c in classes]) - 2.0 * np.diag(np.trace(gram, axis1=1, axis2=2))
    known = 0.5 * (rows + np.einsum("krs,lsr->kl", gram, gram))
    expected = (np.eye(count) - 1.0 / count) / (2.0 * _EXPECTED**2)
    C = np.linalg.inv(known + expected)
    share = np.einsum("pr,krs,ps->pk", root, gram, root, optimize=True)
    spread = np.einsum("pk,kl,pl->p", share, C, share)
    variance = share.sum(axis=1)
    freedom = np.divide(2.0 * variance**2, spread, out=np.full(len(root), np.inf), where=spread > 0.0)
    return Doubt(moves @ C @ moves.T, freedom)
