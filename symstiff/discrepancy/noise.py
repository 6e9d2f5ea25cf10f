"""The noise: its scale, how it differs between axes and distances, and what a pose's load cases share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from symstiff.discrepancy.problem import Array, Index, Problem

RATIOS = (0.0, 0.1, 0.35, 1.0, 3.0, 10.0)
"""Grid of (variance of the approach error) / (variance of the noise)."""

_SURE = 2.8
"""Standard deviations from which the noise is said to grow with a quantity."""

NEGLIGIBLE = 0.03
"""Departure of sigma from the stated one that changes nothing in practice: no remark is made of it."""


@dataclass(frozen=True)
class Noise:
    """Covariance D (I + r K) D of the rows, K block-diagonal by pose and axis; r is profiled by whoever uses it."""

    spread: Array
    """(M,) standard deviations D, up to the common scale."""
    ratios: tuple[float, ...]
    blocks: tuple[tuple[Index, Array], ...]
    """(n, m) row numbers of equal-sized blocks, and (n, m, m) their K."""

    def root(self, ratio: float, power: float) -> tuple[Array, ...]:
        """(I + r K)^power for each batch of blocks, (n, m, m)."""
        out = []
        for _, K in self.blocks:
            value, vector = np.linalg.eigh(np.eye(K.shape[1]) + ratio * K)
            out.append(np.einsum("nab,nb,ncb->nac", vector, value**power, vector))
        return tuple(out)

    def apply(self, roots: tuple[Array, ...], X: Array) -> Array:
        """Multiply the rows of X (M, k) by the block matrices."""
        out = np.array(X)
        for (rows, _), root in zip(self.blocks, roots, strict=True):
            n, m = rows.shape
            part = X[rows.ravel()].reshape(n, m, -1)
            out[rows.ravel()] = np.matmul(root, part).reshape(n * m, -1)
        return out

    def log_determinant(self, ratio: float) -> float:
        """log |I + r K|."""
        return float(
            sum(np.log(np.linalg.eigvalsh(np.eye(K.shape[1]) + ratio * K)).sum() for _, K in self.blocks)
        )


@dataclass(frozen=True)
class NoiseReport:
    """What was found out about the noise."""

    sigma: float
    """Standard deviation of a row, root mean square [m], of rotations [rad] where there are no translations."""
    stated: float | None
    """The stated one of these rows, root mean square."""
    ratio: float | None
    """Found over stated, of all rows."""
    ratio_interval: tuple[float, float] | None
    misstated: bool
    degrees_of_freedom: float
    source: str
    """``repeats`` or ``residual``."""
    by_axis: dict[int, float]
    homogeneity_p: float
    growth: dict[str, float]
    """Exponent of the noise in each quantity that it grows with beyond doubt."""
    by_marker: dict[str, float]
    """How much more each marker scatters than the others."""
    approach: float
    """Standard deviation of the error that a pose's load cases share, of the same rows."""
    approach_p: float
    """That they share none."""

    @property
    def mostly_shared(self) -> bool:
        """Whether the error that a pose's load cases share exceeds what each has for itself."""
        return self.approach > self.sigma


def start(problem: Problem) -> Noise:
    """The noise as stated: sigma where given, else one number for each kind of component."""
    if problem.sigma is not None:
        spread = np.array(problem.sigma, dtype=float)
    else:
        spread = np.ones(problem.rows)
        for rows in (problem.axis < 3, problem.axis >= 3):
            if np.any(rows):
                spread[rows] = max(float(np.std(problem.y[rows])), 1e-12)
    return Noise(spread, _ratios(problem), _blocks(problem, spread, 0.0))


def _ratios(problem: Problem) -> tuple[float, ...]:
    label = problem.pose * (problem.axis.max() + 1) + problem.axis
    repeated = problem.rows - len(np.unique(label))
    return RATIOS if repeated >= 10 and problem.poses > 2 else (0.0,)


def _blocks(problem: Problem, spread: Array, own: float) -> tuple[tuple[Index, Array], ...]:
    """Blocks of rows of one pose and axis; ``own`` is the part of the shared error that each marker has alone."""
    label = problem.pose * (problem.axis.max() + 1) + problem.axis
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    common, out = np.ones(problem.rows), []
    for kind in (problem.axis < 3, problem.axis >= 3):  # a shared error in metres, one in radians
        common[kind] = np.sqrt(np.mean(spread[kind] ** 2)) if np.any(kind) else 1.0
    for size in sorted({len(g) for g in groups}):
        rows = np.array([g for g in groups if len(g) == size], dtype=np.intp)
        channel = problem.channel[rows]
        u = common[rows] / spread[rows]
        same = (channel[:, :, None] == channel[:, None, :]).astype(float)
        K = u[:, :, None] * u[:, None, :] * (own * same + (1.0 - own))
        out.append((rows, K))
    return tuple(out)


def refine(
    problem: Problem, noise: Noise, residual: Array, dof: float, own: float
) -> tuple[Noise, dict[str, float], dict[str, float]]:
    """Fit how the noise differs between axes and markers and grows with ``problem.spread``.

    ``residual`` (M,) in the data's unit after the model and whatever was found; ``dof`` its degrees of freedom.
    Gamma regression of the squares on axis, marker and log quantities, shrunk towards homogeneity by a ridge of 20
    observations (axis, marker) and of 4. Returns also the exponents and the markers' factors.
    """
    z = (residual / noise.spread) ** 2 * (problem.rows / max(dof, 1.0))
    z = np.minimum(z, 25.0 * np.mean(z))
    axes, points = np.unique(problem.axis), problem.points
    markers = np.unique(points) if len(np.unique(points)) > 1 else points[:0]
    names = [k for k, v in problem.spread.items() if np.all(v > 0) and np.std(np.log(v)) > 0.02]
    X = [np.ones(problem.rows), *((problem.axis == a) - np.mean(problem.axis == a) for a in axes)]
    X += [(points == m) - np.mean(points == m) for m in markers]
    X += [np.log(problem.spread[k]) - np.mean(np.log(problem.spread[k])) for k in names]
    design = np.column_stack(X)
    weight = 0.5 * dof / problem.rows
    levels = len(axes) + len(markers)
    ridge = np.concatenate([[1e-9], np.full(levels, 10.0), np.full(len(names), 2.0)])
    beta = np.zeros(design.shape[1])
    beta[0] = np.log(np.mean(z))
    for _ in range(12):
        mean = np.exp(np.clip(design @ beta, -40, 40))
        gradient = weight * design.T @ (z / mean - 1.0) - ridge * beta * (np.arange(len(beta)) > 0)
        hessian = weight * design.T @ design + np.diag(ridge)
        beta = beta + np.linalg.solve(hessian, np.clip(gradient, -1e3, 1e3))
    spread = noise.spread * np.exp(0.5 * design[:, 1:] @ beta[1:])
    sure = np.abs(beta) > _SURE * np.sqrt(np.diag(np.linalg.inv(hessian)))
    growth = {k: float(0.5 * beta[1 + levels + n]) for n, k in enumerate(names) if sure[1 + levels + n]}
    alone = beta[1 + len(axes) : 1 + levels]
    others = (np.sum(alone) - alone) / max(len(alone) - 1, 1)
    factor = np.exp(0.5 * (alone - others)).tolist()
    by_marker = {problem.marker(int(m)): f for m, f in zip(markers, factor, strict=True)}
    return Noise(spread, noise.ratios, _blocks(problem, spread, own)), growth, by_marker


def main_rows(problem: Problem) -> np.ndarray:
    """(M,) the rows that sizes are told of: translations, rotations where there are none."""
    return problem.axis < 3 if np.any(problem.axis < 3) else np.ones(problem.rows, bool)


def pure_error(problem: Problem, spread: Array) -> tuple[float, int]:
    """Sum of squares between repeats in units of ``spread``, and its degrees of freedom."""
    label = np.unique(
        np.column_stack([problem.pose, problem.case, problem.channel]), axis=0, return_inverse=True
    )[1]
    label = label.reshape(-1)
    count = np.bincount(label)
    mean = np.bincount(label, problem.y) / count
    difference = (problem.y - mean[label]) / spread
    return float(difference @ difference), int(np.sum(count - 1))


def report(
    problem: Problem,
    noise: Noise,
    residual: Array,
    scale2: float,
    dof: float,
    ratio: float,
    growth: dict[str, float],
    by_marker: dict[str, float],
    approach_p: float,
) -> NoiseReport:
    """Compare the noise found with the noise stated.

    ``scale2`` is the whitened residual's mean square, ``residual`` the residual in the data's unit.
    """
    rows = main_rows(problem)
    square, repeats = pure_error(problem, noise.spread)
    source, found, freedom = "residual", scale2, dof
    if repeats >= 20:
        source, found, freedom = "repeats", square / repeats, float(repeats)
    sigma = float(np.sqrt(found * np.mean(noise.spread[rows] ** 2)))
    stated = None if problem.sigma is None else float(np.sqrt(np.mean(problem.sigma[rows] ** 2)))
    relative = interval = None
    misstated = False
    if problem.sigma is not None and freedom >= 1:
        relative = float(np.sqrt(found * np.mean((noise.spread / problem.sigma) ** 2)))
        low = np.sqrt(freedom / stats.chi2.ppf(0.98, freedom))
        high = np.sqrt(freedom / stats.chi2.ppf(0.02, freedom))
        interval = (float(relative * low), float(relative * high))
        misstated = bool(interval[0] > 1.0 + NEGLIGIBLE or interval[1] < 1.0 - NEGLIGIBLE)
    by_axis = {
        int(a): float(np.sqrt(np.mean(residual[problem.axis == a] ** 2))) for a in np.unique(problem.axis)
    }
    return NoiseReport(
        sigma, stated, relative, interval, misstated, freedom, source, by_axis,
        _homogeneity(problem, residual, dof), growth, by_marker, sigma * float(np.sqrt(ratio)),
        approach_p,
    )  # fmt: skip


def _homogeneity(problem: Problem, residual: Array, dof: float) -> float:
    """Bartlett's test over the axes of each kind (translations, rotations), p-value."""
    p = 1.0
    for kind in (problem.axis < 3, problem.axis >= 3):
        axes = np.unique(problem.axis[kind])
        if len(axes) < 2:
            continue
        share = dof / problem.rows
        n = np.array([share * np.sum(problem.axis == a) for a in axes])
        s2 = np.array([np.mean(residual[problem.axis == a] ** 2) for a in axes])
        pooled = float(n @ s2 / n.sum())
        if np.any(s2 <= 0) or np.any(n < 2):
            continue
        statistic = n.sum() * np.log(pooled) - n @ np.log(s2)
        p = min(p, float(stats.chi2.sf(statistic, len(axes) - 1)))
    return p
