"""The errors that a pose's rows share: the robot stands a little elsewhere than told, for all load cases and points.

Some is common to a pose, some to one approach of it (a repeat comes back anew), some to a point (its reading without
load); some is that of the joints, which moves the rows of a pose by their Jacobian. A least squares fit stays what it
is, but its deviations are too small where rows are taken for independent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.optimize
import scipy.sparse
from scipy.special import chdtrc, gammaln

from symstiff.arrays import TINY, Array, Index, Mask, numbered

LEVEL = 0.05
"""Probability under independent rows below which a shared error is taken into account."""
_RANGE = (-7.0, 10.0)
"""Natural logarithm of the ratios that are looked at; the lowest stands for none."""
_NONE = _RANGE[0] + 0.5
_STARTS = (-2.0, 1.0, 4.0)
"""Where the search for them begins: of several errors the largest may hide the others from one start."""
_FINE = {"eps": 1e-5, "ftol": 1e-12, "gtol": 1e-6}
"""Step of a slope and ends of the search: with a smaller step the slope is rounding, and the search stops anywhere."""
_NEAR = 200
"""Wide blocks among which the search begins where there are many more."""
_LEAST = 10
"""Rows beyond one a block from which they say what they share."""


@dataclass(frozen=True, eq=False)
class Joints:
    """What joints that stop beside their targets move.

    labels: (M, K) numbers of rows that they move together, by column, the first the widest; moved: (M, n) what a row
    reads of each joint's error, all joints' of one size.
    """

    labels: Index
    moved: Array


@dataclass(frozen=True, eq=False)
class Columns:
    """Errors side by side, one of each number in a column: labels (M, K), -1 for none; weight: (M, K) of the error in
    each row, in its sigmas; of: (K,) which of the sizes the errors of a column have; joints: (K,) whether they are a
    joint's.
    """

    labels: Index
    weight: Array
    of: Index
    joints: Mask


@dataclass(frozen=True, eq=False)
class Blocks:
    """Which rows may share errors.

    labels: (M, K) numbers of rows that share one, by column; rows of one number in another column have one in the
    first, the widest; kind: (M,) numbers of rows whose shared errors have one size in their unit, such as metres and
    radians; joints: errors of joints beside them, in wider blocks.
    """

    labels: Index
    kind: Index
    joints: Joints | None = None

    @classmethod
    def of(cls, given: npt.ArrayLike | Blocks) -> Blocks:
        """From labels (M,) or (M, K) of rows of one kind."""
        if isinstance(given, Blocks):
            return given
        labels = np.asarray(given)
        columns = labels.reshape(len(labels), -1).T
        return cls(np.stack([numbered(c) for c in columns], axis=1), np.zeros(len(labels), dtype=np.intp))

    @property
    def wide(self) -> Index:
        """(M,) number of each row's widest block."""
        widest = self.labels if self.joints is None else self.joints.labels
        return numbered(widest[:, 0])

    @property
    def count(self) -> int:
        """Number of the widest blocks of rows that share an error of one component."""
        return len(np.unique(self.labels[:, 0]))

    @property
    def by_kind(self) -> Index:
        """(M, K') the columns of one kind each, -1 for rows of another; those that say nothing new are left out."""
        return np.hstack([_informative(self.labels, self.kind == kind) for kind in np.unique(self.kind)])

    def size(self, sigma: Array | None) -> Array:
        """(M,) size of a shared error in each row's sigmas: root mean square sigma of its kind over its own."""
        if sigma is None:
            return np.ones(len(self.kind))
        mean = np.bincount(self.kind, sigma**2) / np.maximum(np.bincount(self.kind), 1)
        return np.asarray(np.sqrt(mean)[self.kind] / sigma)

    def columns(self, sigma: Array | None) -> Columns:
        """All errors that rows may share; sigma: (M,) their deviations."""
        labels, size = self.by_kind, self.size(sigma)
        of, none = np.arange(labels.shape[1]), np.zeros(labels.shape[1], bool)
        own = Columns(labels, np.where(labels >= 0, size[:, None], 0.0), of, none)
        moved = (
            None if self.joints is None else self.joints.moved / (1.0 if sigma is None else sigma[:, None])
        )
        if self.joints is None or moved is None or not moved.any():
            return own
        # a ratio of one: as much as the rows' own, in the mean
        moved = moved / np.sqrt(np.mean(np.sum(moved**2, axis=1)))
        together = _informative(self.joints.labels, np.ones(len(moved), bool)).T
        joints = moved.shape[1]
        return Columns(
            np.hstack([own.labels, *(np.repeat(label[:, None], joints, axis=1) for label in together)]),
            np.hstack([own.weight, *(moved for _ in together)]),
            np.concatenate([of, len(of) + np.repeat(np.arange(len(together)), joints)]),
            np.concatenate([none, np.ones(len(together) * joints, bool)]),
        )


def _informative(labels: Index, rows: Mask) -> Index:
    """(M, k) columns of some rows, -1 elsewhere: the first, and others that hold several rows somewhere."""
    kept: list[Index] = []
    for column in labels.T:
        _, first, number = np.unique(column[rows], return_index=True, return_inverse=True)
        label = np.full(len(rows), -1, dtype=np.intp)
        label[rows] = first[number.reshape(-1)]
        if not kept or not (len(first) == rows.sum() or any(np.array_equal(label, k) for k in kept)):
            kept.append(label)
    return np.stack(kept, axis=1)


@dataclass(frozen=True, eq=False)
class SharedError:
    """Variance components of whitened residuals: each row's own, and those that rows of a block share.

    variance: each row's own; ratios: shared over own, by size; p_value: of ratios this large when rows are independent;
    columns: the errors; size: (M,) of one that is alike in all rows of a kind, in each row's sigmas; count: number of
    the widest blocks of one component.
    """

    variance: float
    ratios: tuple[float, ...]
    p_value: float
    columns: Columns
    size: Array
    count: int

    @property
    def _each_column(self) -> Array:
        """(K,) ratio of each column's errors."""
        return np.array(self.ratios)[self.columns.of]

    @property
    def _of_own(self) -> Array:
        """(M,) variance of all that a row shares over its own."""
        return np.asarray(self.columns.weight**2 @ self._each_column)

    @property
    def of_rows(self) -> Array:
        """(M,) the same where its sigma is that of its kind."""
        return np.asarray(self._of_own / self.size**2)

    @property
    def ratio(self) -> float:
        """The same, mean of all rows."""
        return float(np.mean(self.of_rows))

    @property
    def total(self) -> float:
        """Mean variance of a row over its own."""
        return float(np.mean(1.0 + self._of_own))

    @property
    def each(self) -> Array:
        """(M,) variance of each row over the mean."""
        return (1.0 + self._of_own) / self.total

    @property
    def mostly_joints(self) -> bool:
        """Whether more than half of what rows share is what joints move."""
        of_joints = self.columns.weight**2 @ np.where(self.columns.joints, self._each_column, 0.0)
        return bool(np.sum(of_joints) > 0.5 * np.sum(self._of_own))

    def shared_variance(self, rows: Mask) -> float:
        """Mean variance of what some rows share, in units of their kind's mean square sigma."""
        return float(np.mean(self.of_rows[rows])) * self.variance

    def covariance_times(self, X: Array) -> Array:
        """(M, r) covariance of the rows, in units of their own variance, times X (M, r)."""
        total = np.array(X)
        found = zip(self._each_column, self.columns.labels.T, self.columns.weight.T, strict=True)
        for ratio, block, weight in found:
            there = block >= 0
            if ratio:
                sums = _membership(block[there, None], weight[there, None]) @ X[there]
                total[there] += ratio * weight[there, None] * sums[block[there]]
        return total

    def among(self, rows: Index) -> Array:
        """(…, n, n) covariance of some rows (…, n), in units of their own variance."""
        weight, label = self.columns.weight[rows], self.columns.labels[rows]
        same = (label[..., :, None, :] == label[..., None, :, :]) & (label >= 0)[..., :, None, :]
        common = np.einsum(
            "...ijk,...ik,...jk,k->...ij", same, weight, weight, self._each_column, optimize=True
        )
        return np.asarray(np.eye(rows.shape[-1]) + common)


def shared_error(
    Q: Array, z: Array, blocks: npt.ArrayLike | Blocks, sigma: Array | None = None
) -> SharedError | None:
    """Estimate shared errors by restricted maximum likelihood.

    None where rows look independent, or too few stand in blocks of several. Q: (M, r) orthonormal whitened columns, z:
    (M,) whitened data, sigma: (M,) the rows' deviations: a shared error has one size in m or rad, whatever they are.
    """
    given = Blocks.of(blocks)
    rows, rank = Q.shape
    if rows - given.count < _LEAST or rows <= rank + 2:
        return None
    columns = given.columns(sigma)
    problem = _Components.of(Q, z, given.wide, columns)
    count = int(columns.of.max()) + 1
    some = _some(given.wide)
    part = problem if some.all() else _Components.of(
        np.linalg.qr(Q[some])[0], z[some], given.wide[some],
        replace(columns, labels=columns.labels[some], weight=columns.weight[some]),
    )  # fmt: skip
    found = [_searched(part, np.full(count, start)) for start in _STARTS]
    x = min(found, key=lambda x: part.fitted(np.exp(x))[0])
    x = x if some.all() else _searched(problem, x)
    ratios = np.where(x < _NONE, 0.0, np.exp(x))
    deviance, variance = problem.fitted(ratios)
    p = _mixture(problem.fitted(0.0 * ratios)[0] - deviance, count)
    if p >= LEVEL or not ratios.any():
        return None
    return SharedError(variance, tuple(ratios.tolist()), p, columns, given.size(sigma), given.count)


def _some(wide: Index) -> Mask:
    """(M,) rows of as many wide blocks as a search needs to be near what all of them say."""
    blocks = int(wide.max()) + 1
    if blocks <= 2 * _NEAR:
        return np.ones(len(wide), bool)
    return np.asarray(np.isin(wide, np.linspace(0, blocks - 1, _NEAR).astype(int)))


def _searched(problem: _Components, start: Array) -> Array:
    """Logarithms of ratios (K,) at a least deviance, from a start."""
    found = scipy.optimize.minimize(
        lambda x: problem.fitted(np.exp(x))[0], start, method="L-BFGS-B", bounds=[_RANGE] * len(start),
        options=_FINE,
    )  # fmt: skip
    return np.asarray(found.x)


def _membership(group: Index, weight: Array) -> scipy.sparse.csr_array:
    """(G, M) matrix that sums rows by their groups (M, K), each times its weight (M, K); -1 is no group."""
    row, column = np.nonzero(group >= 0)
    number = group[row, column]
    return scipy.sparse.csr_array(
        (weight[row, column], (number, row)), shape=(int(group.max(initial=-1) + 1), len(weight))
    )


def _mixture(statistic: float, count: int) -> float:
    """p-value of a likelihood ratio for ``count`` variances that cannot be negative: each is zero in half of cases.

    As if they were independent; where they are not it is too large rather than too small.
    """
    one = np.arange(1, count + 1)
    weight = np.exp(gammaln(count + 1) - gammaln(one + 1) - gammaln(count - one + 1) - count * np.log(2.0))
    return float(weight @ chdtrc(one, max(statistic, 0.0)))


@dataclass(frozen=True, eq=False)
class _Batch:
    """Wide blocks of about as many groups, side by side; where one has fewer the rest is zero.

    kind: (B, g) size that a group's error has; inner: (B, g, g) products of the groups' rows; along: (B, g,
    r + 1) their sums of Q, and of z.
    """

    kind: Index
    inner: Array
    along: Array

    def solved(self, ratios: Array) -> tuple[Array, float]:
        """Rows (B·g, r + 1) whose products are what the shared errors take away, and log-determinant of them."""
        root = np.sqrt(ratios)[self.kind]
        among = np.eye(self.kind.shape[1]) + root[:, :, None] * self.inner * root[:, None, :]
        factor = np.linalg.cholesky(among)
        solved = np.linalg.solve(factor, root[:, :, None] * self.along)
        determinant = 2.0 * float(np.log(np.diagonal(factor, axis1=1, axis2=2)).sum())
        return solved.reshape(-1, self.along.shape[2]), determinant


@dataclass(frozen=True, eq=False)
class _Components:
    """Whitened rows under errors of groups within wide blocks: the groups, the fit Qᵀz, the square of z."""

    batches: tuple[_Batch, ...]
    fit: Array
    square: float
    freedom: int

    @classmethod
    def of(cls, Q: Array, z: Array, wide: Index, columns: Columns) -> _Components:
        """From rows, their wide blocks (M,) and the errors that they share."""
        group, groups = np.full(columns.labels.shape, -1, dtype=np.intp), 0
        for k, label in enumerate(columns.labels.T):
            there = label >= 0
            found, number = np.unique(label[there], return_inverse=True)
            group[there, k] = groups + number.reshape(-1)
            groups += len(found)
        row, column = np.nonzero(group >= 0)
        kind, block = np.zeros((2, groups), dtype=np.intp)
        kind[group[row, column]], block[group[row, column]] = columns.of[column], wide[row]
        sums = _membership(group, columns.weight)
        along, inner = sums @ np.column_stack([Q, z]), (sums @ sums.T).tocsr()
        count = np.bincount(block, minlength=int(wide.max() + 1))
        batches = []
        for width in sorted(set(_rounded(count[count > 0]).tolist())):
            blocks = np.flatnonzero((count > 0) & (_rounded(count) == width))
            batches.append(_batch(blocks, width, block, kind, inner, along))
        return cls(tuple(batches), Q.T @ z, float(z @ z), len(Q) - Q.shape[1])

    def fitted(self, ratios: Array) -> tuple[float, float]:
        """Twice the negative restricted log-likelihood of ratios (K,), and the rows' own variance."""
        parts = [batch.solved(ratios) for batch in self.batches]
        away = sum((rows.T @ rows for rows, _ in parts), np.zeros((len(self.fit) + 1,) * 2))
        own = np.linalg.cholesky(np.eye(len(self.fit)) - away[:-1, :-1])
        b = np.linalg.solve(own, self.fit - away[:-1, -1])
        rss = max(self.square - float(away[-1, -1]) - float(b @ b), 1e-12 * self.square, TINY)
        determinant = sum(d for _, d in parts) + 2.0 * float(np.log(np.diag(own)).sum())
        return self.freedom * float(np.log(rss)) + determinant, rss / self.freedom


def _rounded(count: Index) -> Index:
    """Counts (n,) rounded up to powers of two, so that few batches hold them and none is mostly empty."""
    return np.asarray(2 ** np.ceil(np.log2(np.maximum(count, 1))), dtype=np.intp)


def _batch(
    blocks: Index, width: int, block: Index, kind: Index, inner: scipy.sparse.csr_array, along: Array
) -> _Batch:
    """Some wide blocks, of the groups' blocks (G,), kinds (G,), products (G, G) and sums (G, r + 1)."""
    own = np.flatnonzero(np.isin(block, blocks))
    own = own[np.argsort(block[own], kind="stable")]
    at = np.searchsorted(blocks, block[own])
    seat = np.arange(len(own)) - np.searchsorted(at, at)
    shape = (len(blocks), width)
    kinds, sums, products = (
        np.zeros(shape, dtype=np.intp),
        np.zeros((*shape, along.shape[1])),
        np.zeros((*shape, width)),
    )
    kinds[at, seat], sums[at, seat] = kind[own], along[own]
    pairs = inner[own][:, own].tocoo()
    products[at[pairs.row], seat[pairs.row], seat[pairs.col]] = pairs.data
    return _Batch(kinds, products, sums)
