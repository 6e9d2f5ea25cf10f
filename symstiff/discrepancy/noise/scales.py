"""The noise: its scale, how it differs between axes and distances, and what a pose's load cases share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chdtrc, chdtri

from symstiff.arrays import Array
from symstiff.discrepancy.noise.blocks import Roots, applied, raised
from symstiff.discrepancy.noise.shaking import STILL, Shaken, common_size, shared_by_readings
from symstiff.discrepancy.noise.sharing import (
    ALIKE,
    AXES,
    JOINTS,
    Sharing,
    Split,
    at_first,
    mostly,
    patterns,
    shares,
)
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.reasons import Reason, Why

_SURE = 2.8
"""Standard deviations from which the noise is said to grow with a quantity."""
_VARIES = 0.02
"""Standard deviation of a quantity's logarithm below which nothing tells whether the noise grows with it."""
_OUTLYING = 25.0
"""Square of a residual over the mean square beyond which it counts no more: five standard deviations are a slip."""
_ALIKE_LEVELS, _NO_GROWTH, _ANY_SCALE = 20.0, 4.0, 2e-9
"""Observations that beliefs count for: that axes and markers scatter alike, that the noise grows with nothing; of its
scale there is none."""
_ROUNDS, _LOUDEST, _STEEPEST = 12, 40.0, 1e3
"""Newton's steps, and bounds of a log variance and of a slope of the likelihood, so that no step of them overflows."""

NEGLIGIBLE = 0.03
"""Departure of sigma from the stated one that changes nothing in practice: no remark is made of it."""

CONTRADICTED = 1.8
"""Least ratio of the residual to the stated sigma at which a table without a rejected test is not explained.

A sigma that is a fifth too small and that of one reading, where a deflection is the difference of two, make 1.77.
"""
REPEATABILITY = 5.0
"""The same where every axis is read once in a pose: how a robot misses its poses is in the residual then."""
_KNOWN = 1.3
"""Factor to which the variance that a pose's rows share is known, about."""
_LEAST = 1e-12
"""Least standard deviation that is told [m, rad]."""
ENOUGH = 20
"""Degrees of freedom between repeats from which the noise is taken from them."""


@dataclass(frozen=True)
class Noise:
    """Covariance D (S + ratio K) D of the rows, K by pose and way of sharing; whoever uses it weighs the sharings.

    S is the identity, or what the markers of one reading share beside it; K is kept as S^-½·K·S^-½.
    """

    spread: Array
    """(M,) standard deviations D, up to the common scale."""
    sharings: tuple[Sharing, ...]
    ways: Mapping[str, Roots]
    """K of each way: (n, m) row numbers of equal-sized blocks, their eigenvectors (n, m, k) and eigenvalues (n, k)."""
    learned: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """The variances of the ways that were learned."""
    reading: Roots = ()
    """S less the identity; its blocks are the readings."""
    shaken: Shaken = STILL
    """What they share."""

    @property
    def alone(self) -> Noise:
        """The noise at the first of its sharings."""
        return replace(self, sharings=self.sharings[:1])

    def root(self, sharing: Sharing, power: float) -> Roots:
        """Square root (power ½) of S + ratio K, or its inverse (-½): factors, the first one is applied first.

        Each factor is symmetric, so that the reversed order is the transpose.
        """
        own, shared = self.own(power), self.shared(sharing, power)
        return shared + own if power > 0 else own + shared

    def own(self, power: float) -> Roots:
        """The factor of S."""
        return raised(self.reading, power)

    def shared(self, sharing: Sharing, power: float) -> Roots:
        """The factor of what a pose's rows share."""
        return raised(self.ways[sharing.way], power, sharing.ratio)

    def apply(self, roots: Roots, X: Array) -> Array:
        """Multiply the rows of X (M, k) by the block matrices, one after the other."""
        return applied(roots, X)

    def weigh(self, rows: Array) -> Array:
        """Rows (M, k) in units of the noise, up to the common scale, at the first of the sharings."""
        return self.apply(self.root(self.sharings[0], -0.5), rows / self.spread[:, None])

    def log_determinant(self, sharing: Sharing) -> float:
        """log |S + ratio K|, and twice the price of what was learned."""
        learned = max(len(self.learned.get(sharing.way, ())) - 1, 0)
        poses = sum(len(rows) for rows, _, _ in self.ways[sharing.way])
        return learned * float(np.log1p(poses / ALIKE)) + float(
            sum(np.log1p(sharing.ratio * value).sum() for _, _, value in self.ways[sharing.way])
            + sum(np.log1p(value).sum() for _, _, value in self.reading)
        )


@dataclass(frozen=True)
class Settling:
    """A joint that stops at another place at every reading of a pose."""

    joint: int
    std: float
    """Standard deviation of that place [rad], of a slide [m]."""
    slide: bool

    def __str__(self) -> str:
        size = f"{1e3 * self.std:.2g} {'mm' if self.slide else 'mrad'}"
        return (
            f"joint {self.joint} stops elsewhere at every reading of a pose, by {size} (standard deviation)"
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
    shared: str = AXES
    """What they share: errors of the axes or of the joints."""
    single: bool = False
    """Every axis is read once in a pose: what its rows share cannot be told from the noise."""
    approach_by_axis: dict[int, float] = field(default_factory=dict)
    """Of each axis, what a pose's rows share."""
    anew: float | None = None
    """Part of its variance that each repeat of a pose has alone; None without repeats."""
    reading: float = 0.0
    """Part of the rows' own variance that the markers of one reading share."""
    settling: tuple[Settling, ...] = ()
    """Joints that stop elsewhere at every reading."""

    @property
    def settles(self) -> Reason | None:
        """That joints stop elsewhere at every reading, as a sentence; None where none does."""
        told = "; ".join(str(joint) for joint in self.settling)
        return Reason(Why.SETTLES, (told,)) if told else None

    @property
    def mostly_shared(self) -> bool:
        """Whether the error that a pose's load cases share exceeds what each has for itself."""
        return self.approach > self.sigma

    def by_component(self, shared: bool = True) -> Array:
        """(6,) standard deviation of a component [m, rad], with or without what a pose's rows share."""
        own = np.array([self.by_axis.get(k) or self.sigma for k in range(6)])
        common = np.array([self.approach_by_axis.get(k, 0.0) if shared else 0.0 for k in range(6)])
        return np.asarray(np.maximum(np.hypot(own, common), _LEAST))


def stated(problem: Problem) -> Array:
    """(M,) sigma where given, else one number for each kind of component."""
    if problem.sigma is not None:
        return np.array(problem.sigma, dtype=float)
    spread = np.ones(problem.rows)
    for rows in (problem.axis < 3, problem.axis >= 3):
        if np.any(rows):
            spread[rows] = max(float(np.std(problem.y[rows])), _LEAST)
    return spread


def start(problem: Problem, split: Split) -> Noise:
    """The noise as stated, with the coarse grid of what a pose's rows may share."""
    return _noise(problem, stated(problem), split)


def _noise(problem: Problem, spread: Array, split: Split) -> Noise:
    ways = patterns(problem, spread, split)
    return Noise(
        spread,
        at_first(problem, ways),
        ways,
        split.learned,
        shared_by_readings(problem, spread, split.reading),
        split.reading,
    )


def refine(
    problem: Problem, residual: Array, dof: float, split: Split
) -> tuple[Noise, dict[str, float], dict[str, float]]:
    """Fit how the noise differs between axes and markers from the stated one and grows with ``problem.spread``.

    ``residual`` (M,) in the data's unit after the model and whatever was found; ``dof`` its degrees of freedom.
    Gamma regression of the squares on axis, marker and log quantities, shrunk towards homogeneity by a ridge of 20
    observations (axis, marker) and of 4. Returns also the exponents and the markers' factors. A model that passes
    through all rows leaves nothing to fit to.
    """
    told = stated(problem)
    if dof < 1 or not np.any(residual):
        return _noise(problem, told, split), {}, {}
    z = (residual / told) ** 2 * (problem.rows / max(dof, 1.0))
    z = np.minimum(z, _OUTLYING * np.mean(z)) / np.mean(z)  # the scale is no part of what differs
    axes, points = np.unique(problem.axis), problem.points
    markers = np.unique(points) if len(np.unique(points)) > 1 else points[:0]
    names = [k for k, v in problem.spread.items() if np.all(v > 0) and np.std(np.log(v)) > _VARIES]
    X = [np.ones(problem.rows), *((problem.axis == a) - np.mean(problem.axis == a) for a in axes)]
    X += [(points == m) - np.mean(points == m) for m in markers]
    X += [np.log(problem.spread[k]) - np.mean(np.log(problem.spread[k])) for k in names]
    design, levels = np.column_stack(X), len(axes) + len(markers)
    believed = [_ANY_SCALE, *[_ALIKE_LEVELS] * levels, *[_NO_GROWTH] * len(names)]
    beta, deviation = _regressed(z, design, 0.5 * dof / problem.rows, 0.5 * np.array(believed))
    spread = told * np.exp(0.5 * design[:, 1:] @ beta[1:])
    sure = np.abs(beta) > _SURE * deviation
    growth = {k: float(0.5 * beta[1 + levels + n]) for n, k in enumerate(names) if sure[1 + levels + n]}
    alone = beta[1 + len(axes) : 1 + levels]
    others = (np.sum(alone) - alone) / max(len(alone) - 1, 1)
    factor = np.exp(0.5 * (alone - others)).tolist()
    by_marker = {problem.marker(int(m)): f for m, f in zip(markers, factor, strict=True)}
    return _noise(problem, spread, split), growth, by_marker


def _regressed(z: Array, design: Array, weight: float, ridge: Array) -> tuple[Array, Array]:
    """Log variances' coefficients (k,) of squares z (M,) by a design (M, k), the first one the scale; and deviations.

    ``weight`` of each row, ``ridge`` (k,): half of the observations that it, and the belief in zero, count for.
    """
    beta = np.zeros(design.shape[1])
    beta[0] = np.log(np.mean(z))
    hessian = weight * design.T @ design + np.diag(ridge)
    for _ in range(_ROUNDS):
        mean = np.exp(np.clip(design @ beta, -_LOUDEST, _LOUDEST))
        gradient = weight * design.T @ (z / mean - 1.0) - ridge * beta * (np.arange(len(beta)) > 0)
        beta = beta + np.linalg.solve(hessian, np.clip(gradient, -_STEEPEST, _STEEPEST))
    return beta, np.sqrt(np.diag(np.linalg.inv(hessian)))


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
    between: tuple[float, int],
) -> NoiseReport:
    """Compare the noise found with the noise stated.

    ``residual`` is the whitened residual in the data's unit, ``scale2`` its mean square in units of the spread;
    ``between`` the sum of squares between repeats in these units, and its degrees of freedom. ``growth`` and
    ``by_marker`` as of ``refine``; ``approach_p`` that a pose's rows share nothing.
    """
    rows = problem.main
    square, repeats = between
    whole = of_reading(problem, noise)
    source, found, freedom = "residual", scale2 * whole, max(dof - _taken(noise, sharing), 1.0)
    if repeats >= ENOUGH:
        source, found, freedom = "repeats", square / repeats * whole, float(repeats)
    sigma = float(np.sqrt(found * np.mean(noise.spread[rows] ** 2)))
    told = None if problem.sigma is None else float(np.sqrt(np.mean(problem.sigma[rows] ** 2)))
    relative = interval = None
    misstated = False
    if problem.sigma is not None and (dof >= 1 or source == "repeats"):
        relative = float(np.sqrt(found * np.mean((noise.spread / problem.sigma) ** 2)))
        interval = _interval(relative, freedom)
        misstated = off(interval) and not (problem.differences and _off_by_half(interval, noise, sharing))
    axes = [(int(a), problem.axis == a) for a in np.unique(problem.axis)]
    mean = float(np.mean((residual / noise.spread) ** 2))
    gain = found / mean if mean > 0 else 1.0  # the model's freedom is deducted from all axes alike
    by_axis = {a: float(np.sqrt(gain * np.mean(residual[own] ** 2))) for a, own in axes}
    common = found / whole * noise.spread**2 * _diagonal(noise, sharing)
    return NoiseReport(
        sigma, told, relative, interval, misstated, freedom, source, by_axis,
        homogeneity(problem, residual, dof), growth, by_marker,
        float(np.sqrt(np.mean(common[rows]))), approach_p, _mostly(problem, noise, sharing),
        not shares(problem, AXES), {a: float(np.sqrt(np.mean(common[own]))) for a, own in axes},
        reading=_of_axes(problem, noise) / whole, settling=_settling(problem, noise, found / whole),
    )  # fmt: skip


def of_reading(problem: Problem, noise: Noise) -> float:
    """A row's variance with what the rows of its reading share over that without it, mean of the main rows."""
    return float(np.mean((1.0 + _square(noise, noise.reading))[problem.main]))


def _of_axes(problem: Problem, noise: Noise) -> float:
    """Variance over the noise's of what the markers of one reading share, mean of the main rows."""
    size = common_size(problem, noise.spread) / noise.spread
    return noise.shaken.axes * float(np.mean(size[problem.main] ** 2))


def _settling(problem: Problem, noise: Noise, scale2: float) -> tuple[Settling, ...]:
    """The joints' errors from reading to reading, with the variance ``scale2`` of the noise in units of the spread."""
    return tuple(
        Settling(joint + 1, float(np.sqrt(scale2 * variance)), joint in problem.slides)
        for joint, variance in noise.shaken.joints
    )


def _taken(noise: Noise, sharing: Sharing) -> float:
    """Directions that the shared error takes over: they say nothing of the rows' own."""
    return sum(
        float(np.sum(sharing.ratio * value / (1.0 + sharing.ratio * value)))
        for _, _, value in noise.ways[sharing.way]
    )


def _interval(ratio: float, freedom: float) -> tuple[float, float]:
    """Between what a ratio of deviations, known with some degrees of freedom, is in 96 % of cases."""
    low, high = (np.sqrt(freedom / chdtri(freedom, above)) for above in (0.02, 0.98))
    return float(ratio * low), float(ratio * high)


def _mostly(problem: Problem, noise: Noise, sharing: Sharing) -> str:
    """What a pose's rows share, mostly."""
    learned = noise.learned.get(sharing.way)
    return mostly(problem, noise.spread, learned) if learned else sharing.way


def off(interval: tuple[float, float]) -> bool:
    """Whether a ratio to the stated sigma says that this is wrong."""
    return interval[0] > 1.0 + NEGLIGIBLE or interval[1] < 1.0 - NEGLIGIBLE


def _off_by_half(interval: tuple[float, float], noise: Noise, sharing: Sharing) -> bool:
    """Whether a ratio below one is that of one of two readings: the stated sigma counts the one without load as well.

    This is what a pose's rows share, no larger than the noise of their own.
    """
    shared = float(np.mean(_diagonal(noise, sharing))) if sharing.way != JOINTS else 0.0
    least, most = (np.sqrt(1.0 + min(shared * known, 1.0)) for known in (1.0 / _KNOWN, _KNOWN))
    return shared > 0 and not off((interval[0] * least, interval[1] * most))


def _diagonal(noise: Noise, sharing: Sharing) -> Array:
    """(M,) of ratio K."""
    return _square(noise, noise.ways[sharing.way], sharing.ratio, raised(noise.reading, 0.5))


def _square(noise: Noise, roots: Roots, ratio: float = 1.0, factor: Roots = ()) -> Array:
    """(M,) diagonal of F·ratio·(the blocks)·Fᵀ."""
    out = np.zeros(len(noise.spread))
    for rows, U, value in roots:
        if not factor:
            out[rows] = np.einsum("nmk,nk->nm", U**2, ratio * value)
            continue
        columns = np.zeros((len(out), U.shape[2]))
        columns[rows] = U * np.sqrt(ratio * value)[:, None, :]
        out += np.sum(noise.apply(factor, columns) ** 2, axis=1)
    return out


def homogeneity(problem: Problem, residual: Array, dof: float) -> float:
    """Bartlett's test over the axes of each kind (translations, rotations): the smaller p-value, by Bonferroni."""
    found = []
    for kind in (problem.axis < 3, problem.axis >= 3):
        axes = np.unique(problem.axis[kind])
        if len(axes) < 2:
            continue
        share = dof / problem.rows
        n = np.array([share * np.sum(problem.axis == a) for a in axes])
        s2 = np.array([np.mean(residual[problem.axis == a] ** 2) for a in axes])
        if np.any(s2 <= 0) or np.any(n < 2):
            continue
        pooled = float(n @ s2 / n.sum())
        statistic = n.sum() * np.log(pooled) - n @ np.log(s2)
        found.append(float(chdtrc(len(axes) - 1, max(statistic, 0.0))))
    return min(1.0, len(found) * min(found, default=1.0))
