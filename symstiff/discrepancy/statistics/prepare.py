"""From a problem to the scan on which everything else works: bank, noise, projection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from symstiff.arrays import Array, numbered
from symstiff.calibration.fits.decomposition import column_space
from symstiff.discrepancy.laws.unnamed import unnamed_laws
from symstiff.discrepancy.noise import scales as noises
from symstiff.discrepancy.noise.shaking import Shaken, of_axes, products, readings, repeats, shaken
from symstiff.discrepancy.noise.sharing import (
    JOINTS,
    LEARNED,
    RATIOS,
    Split,
    approaches,
    near,
    repeated,
    several_markers,
    sizes,
)
from symstiff.discrepancy.problem import Candidate, Problem
from symstiff.discrepancy.statistics.bank import Bank, build
from symstiff.discrepancy.statistics.between import between, with_shapes
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.ratios import with_likeliest
from symstiff.discrepancy.statistics.scan import (
    Scan,
    at_sharing,
    at_sharings,
    extend,
    likely,
    one_sharing,
    open_scan,
)
from symstiff.discrepancy.statistics.strata import pure_error

SAME_SHARE = 0.1
"""Change of the markers' or the repeats' own part of a shared error up to which the coarse grid is not seen again."""
_MOST, _STANDS_OUT = 3, 4.0
"""Candidates that stand out beyond doubt, at most, and the score from which one does."""
_LOOKS = _COARSE, _NEAR, _FINE = "coarse", "near", "fine"
"""How the size of the shared error is looked for."""

Pairs = tuple[float, float]
"""Sum of products of pairs of rows, and how many pairs there are."""


@dataclass(frozen=True)
class Prepared:
    """The scan with the noise that it rests on."""

    scan: Scan
    bank: Bank
    report: noises.NoiseReport
    residual: Array
    """(M,) of the current model, data's unit, at the likeliest noise."""


@dataclass(frozen=True, eq=False)
class _Look:
    """A scan at the sharings that are likely in it or after what stands out."""

    scan: Scan
    obvious: tuple[int, ...]
    """Entries that stand out."""
    clean: Scan
    """The scan with them in the model."""


def prepare(problem: Problem, candidates: Sequence[Candidate], like: noises.Noise | None = None) -> Prepared:
    """Rounds: homogeneous noise finds what stands out, and the noise is fitted to what is left after it.

    Otherwise a large missing effect would pass for noise that differs between axes or between poses. The size of the
    shared error is looked for on the coarse grid, on that once more where markers share otherwise than it seemed,
    near what is likely, and finer. A noise that was found for the same readings and is ``like`` this one spares all
    looks but the last.
    """
    bank = build(problem, candidates, unnamed_laws(problem))
    first = _first_split(problem)
    bank, seen = _looked(problem, bank, like or noises.start(problem, first))
    split = _split(problem, seen)
    changed = max(
        abs(split.own - first.own), abs(split.anew - first.anew), split.reading.change(first.reading)
    )
    looks = _LOOKS[1 if changed < SAME_SHARE else 0 :] if like is None else (_FINE,)
    for look in looks:
        clean = seen.clean
        noise, growth, by_marker = noises.refine(problem, _within_residual(clean), clean.freedom, split)
        if look != _COARSE:
            kept = [layer.sharing for layer in clean.layers]
            noise = replace(noise, sharings=near(noise.sharings, kept, look == _FINE))
        if look == _FINE:
            found = [bank.columns[:, bank.slice(e)] for e in seen.obvious]
            noise = with_likeliest(noise, problem.y, np.hstack([problem.A, *found]))
        seen = _opened(problem, bank, noise, by_way=look != _FINE)
        split = _split(problem, seen) if look != _FINE else split
    report = _report(problem, seen.scan, seen.clean, seen.obvious, growth, by_marker)
    report = replace(report, anew=split.anew if repeated(problem) else None)
    return Prepared(seen.scan, bank, report, _data_residual(seen.scan))


def noise_told_anew(problem: Problem, ready: Prepared, entries: tuple[int, ...]) -> Prepared:
    """The same with the noise told that is left after what was found, which may have passed for a shared error."""
    told = ready.report
    report = _report(problem, ready.scan, extend(ready.scan, entries), entries, told.growth, told.by_marker)
    return replace(ready, report=replace(report, anew=told.anew))


def _report(
    problem: Problem, scan: Scan, clean: Scan, entries: tuple[int, ...], growth: dict[str, float],
    by_marker: dict[str, float],
) -> noises.NoiseReport:  # fmt: skip
    """The noise that some entries leave, ``clean`` being the scan with them."""
    return noises.report(
        problem, clean.noise, _within_residual(clean), clean.best.rss / max(clean.freedom, 1), clean.freedom,
        clean.best.sharing, growth, by_marker, _sharing_none(clean),
        pure_error(problem, at_sharing(scan, clean.best.sharing), entries),
    )  # fmt: skip


def _looked(problem: Problem, bank: Bank, noise: noises.Noise) -> tuple[Bank, _Look]:
    """The bank with shapes between for what stands out, and the look at it."""
    seen = _opened(problem, bank, noise, by_way=True)
    place = 0
    while place < len(seen.obvious):
        if more := between(seen.scan, seen.obvious[:place]):
            bank = with_shapes(problem, bank, more)
            seen = _opened(problem, bank, noise, by_way=True)
        place += 1
    return bank, seen


def at_first(problem: Problem) -> noises.Noise:
    """How the rows scatter about the model alone, at one way of sharing: an effect that the rows of a pose share is in.

    So it bends nothing that is weighed by it. It takes a tenth of a second where ``prepare`` takes seconds.
    """
    noise = noises.start(problem, _first_split(problem))
    return one_sharing(open_scan(build(problem, (), ()), noise, problem.y, problem.A))


def _opened(problem: Problem, bank: Bank, noise: noises.Noise, by_way: bool) -> _Look:
    """A look at the data under some noise.

    What all load cases of a pose share passes for approach error as long as it is not in the model.
    """
    whole = open_scan(bank, noise, problem.y, problem.A)
    obvious, clean = _obvious(whole)
    kept = likely(whole, by_way) | likely(clean, by_way)
    # none may be the likeliest once everything that is missing is in the model
    kept |= np.array([layer.sharing.ratio == 0 for layer in whole.layers])
    return _Look(at_sharings(whole, kept), obvious, at_sharings(clean, kept))


def _sharing_none(scan: Scan) -> float:
    """p-value that a pose's rows share no error: half of χ² for each way, as the ratio cannot be negative."""
    value = scan.log_likelihood
    alone = next(v for v, layer in zip(value, scan.layers, strict=True) if layer.sharing.ratio == 0.0)
    ways = len({layer.sharing.way for layer in scan.layers if layer.sharing.ratio > 0})
    if np.max(value) == alone:
        return 1.0
    return min(1.0, float(0.5 * ways * chdtrc(1, 2.0 * (np.max(value) - alone))))


def _obvious(scan: Scan) -> tuple[tuple[int, ...], Scan]:
    """The few candidates that stand out beyond doubt, named or not, each in its best shape beside those before it, and
    the scan with them in the model."""
    entries: tuple[int, ...] = ()
    clean = scan
    for _ in range(_MOST):
        found = evidence(clean)
        score = np.array(found.score)
        score[scan.bank.owner[list(entries)]] = -np.inf
        if not len(score) or score.max() < _STANDS_OUT:
            break
        entries = (*entries, int(found.best_entry[int(np.argmax(score))]))
        clean = extend(scan, entries)
    return entries, clean


def _data_residual(scan: Scan) -> Array:
    """(M,) at the likeliest sharing."""
    layer = scan.best
    return np.asarray(scan.noise.apply(layer.colour, layer.y[:, None])[:, 0] * scan.noise.spread)


def _within_residual(scan: Scan) -> Array:
    """Residual whitened of the shared error, data's unit."""
    layer = scan.best
    return np.asarray(layer.y * scan.noise.spread)


def _first_split(problem: Problem) -> Split:
    """How a shared error looks split before anything else is known of the noise."""
    if not several_markers(problem) and not repeated(problem):
        return Split()
    spread = noises.stated(problem)
    basis = column_space(problem.A / spread[:, None])
    y = problem.y / spread
    left = y - basis @ (basis.T @ y)
    anew = _anew_share(problem, left)
    return Split(_own_share(problem, left, anew, of_axes(problem, left) > 0), anew)


def _split(problem: Problem, seen: _Look) -> Split:
    clean = seen.clean
    z = _data_residual(clean) / clean.noise.spread
    anew = _anew_share(problem, z)
    reading = shaken(problem, z, clean.noise.spread, approaches(problem, anew))
    own = _own_share(problem, z, anew, bool(reading))
    ratio = clean.best.sharing.ratio
    if ratio == 0.0 or all(layer.sharing.way != JOINTS for layer in clean.layers):
        return Split(own, anew, reading)
    left = (clean, _with_one_more(seen))
    learned = {way: _sizes(problem, scan, anew, reading) for way, scan in zip(LEARNED, left, strict=True)}
    return Split(own, anew, reading, {way: found for way, found in learned.items() if max(found) > RATIOS[0]})


def _sizes(problem: Problem, scan: Scan, anew: float, reading: Shaken) -> tuple[float, ...]:
    """What was learned of a pose's errors from what a scan leaves."""
    best, scale2 = scan.best, scan.best.rss / max(scan.freedom, 1)
    label = approaches(problem, anew)
    residual, spread = _data_residual(scan), scan.noise.spread
    return sizes(problem, residual, spread, scale2, best.sharing.ratio, label, reading)


def _with_one_more(seen: _Look) -> Scan:
    """What is left after the effect of the catalogue that has most evidence, however little."""
    found = evidence(seen.clean)
    score = np.where(seen.scan.bank.generic, -np.inf, found.score)
    best = int(np.argmax(score)) if len(score) else -1
    if best < 0 or not np.isfinite(score[best]):
        return seen.clean
    return extend(seen.scan, (*seen.obvious, int(found.best_entry[best])))


def _anew_share(problem: Problem, z: Array) -> float:
    """Part of the shared error that each repeat of a pose has for itself, by moments of the residual (M,) in a pose.

    Where a repeat has several loads the rows of one reading, which may share something else too, do not count.
    """
    if not repeated(problem):
        return 0.0
    each, whole = products(z, repeats(problem)), products(z, problem.lines)
    other_loads = _less(each, products(z, readings(problem)))
    return _alone(other_loads if other_loads[1] > 0 else each, _less(whole, each))


def _own_share(problem: Problem, z: Array, anew: float, by_reading: bool) -> float:
    """Part of the shared error that each marker has for itself, by moments of the residual (M,) within a pose."""
    if not several_markers(problem):
        return 0.0
    label = approaches(problem, anew)
    each, whole = (products(z, numbered(label, part)) for part in (problem.channel, problem.axis))
    others = _less(whole, each)
    return _alone(each, _less(others, products(z, readings(problem))) if by_reading else others)


def _less(pairs: Pairs, some: Pairs) -> Pairs:
    return pairs[0] - some[0], pairs[1] - some[1]


def _alone(each: Pairs, whole: Pairs) -> float:
    """Part of the error of pairs of rows that share ``each`` which those that share the ``whole`` alone do not have."""
    common, alone = (total / max(count, 1.0) for total, count in (whole, each))
    return float(np.clip(1.0 - common / max(alone, 1e-12), 0.0, 1.0))
