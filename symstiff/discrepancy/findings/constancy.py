"""Whether what was named has one size in the whole table, or follows something that its law does not depend on.

A name states a law with one size. Where the residual asks for another size with a joint's angle, the session or the
load, the law has another cause, as friction of a rig that stands on one side of the cell is no joint's hysteresis.
The test has few degrees of freedom, so that it sees what the search among all laws without a name does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from symstiff.arrays import TINY, Array
from symstiff.discrepancy.findings.result import Inconstancy, Name
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.statistics.prepare import Prepared
from symstiff.discrepancy.statistics.scan import Layer, Scan, back, coefficients, extend
from symstiff.reduction.svd import svd

LEVEL = 0.01
"""Family-wise level, over all effects of a set and all that their sizes may follow."""
NOTABLE = 0.03
"""Share of an effect's signal that follows something from which that is spoken of: no law's shape is exact."""
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
    told = [
        Inconstancy(one.name, one.by, min(1.0, one.p_value * len(found)), one.share, one.low, one.high)
        for one in found
    ]
    return tuple(
        sorted((o for o in told if o.p_value < LEVEL and o.share > NOTABLE), key=lambda o: o.p_value)
    )


def _tested(problem: Problem, ready: Prepared, entries: tuple[int, ...]) -> Iterator[Inconstancy]:
    """Every effect with everything that its size may follow, p-values of one test each."""
    bank, after = ready.bank, extend(ready.scan, entries)
    layer = after.best
    start = next(one for one in ready.scan.layers if one.sharing == layer.sharing)
    value = coefficients(ready.scan, problem.A, problem.y, entries)[0][problem.A.shape[1] :]
    ends = np.cumsum([bank.width[e] for e in entries])[:-1]
    for entry, size in zip(entries, np.split(value, ends), strict=True):
        columns = bank.slice(entry)
        signal = bank.columns[:, columns] @ (bank.scale[columns] * size)
        alone = float(np.sum(_outside(after, start, signal[:, None])[0] ** 2))
        candidate = bank.candidates[int(bank.owner[entry])]
        for by in _modulators(problem):
            test = _test(after, layer, signal[:, None] * by.values, alone)
            if test is not None:
                p, share, change = test
                ways = 1.0 + by.values @ change
                name = Name(candidate.effect, candidate.where)
                yield Inconstancy(name, by.name, p, share, float(ways.min()), float(ways.max()))


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
    p = float(stats.f.sf((squares / k) / max((layer.rss - squares) / freedom, TINY), k, freedom))
    gained = max(squares - k * layer.rss / max(after.freedom, 1), 0.0)
    return p, gained / max(gained + alone, TINY), Vt[kept].T @ (along / s[kept])


def _outside(scan: Scan, layer: Layer, X: Array) -> tuple[Array, float]:
    """(M, k) rows in the data's unit whitened and projected off a layer's model, and the largest length before."""
    own = scan.noise.apply(scan.noise.own(-0.5), X / scan.noise.spread[:, None])
    white = back(scan.noise, layer.sharing, own)
    length = float(np.linalg.norm(white, axis=0).max())
    return np.asarray(white - layer.basis @ (layer.basis.T @ white)), length


def _modulators(problem: Problem) -> Iterator[_Modulator]:
    """Session, temperature, size of the load, branch, and the joints' variables."""
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
