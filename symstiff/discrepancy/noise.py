"""The noise: its scale, how it differs between axes and distances, and what a pose's load cases share."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from symstiff.discrepancy.problem import Array, Index, Problem

RATIOS = (0.1, 0.35, 1.0, 3.0, 10.0, 35.0, 120.0, 400.0)
"""Grid of (variance of the approach error) / (variance of the noise); every second one is looked at first."""

AXES, SHIFT, JOINTS = "axes", "shift", "joints"
"""What a pose's rows share: an error of every measured axis, of the translations alone, or of the joints' angles."""

_SURE = 2.8
"""Standard deviations from which the noise is said to grow with a quantity."""

_ALIKE = 4.0
"""Poses that the belief in joints with like errors counts for."""
_STEPS = 30

NEGLIGIBLE = 0.03
"""Departure of sigma from the stated one that changes nothing in practice: no remark is made of it."""

Roots = tuple[tuple[Index, Array, Array], ...]
"""Batches of blocks: (n, m) rows, (n, m, k) orthonormal directions, (n, k) what is added along them."""


@dataclass(frozen=True)
class Sharing:
    """One hypothesis of the error that a pose's rows share: what shares it, and its variance over the noise's."""

    way: str = AXES
    ratio: float = 0.0


@dataclass(frozen=True)
class Split:
    """How a shared error is split."""

    own: float = 0.0
    """Part of the axes' error that each marker has alone."""
    joints: tuple[float, ...] = ()
    """Variances of the joints' errors, up to a common factor; none: all alike."""


@dataclass(frozen=True)
class Noise:
    """Covariance D (I + ratio K) D of the rows, K by pose and way of sharing; whoever uses it weighs the sharings."""

    spread: Array
    """(M,) standard deviations D, up to the common scale."""
    sharings: tuple[Sharing, ...]
    ways: Mapping[str, Roots]
    """K of each way: (n, m) row numbers of equal-sized blocks, their eigenvectors (n, m, k) and eigenvalues (n, k)."""

    def root(self, sharing: Sharing, power: float) -> Roots:
        """(I + ratio K)^power, less the identity."""
        return tuple(
            (rows, U, (1.0 + sharing.ratio * value) ** power - 1.0)
            for rows, U, value in self.ways[sharing.way]
        )

    def apply(self, roots: Roots, X: Array) -> Array:
        """Multiply the rows of X (M, k) by the block matrices."""
        out = np.array(X)
        for rows, U, gain in roots:
            if not np.any(gain):
                continue
            n, m = rows.shape
            part = X[rows.ravel()].reshape(n, m, -1)
            along = gain[:, :, None] * np.matmul(U.transpose(0, 2, 1), part)
            out[rows.ravel()] += np.matmul(U, along).reshape(n * m, -1)
        return out

    def log_determinant(self, sharing: Sharing) -> float:
        """log |I + ratio K|."""
        return float(sum(np.log1p(sharing.ratio * value).sum() for _, _, value in self.ways[sharing.way]))


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
    shared: str = AXES
    """What they share: errors of the axes or of the joints."""

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
    ways = _ways(problem, spread, Split())
    return Noise(spread, _sharings(problem, ways, RATIOS[1::2]), ways)


def near(noise: Noise, kept: Sequence[Sharing], finer: bool = False) -> Noise:
    """The noise with the sharings that are likely and their neighbours on the grid, or halfway to them."""
    out = [Sharing()]
    for way in dict.fromkeys(s.way for s in noise.sharings if s.ratio > 0):
        there = sorted({s.ratio for s in kept if s.way == way and s.ratio > 0})
        first = bisect_left(RATIOS, there[0]) if there else 0
        last = bisect_left(RATIOS, there[-1]) if there else 0
        if finer and 1 <= len(there) <= 2:
            out += [Sharing(way, r) for r in (0.55 * there[0], *there, 1.8 * there[-1])]
        elif there or all(s.ratio == 0 for s in kept):
            out += [Sharing(way, r) for r in RATIOS[max(first - 1, 0) : last + 2]]
    return replace(noise, sharings=tuple(out)) if len(noise.sharings) > 1 else noise


def _sharings(problem: Problem, ways: Mapping[str, Roots], ratios: Sequence[float]) -> tuple[Sharing, ...]:
    """Those that the rows can tell: axes need several rows of one axis in a pose, joints several rows in a pose."""
    label = problem.pose * (problem.axis.max() + 1) + problem.axis
    repeated = {way: problem.rows - len(np.unique(problem.pose if way == JOINTS else label)) for way in ways}
    seen = [way for way in ways if repeated[way] >= 10 and problem.poses > 2]
    return (Sharing(), *(Sharing(way, r) for way in seen for r in ratios))


def _ways(problem: Problem, spread: Array, split: Split) -> dict[str, Roots]:
    """K of every way that the data can tell.

    All are scaled alike: a ratio of 1 is a shared error as large as the noise, mean square of the main rows.
    """
    common = np.ones(problem.rows)
    for kind in (problem.axis < 3, problem.axis >= 3):  # a shared error in metres, one in radians
        common[kind] = np.sqrt(np.mean(spread[kind] ** 2)) if np.any(kind) else 1.0
    u = common / spread
    axis = problem.pose * (problem.axis.max() + 1) + problem.axis
    markers = _markers(problem, split.own)
    alone = [np.sqrt(split.own) * u * marker for marker in markers]
    factor = np.column_stack([np.sqrt(1.0 - split.own) * u, *alone])
    ways = {AXES: _blocks(axis, factor)}
    if np.any(problem.axis < 3) and np.any(problem.axis >= 3):
        ways[SHIFT] = _blocks(axis, factor * (problem.axis < 3)[:, None])
    if problem.J is not None and any(j >= 0 for j in problem.joint_of):
        ways[JOINTS] = _blocks(problem.pose, of_joints(problem, common, split.joints) / spread[:, None])
    return ways


def _markers(problem: Problem, own: float) -> list[Array]:
    points = problem.points
    return [(points == p).astype(float) for p in np.unique(points)] if own > 0 else []


def of_joints(problem: Problem, common: Array, variances: Sequence[float] = ()) -> Array:
    """(M, n) readings of errors of the joints, the whole as large as ``common`` (M,) in the main rows.

    Where nothing is known of the variances all angles are alike, a slide's error as large at the tool as an angle's.
    """
    assert problem.J is not None
    J = problem.J[:, [v for v, j in enumerate(problem.joint_of) if j >= 0]]
    main = main_rows(problem)
    size = np.sqrt(np.mean(J[main] ** 2, axis=0))
    slides = np.array([j in problem.slides for j in problem.joint_of if j >= 0]) & (size > 0)
    if np.any(slides) and np.any(size[~slides] > 0):
        J = J * np.where(slides, np.sqrt(np.mean(size[~slides] ** 2)) / np.where(slides, size, 1.0), 1.0)
    if variances:
        J = J * np.sqrt(np.array(variances))
    whole = float(np.sqrt(np.sum(np.mean(J[main] ** 2, axis=0))))
    return np.asarray(J * (np.sqrt(np.mean(common[main] ** 2)) / max(whole, 1e-300)))


def by_joint(
    problem: Problem, residual: Array, spread: Array, scale2: float, ratio: float
) -> tuple[float, ...]:
    """Variances of the joints' errors up to a common factor: expectation and maximisation, drawn towards equal ones.

    ``residual`` (M,) in the data's unit with the shared error in it, of variance ratio·scale2 against scale2.
    """
    factor = of_joints(problem, spread) / spread[:, None]
    z = residual / (spread * np.sqrt(scale2))
    poses = np.unique(problem.pose)
    F = [factor[problem.pose == p] for p in poses]
    seen = np.stack([f.T @ z[problem.pose == p] for f, p in zip(F, poses, strict=True)])
    gram = np.stack([f.T @ f for f in F])
    w = np.ones(factor.shape[1])
    for _ in range(_STEPS):
        S = np.linalg.inv(gram + np.diag(1.0 / (ratio * w)))
        mean = np.einsum("pij,pj->pi", S, seen)
        second = np.sum(mean**2 + np.einsum("pii->pi", S), axis=0) / ratio
        w = (_ALIKE + second) / (_ALIKE + len(poses))
    return tuple(float(x) for x in w / np.mean(w))


def _blocks(label: Index, factor: Array) -> Roots:
    """Eigenvalues and vectors of the blocks of factor·factorᵀ, rows with one label each."""
    order = np.argsort(label, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
    out = []
    for size in sorted({len(g) for g in groups}):
        rows = np.array([g for g in groups if len(g) == size], dtype=np.intp)
        U, s, _ = np.linalg.svd(factor[rows], full_matrices=False)
        out.append((rows, U, s**2))
    return tuple(out)


def refine(
    problem: Problem, noise: Noise, residual: Array, dof: float, split: Split
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
    return Noise(spread, noise.sharings, _ways(problem, spread, split)), growth, by_marker


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
    sharing: Sharing,
    growth: dict[str, float],
    by_marker: dict[str, float],
    approach_p: float,
) -> NoiseReport:
    """Compare the noise found with the noise stated.

    ``scale2`` is the whitened residual's mean square, ``residual`` the residual in the data's unit.
    """
    rows = main_rows(problem)
    square, repeats = pure_error(problem, noise.spread)
    # directions that the shared error takes over say nothing of the rows' own
    taken = sum(
        float(np.sum(sharing.ratio * value / (1.0 + sharing.ratio * value)))
        for _, _, value in noise.ways[sharing.way]
    )
    source, found, freedom = "residual", scale2, max(dof - taken, 1.0)
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
        _homogeneity(problem, residual, dof), growth, by_marker, sigma * float(np.sqrt(sharing.ratio)),
        approach_p, sharing.way,
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
