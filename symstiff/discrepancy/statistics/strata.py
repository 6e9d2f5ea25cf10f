"""Lack of fit in orthogonal strata: proportional to load, loading against unloading, time, nonlinear in load, rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from symstiff.arrays import TINY, Array, Index, numbered
from symstiff.calibration.fits.decomposition import RANK
from symstiff.discrepancy.noise.scales import NoiseReport, of_reading
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.statistics.scan import Scan, directions
from symstiff.reduction.svd import svd

PROPORTIONAL = "proportional to load, by pose"
"""The stratum in which compliances, frames and sensors speak."""
NONLINEAR = "nonlinear in load"
SEVERAL = 4
"""Directions from which on something may fit what it is not."""
_MOST = 0.7
"""Share of what the model leaves in a stratum beyond which a candidate or a set would fit anything there."""
_UNUSUAL = 10
"""Directions, beside those that usual sizes take, in which what is something else would be seen by unusual sizes."""
LEAST_REPEATS = 5
"""Degrees of freedom between repeats from which strata are held against them."""
_THEIRS = 1e-2
"""Part of a direction outside others below which it is theirs: loads are told to a few digits, and never quite
proportional."""


@dataclass(frozen=True)
class Stratum:
    """One orthogonal part of the residual space."""

    name: str
    degrees_of_freedom: int
    sum_of_squares: float
    """In units of the noise variance of the reference."""
    ratio: float
    """Mean square over the reference's mean square."""
    p_value: float | None
    """Adjusted over the strata (Holm); None where there is nothing to hold the stratum against."""


def fills(taken: float, left: float, usual: float) -> bool:
    """Would fit anything what takes so many of the directions that the model leaves in a stratum?

    Not where signals of ``usual`` sizes leave several of them: what is something else asks for unusual sizes there.
    """
    return taken >= SEVERAL and taken > _MOST * left and left - usual < _UNUSUAL


def strata(problem: Problem, scan: Scan) -> tuple[Stratum, ...]:
    """Split the whitened residual and test every stratum against repeats, else against the rest."""
    shares = _shares(problem, scan, _designs(problem))
    if shares.count >= LEAST_REPEATS:
        return _against_repeats(shares)
    rest, square = shares.rest, shares.square
    reference = square / max(rest, 1)
    return (*_table(shares.parts, reference, rest), _reference("rest", rest, square, reference))


def lack_of_fit(problem: Problem, scan: Scan, report: NoiseReport) -> tuple[Stratum, ...]:
    """The same as it is told: without repeats every stratum, the rest as well, is held against the noise of a report.

    That was learned from what is left of all that stands out: a law that is odd in the load may be in the rest, and
    does not hide the others. What is nonlinear in the load has its cube where there are levels enough.
    """
    designs = _designs(problem, odd=True)
    shares = _shares(problem, scan, designs)
    if shares.count >= LEAST_REPEATS:
        return _against_repeats(shares)
    # where the loads of a pose leave nothing but what is nonlinear in them, that is the rest
    all_of_it = designs[-1][0] == NONLINEAR and all(name != NONLINEAR for name, *_ in shares.parts)
    rest = (NONLINEAR if all_of_it else "rest", shares.rest, shares.square)
    spread = scan.noise.spread[problem.main]
    # whitened rows are without what those of their reading share, sigma is with it
    reference = report.sigma**2 / (float(np.mean(spread**2)) * of_reading(problem, scan.noise))
    return _table([*shares.parts, *([rest] if shares.rest else [])], reference, report.degrees_of_freedom)


@dataclass(frozen=True)
class _Shares:
    """What strata take of a whitened residual: name, degrees of freedom and squares of each; what is left for the rest.

    ``repeats`` are the squares between repeats, which are a part of the rest, ``count`` their degrees of freedom.
    """

    parts: tuple[tuple[str, int, float], ...]
    rest: int
    square: float
    repeats: float
    count: int


def _shares(problem: Problem, scan: Scan, designs: Sequence[tuple[str, Array, bool]]) -> _Shares:
    """Columns that belong to one pose each are projected out pose by pose; the model and other columns that run over
    all poses follow outside of them, so that no large matrix is factorised.
    """
    layer = scan.best
    overall = layer.basis
    y = (layer.y - overall @ (overall.T @ layer.y))[:, None]
    local = np.zeros((problem.rows, 0))
    before_square, before_rank = float(np.sum(y**2)), overall.shape[1]
    parts: list[tuple[str, int, float]] = []
    for name, columns, by_pose in designs:
        W = scan.noise.apply(layer.whiten, columns / scan.noise.spread[:, None])
        if by_pose:
            local = np.hstack([local, W])
        else:
            overall = np.hstack([overall, W])
        square, rank = _left(problem.pose, local, overall, y)
        if rank >= problem.rows:
            break
        if rank > before_rank:
            parts.append((name, rank - before_rank, max(before_square - square, 0.0)))
        before_square, before_rank = square, rank
    repeats, count = _between_repeats(problem, scan, local, overall, y)
    return _Shares(tuple(parts), problem.rows - before_rank, before_square, repeats, count)


def _against_repeats(shares: _Shares) -> tuple[Stratum, ...]:
    """The strata, and what of the rest is not between repeats, held against those."""
    reference = shares.repeats / shares.count
    parts = list(shares.parts)
    if shares.rest > shares.count:
        further = ("rest", shares.rest - shares.count, max(shares.square - shares.repeats, 0.0))
        parts.append(further)
    return (
        *_table(parts, reference, shares.count),
        _reference("repeats", shares.count, shares.repeats, reference),
    )


def pure_error(problem: Problem, scan: Scan, entries: tuple[int, ...]) -> tuple[float, int]:
    """Sum of squares between repeats that a scan with some entries leaves, whitened, and its degrees of freedom.

    What differs between repeats because the model has it (a drift, an approach that each repeat has alone) is no noise.
    """
    layer = scan.best
    overall = np.hstack([layer.basis, directions(scan, layer, entries)[0]])
    return _between_repeats(problem, scan, np.zeros((problem.rows, 0)), overall, layer.y[:, None])


def _between_repeats(
    problem: Problem, scan: Scan, local: Array, overall: Array, y: Array
) -> tuple[float, int]:
    """The same of y (M, 1), further columns taken out: by pose, and over all poses."""
    if len(np.unique(problem.cells)) == problem.rows:
        return 0.0, 0
    each = numbered(problem.case, problem.channel)
    means = scan.noise.apply(scan.best.whiten, _indicators(each) / scan.noise.spread[:, None])
    square, rank = _left(problem.pose, np.hstack([local, means]), overall, y)
    return square, problem.rows - rank


def _left(pose: Index, local: Array, overall: Array, y: Array) -> tuple[float, int]:
    """Residual sum of squares of y (M, 1) and rank, for columns by pose and columns over all poses.

    ``local`` (M, k) holds, row by row, values that each pose multiplies by coefficients of its own.
    """
    joined = np.hstack([y, overall])
    rank = 0
    if local.shape[1]:
        joined = joined.copy()
        for p in np.unique(pose):
            rows = np.flatnonzero(pose == p)
            U, s, _ = svd(local[rows])
            U = U[:, s > RANK * max(float(s[0]), TINY)]
            joined[rows] -= U @ (U.T @ joined[rows])
            rank += U.shape[1]
    length = np.linalg.norm(np.hstack([y, overall])[:, 1:], axis=0)
    X = joined[:, 1:][:, length > 0] / length[length > 0]
    U, s, _ = svd(X)
    U = U[:, s > _THEIRS]
    z = joined[:, 0] - U @ (U.T @ joined[:, 0])
    return float(z @ z), rank + U.shape[1]


def _table(parts: Sequence[tuple[str, int, float]], reference: float, freedom: float) -> tuple[Stratum, ...]:
    """The strata by a reference mean square with its degrees of freedom; without p-values where that says nothing."""
    testable = freedom >= 3 and reference > 0
    raw = [
        float(fdtrc(df, freedom, max(ss / df / reference, 0.0))) if testable and df > 0 else 1.0
        for _, df, ss in parts
    ]
    order = np.argsort(raw)
    adjusted = np.ones(len(raw))
    running = 0.0
    for place, i in enumerate(order):
        running = max(running, min(1.0, raw[i] * (len(raw) - place)))
        adjusted[i] = running
    scale = reference if testable else 1.0
    return tuple(
        Stratum(name, df, ss / scale, ss / max(df, 1) / scale, float(p) if testable else None)
        for (name, df, ss), p in zip(parts, adjusted, strict=True)
    )


def _reference(label: str, count: int, square: float, reference: float) -> Stratum:
    """The stratum that the others are held against."""
    scale = reference if count >= 3 and reference > 0 else 1.0
    return Stratum(label, count, square / scale, 1.0, None)


def _designs(problem: Problem, odd: bool = False) -> list[tuple[str, Array, bool]]:
    """Columns of the strata in the order in which they take their share; True: with coefficients for each pose.

    ``odd``: the cube of the load too.
    """
    channel = _indicators(problem.channel)
    out: list[tuple[str, Array, bool]] = []
    several = problem.load is not None and _levels(problem) > 1
    load = problem.load if problem.load is not None and several else np.ones(problem.rows)
    if problem.time is not None and np.ptp(problem.time) > 0:
        s = (problem.time - problem.time.mean()) / np.ptp(problem.time)
        out.append(("time", np.hstack([channel * s[:, None], channel * (s**2)[:, None]]), False))
    if problem.temperature is not None and np.ptp(problem.temperature) > 0:
        warm = (problem.temperature - problem.temperature.mean())[:, None]
        out.append(("temperature", channel * warm, False))
    if problem.branch is not None and np.ptp(problem.branch) > 0:
        out.append(("loading against unloading", channel * problem.branch[:, None], True))
    out.append((PROPORTIONAL, channel * load[:, None], True))
    if several:
        out.append(("common to a pose's load cases", channel, True))
        if _levels(problem) > 2:
            powers = (2, 3) if odd and _levels(problem) > 3 else (2,)
            columns = [channel * (load**power)[:, None] for power in powers]
            out.append((NONLINEAR, np.hstack(columns), True))
    return out


def _levels(problem: Problem) -> int:
    if problem.load is None:
        return 1
    return int(
        np.median(
            [len(np.unique(np.round(problem.load[problem.pose == p], 6))) for p in np.unique(problem.pose)]
        )
    )


def _indicators(label: Index) -> Array:
    return np.asarray(label[:, None] == np.unique(label)[None, :], dtype=float)
