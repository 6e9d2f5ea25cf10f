"""The proof: prediction of poses that were left out, with the selection made again inside every fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.arrays import TINY, Array, Index, Mask
from symstiff.calibration.fits.decomposition import RANK
from symstiff.discrepancy.noise.blocks import Roots
from symstiff.discrepancy.noise.scales import Noise
from symstiff.discrepancy.problem import Options, Problem
from symstiff.discrepancy.statistics.bank import Bank
from symstiff.discrepancy.statistics.between import moved
from symstiff.discrepancy.statistics.evidence import Evidence, evidence
from symstiff.discrepancy.statistics.scan import Scan, extend, open_scan
from symstiff.reduction.svd import svd

FEWEST = 4
"""Poses from which some are left out."""
_MANY, _FOLDS = 20, 5
"""Poses from which on fewer folds do, and how many."""
_STARTS = 3
"""First members, at most, that a fold goes on from where it selects several: the likeliest alone may pass for two."""
NO_GAP = 0.05
"""Gap, as a share of the noise, below which no share of it is told."""
_BETTER = 0.95
"""Part of what predicts left-out poses from which a member of a set is spoken against: an effect of a size that is seen
has more than 1 there."""
AGAIN = 0.5
"""Share of the folds that have to select what was named, where what they select does not predict."""


@dataclass(frozen=True)
class Without:
    """What a set predicts without one of its members, shapes as all data have them, rows weighed by the noise found."""

    ratio: float
    """Root mean square without it over that with all members."""
    deviations: float
    """What the squares of a pose grow by without it, in standard deviations of that mean over the poses."""


@dataclass(frozen=True)
class HeldOut:
    """Root mean squares over the rows of left-out poses, in the data's unit.

    Poses that have an effect of their own (a marker that slipped) are not among them: no other pose can predict it.
    """

    before: float
    after: float
    """With what each fold selected for itself. Both as well as they can be: rows are weighed by the noise that was
    found, or by their own noise alone."""
    alike: tuple[float, float]
    """Before and after, rows weighed by the noise that was found."""
    noise: float
    selected: tuple[tuple[str, ...], ...]
    """What each fold selected."""
    again: float
    """Share of the folds that select one of the sets that all data admit."""
    without: tuple[Without, ...] = ()
    """Of each of several members of the first set."""

    @property
    def spoken_against(self) -> tuple[bool, ...]:
        """Of each member of the first set whether the poses that were left out are clearly better predicted without."""
        return tuple(w.ratio < _BETTER and w.deviations < -1.0 for w in self.without)

    @property
    def refutes(self) -> bool:
        """Whether most folds select something else, and that predicts the poses left out worse than nothing does."""
        return self.alike[1] > self.alike[0] and self.again < AGAIN

    @property
    def closure(self) -> float:
        """Share of the gap that was closed; nan where there is none."""
        return closed(self.before, self.after, self.noise)


def closed(before: float, after: float, noise: float) -> float:
    """(before - after) / (before - noise), root mean squares; nan where there is no gap to close."""
    gap = before - noise
    return (before - after) / gap if gap > NO_GAP * noise else float("nan")


def held_out(
    problem: Problem, bank: Bank, noise: Noise, sigma: float, sets: Sequence[tuple[int, ...]], allowed: Array,
    options: Options,
) -> HeldOut | None:  # fmt: skip
    """K-fold by pose; None with fewer than four poses.

    ``sets`` are the entries that all data admit, best first. Every fold selects as many as the first has for itself,
    from the whole catalogue: how many is decided on all data, which ones and with what coefficients without the poses
    that are predicted.
    """
    poses = problem.poses
    if poses < FEWEST:
        return None
    few, entries = _profile(bank), sets[0] if sets else ()
    # few poses leave little to learn from: more folds; many poses make every fold dear
    folds = min(options.folds, poses) if poses <= _MANY else min(options.folds, _FOLDS)
    fold = np.random.default_rng(options.seed).permutation(poses)[problem.place] % folds
    alone = replace(noise, sharings=(replace(noise.sharings[0], ratio=0.0),))
    # weighed by the noise found, and by the rows' own; before and after
    error = np.zeros((2, 2, problem.rows))
    admitted = sets or [()]
    selected, again = [], []
    for k in range(folds):
        train, test = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        there = [[e for e in found if np.any(bank.columns[train, bank.slice(e)])] for found in admitted]
        names, chosen = _select(problem, few, noise, train, allowed, len(there[0]))
        selected.append(names)
        again.append(sorted(names) in [_names(bank, found) for found in there])
        for way, weights in enumerate((noise, alone)):
            for when, used in enumerate(((), chosen)):
                error[way, when, test] = _predict(problem, weights, train, test, used)
    told = problem.main & ~np.isin(problem.pose, poses_of_their_own(problem, bank, entries))
    rms = np.sqrt(np.mean(error[:, :, told] ** 2, axis=2))
    before, after = (float(x) for x in rms.min(axis=0))
    alike = (float(rms[0, 0]), float(rms[0, 1]))
    members = _without_each(problem, bank, noise, fold, entries, told) if len(entries) > 1 else ()
    return HeldOut(before, after, alike, sigma, tuple(selected), float(np.mean(again)), members)


def _without_each(
    problem: Problem, bank: Bank, noise: Noise, fold: Index, entries: tuple[int, ...], told: Mask
) -> tuple[Without, ...]:
    """What left-out rows say of each entry."""
    sets = [entries, *(tuple(e for e in entries if e != member) for member in entries)]
    error = np.zeros((len(sets), problem.rows))
    for k in np.unique(fold):
        train, test = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        for n, used in enumerate(sets):
            blocks = [bank.columns[:, bank.slice(e)] for e in used]
            error[n, test] = _predict(problem, noise, train, test, blocks)
    # a pose counts by its squares
    square = np.stack([np.bincount(problem.place[told], x[told] ** 2) for x in error])
    square = square[:, np.bincount(problem.place[told]) > 0]
    return tuple(_compared(square[0], less) for less in square[1:])


def _compared(whole: Array, less: Array) -> Without:
    """By the squares (P,) of the poses with all members, and without one."""
    ratio = float(np.sqrt(less.sum() / max(float(whole.sum()), TINY)))
    more = less - whole
    spread = float(np.std(more, ddof=1)) * np.sqrt(len(more)) if len(more) > 1 else 0.0
    return Without(ratio, float(more.sum()) / max(spread, TINY))


def _names(bank: Bank, entries: Sequence[int]) -> list[str]:
    return sorted(bank.candidates[int(bank.owner[e])].key for e in entries)


def poses_of_their_own(problem: Problem, bank: Bank, entries: Sequence[int]) -> list[int]:
    """The poses of effects that are in one pose alone: no other pose can tell them."""
    touched = [np.unique(problem.pose[np.any(bank.columns[:, bank.slice(e)], axis=1)]) for e in entries]
    return [int(poses[0]) for poses in touched if len(poses) == 1]


def _profile(bank: Bank) -> Bank:
    """The bank without unnamed laws, which stand at its end, and without shapes that all data have moved."""
    named = int(np.sum(~bank.generic))
    profiled = np.array([c.profiled for c in bank.candidates])
    kept = np.flatnonzero((bank.owner < named) & (bank.shape < profiled[bank.owner]))
    own = bank.columns_of(kept)
    width, owner = bank.width[kept], bank.owner[kept]
    whole = np.bincount(owner, bank.share[kept], named)
    return replace(
        bank, candidates=bank.candidates[:named], generic=bank.generic[:named], log_prior=bank.log_prior[:named],
        place=bank.place[:named], columns=bank.columns[:, own], scale=bank.scale[own], usual=bank.usual[own],
        start=np.cumsum(width) - width, width=width, owner=owner, shape=bank.shape[kept], sized=bank.sized[kept],
        share=bank.share[kept] / whole[owner],
    )  # fmt: skip


def _rows(noise: Noise, rows: Index) -> Noise:
    """The noise of some rows (whole poses)."""
    place = np.full(len(noise.spread), -1)
    place[rows] = np.arange(len(rows))
    ways = {way: _inside(place, batches) for way, batches in noise.ways.items()}
    return replace(noise, spread=noise.spread[rows], ways=ways, reading=_inside(place, noise.reading))


def _inside(place: Index, batches: Roots) -> Roots:
    """The blocks of rows that have a new place."""
    out = []
    for index, U, value in batches:
        inside = place[index[:, 0]] >= 0
        if np.any(inside):
            out.append((place[index[inside]].astype(np.intp), U[inside], value[inside]))
    return tuple(out)


def _select(
    problem: Problem, bank: Bank, noise: Noise, rows: Index, allowed: Array, count: int
) -> tuple[tuple[str, ...], list[Array]]:
    """Selection of some of the named candidates on some rows: their keys, and the columns (M, k) of each."""
    if count == 0:
        return (), []
    part = replace(bank, columns=bank.columns[rows])
    scan = open_scan(part, _rows(noise, rows), problem.y[rows], problem.A[rows])
    mask = np.array(allowed, dtype=bool)[: len(bank.candidates)]
    found = evidence(scan)
    score = np.where(mask, found.score, -np.inf)
    firsts = [int(k) for k in np.argsort(score)[::-1][: _STARTS if count > 1 else 1] if np.isfinite(score[k])]
    paths = (_forward(scan, found, first, mask, count) for first in firsts)
    path = max(paths, key=lambda p: p[0], default=(0.0, []))[1]
    blocks = []
    for before, entry in path:
        shape, candidate = moved(before, (), entry, rows), bank.candidates[int(bank.owner[entry])]
        blocks.append(bank.columns[:, bank.slice(entry)] if shape is None else candidate.columns(shape))
    return tuple(bank.candidates[int(bank.owner[entry])].key for _, entry in path), blocks


def _forward(
    opening: Scan, found: Evidence, first: int, mask: Array, count: int
) -> tuple[float, list[tuple[Scan, int]]]:
    """Forward selection from a first candidate on: the score of all, and each one's entry with the scan before it."""
    scan, path = opening, list[tuple[Scan, int]]()
    total, best, free = 0.0, first, mask.copy()
    while True:
        path.append((scan, int(found.best_entry[best])))
        total, free[best] = total + float(found.score[best]), False
        if len(path) == count:
            return total, path
        scan = extend(opening, tuple(entry for _, entry in path))
        found = evidence(scan)
        score = np.where(free, found.score, -np.inf)
        best = int(np.argmax(score))
        if not np.isfinite(score[best]):
            return total, path


def _predict(problem: Problem, noise: Noise, train: Index, test: Index, blocks: Sequence[Array]) -> Array:
    """Prediction error on left-out rows (n,), with the model and further columns (M, k) fitted on the others."""
    X = np.hstack([problem.A, *blocks])
    inner = _rows(noise, train)
    root = inner.root(noise.sharings[0], -0.5)
    W = inner.apply(root, np.column_stack([problem.y[train], X[train]]) / inner.spread[:, None])
    # of all poses: what the training poses hardly show is small beside what it is elsewhere
    length = np.linalg.norm(X / noise.spread[:, None], axis=0)
    length[length == 0] = 1.0
    U, s, Vt = svd(W[:, 1:] / length)
    keep = s > RANK * s.max(initial=0.0)
    U, s, Vt = U[:, keep], s[keep], Vt[keep]
    inner_y = U.T @ W[:, 0]
    noise2 = (float(W[:, 0] @ W[:, 0]) - float(inner_y @ inner_y)) / max(len(train) - len(s), 1)
    # directions that the training poses hardly determine are drawn to zero as far as their noise demands:
    # columns of unit length have coefficients of the order of the signal shared among them
    expected2 = max(float(inner_y @ inner_y) / max(len(s), 1), TINY)
    beta = Vt.T @ (inner_y * s / (s**2 + max(noise2, 0.0) / expected2)) / length
    return np.asarray(problem.y[test] - X[test] @ beta)
