"""Whether what was named has one size in the whole table, or follows something that its law does not depend on.

A name states a law with one size. Where the residual asks for another size with a joint's angle, the session or the
load, the law has another cause, as friction of a rig that stands on one side of the cell is no joint's hysteresis; or
it changed between the sessions that a table's files are of.
The test has few degrees of freedom, so that it sees what the search among all laws without a name does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from symstiff.arrays import TINY, Array
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.discrepancy.findings.result import Inconstancy, Name
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.statistics.prepare import Prepared
from symstiff.discrepancy.statistics.scan import Layer, Scan, back, coefficients, extend
from symstiff.reduction.svd import svd

LEVEL = 0.01
"""Family-wise level, over all effects of a set and all that their sizes may follow."""
NOTABLE = 0.03
"""Share of an effect's signal that follows something from which that is spoken of: no law's shape is exact."""
_TOLD = 1e-4
"""Singular value of a file's columns, by the largest, from which the file tells a direction by itself."""
_FILE = "file"
_OWN = 0.02
"""Share of a modulated signal's length that model and effects have to leave for a direction to be tested."""


@dataclass(frozen=True)
class _Modulator:
    """Something that a size may follow: ``values`` (M, k) about their mean."""

    name: str
    values: Array


def inconstancies(problem: Problem, ready: Prepared, entries: Sequence[int]) -> tuple[Inconstancy, ...]:
    """What the sizes of a set's effects follow, surest first: none for effects of one size in the whole table."""
    found = list(_tested(problem, ready, tuple(entries)))
    told = [replace(one, p_value=min(1.0, one.p_value * len(found))) for one in found]
    return tuple(
        sorted((o for o in told if o.p_value < LEVEL and o.share > NOTABLE), key=lambda o: o.p_value)
    )


def _tested(problem: Problem, ready: Prepared, entries: tuple[int, ...]) -> Iterator[Inconstancy]:
    """Every effect with everything that its size may follow, p-values of one test each."""
    bank, after = ready.bank, extend(ready.scan, entries)
    layer = after.best
    start = next(one for one in ready.scan.layers if one.sharing == layer.sharing)
    value = coefficients(ready.scan, problem.A, problem.y, entries)[0][problem.A.shape[1] :]
    sizes = np.split(value, np.cumsum([bank.width[e] for e in entries])[:-1])
    columns = [bank.slice(e) for e in entries]
    signals = [
        bank.columns[:, own] @ (bank.scale[own] * size) for own, size in zip(columns, sizes, strict=True)
    ]
    for k, entry in enumerate(entries):
        signal, candidate = signals[k][:, None], bank.candidates[int(bank.owner[entry])]
        alone = float(np.sum(_outside(after, start, signal)[0] ** 2))
        for by in _modulators(problem):
            test = _test(after, layer, signal * by.values, alone)
            if test is not None:
                p, share, change = test
                ways = 1.0 + by.values @ change
                name = Name(candidate.effect, candidate.where)
                each = _by_file(problem, ready.scan, layer, signals, k) if by.name == _FILE else ()
                yield Inconstancy(name, by.name, p, share, float(ways.min()), float(ways.max()), each)


def _by_file(
    problem: Problem, scan: Scan, layer: Layer, signals: Sequence[Array], k: int
) -> tuple[tuple[str, float], ...]:
    """The size of one of the effects in each file, where model and effects have sizes of their own in each.

    Compliances change with a gear that changes: sizes of the effect alone would bear that.
    """
    file, X, found = np.asarray(problem.file), np.column_stack([problem.A, *signals]), []
    for number in np.unique(file):
        there = X * (file == number)[:, None]
        rows = scan.noise.apply(
            layer.whiten, np.column_stack([problem.y, there]) / scan.noise.spread[:, None]
        )
        unit, length = unit_columns(rows[:, 1:])
        U, s, Vt = svd(unit)
        kept = s > _TOLD * s.max(initial=0.0)
        size = (Vt[kept].T @ ((U[:, kept].T @ rows[:, 0]) / s[kept]) / length)[problem.A.shape[1] + k]
        found.append((problem.files[number], float(size)))
    return tuple(found)


def _test(after: Scan, layer: Layer, modulated: Array, alone: float) -> tuple[float, float, Array] | None:
    """p-value, share of the signal, and relative change with each modulation; None where nothing of it is seen."""
    left, length = _outside(after, layer, modulated)
    U, s, Vt = svd(left)
    kept = s > _OWN * length
    freedom = after.freedom - int(kept.sum())
    if not np.any(kept) or freedom < 1:
        return None
    along = U[:, kept].T @ layer.y
    squares, k = float(along @ along), len(along)
    p = float(fdtrc(k, freedom, (squares / k) / max((layer.rss - squares) / freedom, TINY)))
    gained = max(squares - k * layer.rss / max(after.freedom, 1), 0.0)
    return p, gained / max(gained + alone, TINY), Vt[kept].T @ (along / s[kept])


def _outside(scan: Scan, layer: Layer, X: Array) -> tuple[Array, float]:
    """(M, k) rows in the data's unit whitened and projected off a layer's model, and the largest length before."""
    own = scan.noise.apply(scan.noise.own(-0.5), X / scan.noise.spread[:, None])
    white = back(scan.noise, layer.sharing, own)
    length = float(np.linalg.norm(white, axis=0).max())
    return np.asarray(white - layer.basis @ (layer.basis.T @ white)), length


def _modulators(problem: Problem) -> Iterator[_Modulator]:
    """File, session, temperature, size of the load, branch, and the joints' variables."""
    if problem.file is not None and np.ptp(problem.file) > 0:
        several = np.unique(problem.file)[1:]
        yield _about_mean(_FILE, (problem.file[:, None] == several).astype(float))
    context = {
        "time": problem.time, "temperature": problem.temperature, "load": problem.load, "branch": problem.branch,
    }  # fmt: skip
    told = {name: x for name, x in context.items() if x is not None and np.ptp(x) > 0}
    if "time" not in told:
        told = {"order": np.arange(problem.rows, dtype=float)} | told
    for name, x in told.items():
        yield _about_mean(name, x[:, None])
    for j, q in enumerate([] if problem.q is None else problem.q.T):
        if np.ptp(q) > 0:
            slides = j in problem.slides
            yield _about_mean(f"q{j + 1}", q[:, None] if slides else np.column_stack([np.sin(q), np.cos(q)]))


def _about_mean(name: str, values: Array) -> _Modulator:
    centred = values - values.mean(axis=0)
    return _Modulator(name, centred / np.maximum(np.abs(centred).max(axis=0), TINY))
