"""The errors that a pose's rows share: the robot stands a little elsewhere than told, for all load cases and points.

Some is common to a pose, some to one approach of it (a repeat comes back anew), some to a point (its reading without
load). A least squares fit stays what it is, but its deviations are too small where rows are taken for independent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.optimize
import scipy.sparse
import scipy.stats

from symstiff.calibration.compact import Array

Index = npt.NDArray[np.intp]
LEVEL = 0.05
"""Probability under independent rows below which a shared error is taken into account."""
_RANGE = (-7.0, 10.0)
"""Natural logarithm of the ratios that are looked at; the lowest stands for none."""
_NONE = _RANGE[0] + 0.5


@dataclass(frozen=True, eq=False)
class SharedError:
    """Variance components of whitened residuals: each row's own, and those that rows of a block share.

    variance: each row's own; ratios: (K,) shared over own, by the columns of blocks; p_value: of ratios this large when
    rows are independent; blocks: (M, K) numbers from 0; size: (M,) of the shared error in each row, in sigmas.
    """

    variance: float
    ratios: tuple[float, ...]
    p_value: float
    blocks: Index
    size: Array

    @property
    def ratio(self) -> float:
        """Variance of all that a row shares over its own."""
        return float(sum(self.ratios))

    @property
    def shared_variance(self) -> float:
        """Variance of all that a row shares, in units of the rows' sigma."""
        return self.ratio * self.variance

    @property
    def each(self) -> Array:
        """(M,) variance of each row over that of a row with a shared error of one size."""
        return (1.0 + self.ratio * self.size**2) / (1.0 + self.ratio)

    def covariance_times(self, X: Array) -> Array:
        """(M, r) covariance of the rows, in units of their own variance, times X (M, r)."""
        total = np.array(X)
        for ratio, block in zip(self.ratios, self.blocks.T, strict=True):
            sums = _membership(block, self.size) @ X
            total += ratio * self.size[:, None] * sums[block]
        return total

    def among(self, rows: Index) -> Array:
        """(…, n, n) covariance of some rows (…, n), in units of their own variance."""
        size = self.size[rows]
        same = self.blocks[rows][..., :, None, :] == self.blocks[rows][..., None, :, :]
        common = (same @ np.array(self.ratios)) * size[..., :, None] * size[..., None, :]
        return np.asarray(np.eye(rows.shape[-1]) + common)


def shared_error(Q: Array, z: Array, blocks: npt.ArrayLike, sigma: Array | None = None) -> SharedError | None:
    """Estimate shared errors by restricted maximum likelihood; None where rows look independent, or stand alone.

    Q: (M, r) orthonormal whitened columns, z: (M,) whitened data, blocks: (M,) or (M, K) numbers of rows that share an
    error, those of the first column the widest: rows of one number in another column have one in the first; sigma:
    (M,) their deviations: a shared error has one size in m or rad, whatever the rows' own.
    """
    labels = _numbered(blocks)
    rows, rank = Q.shape
    if rows - int(labels[:, 0].max() + 1) < 10 or rows <= rank + 2:
        return None
    size = np.ones(rows) if sigma is None else _common(labels[:, 0], sigma)
    problem = _Components.of(Q, z, labels, size)
    found = scipy.optimize.minimize(
        lambda x: problem.fitted(np.exp(x))[0], np.full(labels.shape[1], _RANGE[0]), method="Powell",
        bounds=[_RANGE] * labels.shape[1], options={"xtol": 1e-3, "ftol": 1e-10},
    )  # fmt: skip
    ratios = np.where(found.x < _NONE, 0.0, np.exp(found.x))
    deviance, variance = problem.fitted(ratios)
    p = _mixture(problem.fitted(0.0 * ratios)[0] - deviance, len(ratios))
    if p >= LEVEL or not ratios.any():
        return None
    return SharedError(variance, tuple(ratios.tolist()), p, labels, size)


def informative(columns: Sequence[npt.ArrayLike]) -> Index:
    """(M, K) those of nested groupings, widest first, that are not the one before and hold several rows somewhere."""
    kept: list[Index] = []
    for column in columns:
        _, first, number = np.unique(column, return_index=True, return_inverse=True)
        label = first[number.reshape(-1)]
        if not kept or not (len(first) == len(label) or any(np.array_equal(label, k) for k in kept)):
            kept.append(label)
    return np.stack(kept, axis=1)


def _numbered(blocks: npt.ArrayLike) -> Index:
    """Labels (M,) or (M, K) as numbers from 0, by column."""
    labels = np.asarray(blocks)
    columns = labels.reshape(len(labels), -1).T
    return np.stack([np.unique(c, return_inverse=True)[1].reshape(-1) for c in columns], axis=1)


def _common(block: Index, sigma: Array) -> Array:
    """(M,) root mean square sigma of a row's block over its own."""
    return np.asarray(np.sqrt(np.bincount(block, sigma**2) / np.bincount(block))[block] / sigma)


def _membership(group: Index, size: Array) -> scipy.sparse.csr_array:
    """(G, M) matrix that sums rows by their groups, (M,) or (M, K), each times its size (M,)."""
    count = group.size // len(size)
    row = np.repeat(np.arange(len(size)), count)
    return scipy.sparse.csr_array(
        (np.repeat(size, count), (group.ravel(), row)), shape=(int(group.max() + 1), len(size))
    )


def _mixture(statistic: float, count: int) -> float:
    """p-value of a likelihood ratio for ``count`` variances that cannot be negative: each is zero in half of cases."""
    weight = scipy.stats.binom.pmf(np.arange(1, count + 1), count, 0.5)
    tails = scipy.stats.chi2.sf(max(statistic, 0.0), np.arange(1, count + 1))
    return float(weight @ tails)


@dataclass(frozen=True, eq=False)
class _Components:
    """Whitened rows under errors of nested groups: sums by group, groups of one wide block side by side.

    kind: (B, g) column of ``blocks`` that a group is of; inner: (B, g, g) products of the groups' rows; along: (B, g,
    r) and data: (B, g) their sums of Q and of z; blocks without a group there hold zeros. Fit and square of z follow.
    """

    kind: Index
    inner: Array
    along: Array
    data: Array
    fit: Array
    square: float
    freedom: int

    @classmethod
    def of(cls, Q: Array, z: Array, labels: Index, size: Array) -> _Components:
        """From rows, their labels (M, K) and the size (M,) of the shared error in each."""
        first = np.concatenate([[0], np.cumsum(labels.max(axis=0) + 1)])
        group = labels + first[:-1]
        sums = _membership(group, size)
        wide = np.zeros(int(first[-1]), dtype=np.intp)
        wide[group] = labels[:, :1]
        order = np.argsort(wide, kind="stable")
        place = np.arange(len(wide)) - np.searchsorted(wide[order], wide[order])
        seat = np.empty(len(wide), dtype=np.intp)
        seat[order] = place
        shape = (int(labels[:, 0].max() + 1), int(place.max() + 1))
        inner, pairs = np.zeros((*shape, shape[1])), (sums @ sums.T).tocoo()
        inner[wide[pairs.row], seat[pairs.row], seat[pairs.col]] = pairs.data
        kind, along, data = np.zeros(shape, dtype=np.intp), np.zeros((*shape, Q.shape[1])), np.zeros(shape)
        kind[wide, seat] = np.searchsorted(first, np.arange(len(wide)), side="right") - 1
        along[wide, seat], data[wide, seat] = sums @ Q, sums @ z
        return cls(kind, inner, along, data, Q.T @ z, float(z @ z), len(Q) - Q.shape[1])

    def fitted(self, ratios: Array) -> tuple[float, float]:
        """Twice the negative restricted log-likelihood of ratios (K,), and the rows' own variance."""
        root = np.sqrt(ratios)[self.kind]
        factor = np.linalg.cholesky(
            np.eye(self.kind.shape[1]) + root[:, :, None] * self.inner * root[:, None, :]
        )
        right = root[:, :, None] * np.concatenate([self.along, self.data[:, :, None]], axis=2)
        solved = np.linalg.solve(factor, right).reshape(-1, right.shape[2])
        X, h = solved[:, :-1], solved[:, -1]
        own = np.linalg.cholesky(np.eye(X.shape[1]) - X.T @ X)
        b = np.linalg.solve(own, self.fit - X.T @ h)
        rss = max(self.square - float(h @ h) - float(b @ b), 1e-12 * self.square, 1e-300)
        determinant = 2.0 * sum(
            float(np.log(np.diagonal(f, axis1=-2, axis2=-1)).sum()) for f in (factor, own)
        )
        return self.freedom * float(np.log(rss)) + determinant, rss / self.freedom
