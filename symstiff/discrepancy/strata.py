"""Lack of fit in orthogonal strata: proportional to load, loading against unloading, time, nonlinear in load, rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from symstiff.discrepancy.noise import pure_error
from symstiff.discrepancy.problem import Array, Problem
from symstiff.discrepancy.scan import Scan


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


def strata(problem: Problem, scan: Scan) -> tuple[Stratum, ...]:
    """Split the whitened residual and test every stratum against repeats, else against the rest."""
    layer = scan.best
    parts: list[tuple[str, int, float]] = []
    basis = layer.basis
    for name, columns in _designs(problem):
        W = scan.noise.apply(layer.whiten, columns / scan.noise.spread[:, None])
        new = _outside(basis, W)
        if new.shape[1] == 0 or basis.shape[1] + new.shape[1] >= len(layer.y):
            continue
        parts.append((name, new.shape[1], float(np.sum((new.T @ layer.y) ** 2))))
        basis = np.hstack([basis, new])
    rest = len(layer.y) - basis.shape[1]
    square = float(layer.y @ layer.y) - sum(p[2] for p in parts)
    reference, freedom = square / max(rest, 1), rest
    repeats, count = pure_error(problem, scan.noise.spread)
    if count >= 5:
        reference, freedom = repeats / count, count
        parts.append(("rest", rest - count, max(square - repeats, 0.0)))
    return _table(parts, reference, freedom, count >= 5, rest, square)


def _table(
    parts: list[tuple[str, int, float]], reference: float, freedom: int, repeated: bool, rest: int, square: float
) -> tuple[Stratum, ...]:
    testable = freedom >= 3 and reference > 0
    raw = [float(stats.f.sf(ss / df / reference, df, freedom)) if testable and df > 0 else 1.0 for _, df, ss in parts]
    order = np.argsort(raw)
    adjusted = np.ones(len(raw))
    running = 0.0
    for place, i in enumerate(order):
        running = max(running, min(1.0, raw[i] * (len(raw) - place)))
        adjusted[i] = running
    scale = reference if testable else 1.0
    out = [
        Stratum(name, df, ss / scale, ss / max(df, 1) / scale, float(p) if testable else None)
        for (name, df, ss), p in zip(parts, adjusted, strict=True)
    ]
    label, count = ("repeats", freedom) if repeated else ("rest", rest)
    out.append(Stratum(label, count, (reference * freedom if repeated else square) / scale, 1.0, None))
    return tuple(out)


def _outside(basis: Array, columns: Array) -> Array:
    length = np.linalg.norm(columns, axis=0)
    columns = columns[:, length > 0] / length[length > 0]
    left = columns - basis @ (basis.T @ columns)
    left = left - basis @ (basis.T @ left)
    if not left.shape[1]:
        return left
    U, s, _ = np.linalg.svd(left, full_matrices=False)
    return np.asarray(U[:, s > 1e-7])


def _designs(problem: Problem) -> list[tuple[str, Array]]:
    """Columns of the strata, in the order in which they take their share."""
    channel = _indicators(problem.channel)
    cell = _indicators(problem.pose * (problem.channel.max() + 1) + problem.channel)
    out: list[tuple[str, Array]] = []
    several = problem.load is not None and _levels(problem) > 1
    load = problem.load if problem.load is not None and several else np.ones(problem.rows)
    if problem.time is not None and np.ptp(problem.time) > 0:
        s = (problem.time - problem.time.mean()) / np.ptp(problem.time)
        out.append(("time", np.hstack([channel * s[:, None], channel * (s**2)[:, None]])))
    if problem.temperature is not None and np.ptp(problem.temperature) > 0:
        out.append(("temperature", channel * (problem.temperature - problem.temperature.mean())[:, None]))
    if problem.branch is not None and np.ptp(problem.branch) > 0:
        out.append(("loading against unloading", np.hstack([cell * problem.branch[:, None]])))
    out.append(("proportional to load, by pose", cell * load[:, None]))
    if several:
        out.append(("common to a pose's load cases", cell))
        if _levels(problem) > 2:
            out.append(("nonlinear in load", cell * (load**2)[:, None]))
    return out


def _levels(problem: Problem) -> int:
    if problem.load is None:
        return 1
    return int(
        np.median([len(np.unique(np.round(problem.load[problem.pose == p], 6))) for p in np.unique(problem.pose)])
    )


def _indicators(label: Array | np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> Array:
    values = np.unique(label)
    return np.asarray(label[:, None] == values[None, :], dtype=float)
