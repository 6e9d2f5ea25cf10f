"""The proof: prediction of poses that were left out, with the selection made again inside every fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.discrepancy.bank import Bank
from symstiff.discrepancy.noise import Noise
from symstiff.discrepancy.problem import Array, Index, Options, Problem
from symstiff.discrepancy.scan import evidence, extend, open_scan
from symstiff.discrepancy.sharing import Roots

NO_GAP = 0.05
"""Gap, as a share of the noise, below which no share of it is told."""
AGAIN = 0.5
"""Share of the folds that have to select what was named, where what they select does not predict."""


@dataclass(frozen=True)
class HeldOut:
    """Root mean squares over the rows of left-out poses, in the data's unit."""

    before: float
    after: float
    """With what each fold selected for itself."""
    fixed: float
    """With the effects named on all data, coefficients from the fold."""
    noise: float
    selected: tuple[tuple[str, ...], ...]
    """What each fold selected."""
    again: float
    """Share of the folds that select one of the sets that all data admit."""

    @property
    def refutes(self) -> bool:
        """Whether most folds select something else, and that predicts the poses left out worse than nothing does."""
        return self.after > self.before and self.again < AGAIN

    @property
    def closure(self) -> float:
        """(before - after) / (before - noise); nan where there is no gap to close."""
        gap = self.before - self.noise
        return (self.before - self.after) / gap if gap > NO_GAP * self.noise else float("nan")


def held_out(
    problem: Problem, bank: Bank, noise: Noise, sigma: float, sets: Sequence[tuple[int, ...]], allowed: Array,
    options: Options,
) -> HeldOut | None:  # fmt: skip
    """K-fold by pose; None with fewer than four poses.

    ``sets`` are the entries that all data admit, best first. Every fold selects as many as the first has for itself,
    from the whole catalogue: how many is decided on all data, which ones and with what coefficients without the poses
    that are predicted.
    """
    poses = np.unique(problem.pose)
    if len(poses) < 4:
        return None
    few, entries = _named_only(bank), sets[0] if sets else ()
    # few poses leave little to learn from: more folds; many poses make every fold dear
    folds = min(options.folds, len(poses)) if len(poses) <= 20 else min(options.folds, 5)
    number = np.searchsorted(poses, problem.pose)
    order = np.random.default_rng(options.seed).permutation(len(poses))
    fold = order[number] % folds
    translation = problem.axis < 3 if np.any(problem.axis < 3) else np.ones(problem.rows, bool)
    error = {name: np.zeros(problem.rows) for name in ("before", "after", "fixed")}
    selected = []
    for k in range(folds):
        train, test = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        chosen = _select(problem, few, noise, train, allowed, len(entries))
        selected.append(tuple(few.candidates[int(few.owner[e])].key for e in chosen))
        for name, used in (("before", ()), ("after", chosen), ("fixed", entries)):
            error[name][test] = _predict(problem, bank, noise, train, test, used)
    rms = {name: float(np.sqrt(np.mean(e[translation] ** 2))) for name, e in error.items()}
    admitted = [sorted(few.candidates[int(few.owner[e])].key for e in found) for found in sets or [()]]
    again = float(np.mean([sorted(fold) in admitted for fold in selected]))
    return HeldOut(rms["before"], rms["after"], rms["fixed"], sigma, tuple(selected), again)


def _named_only(bank: Bank) -> Bank:
    """The bank without the unnamed laws, which stand at its end: entry and column numbers stay the same."""
    entries = int(np.sum(~bank.generic[bank.owner]))
    columns = int(np.sum(bank.width[:entries]))
    return replace(
        bank, columns=bank.columns[:, :columns], scale=bank.scale[:columns], start=bank.start[:entries],
        width=bank.width[:entries], owner=bank.owner[:entries], shape=bank.shape[:entries],
        candidates=bank.candidates[: int(np.sum(~bank.generic))], generic=bank.generic[~bank.generic],
        usual=bank.usual[:columns], sized=bank.sized[:entries], share=bank.share[:entries],
        log_prior=bank.log_prior[~bank.generic],
        place=bank.place[: int(np.sum(~bank.generic))],
    )  # fmt: skip


def _rows(noise: Noise, rows: Index) -> Noise:
    """The noise of some rows (whole poses)."""
    place = np.full(len(noise.spread), -1)
    place[rows] = np.arange(len(rows))
    ways = {way: _inside(place, batches) for way, batches in noise.ways.items()}
    return replace(noise, spread=noise.spread[rows], ways=ways)


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
) -> tuple[int, ...]:
    """Forward selection of some of the named candidates on some rows."""
    if count == 0:
        return ()
    part = replace(bank, columns=bank.columns[rows])
    scan = open_scan(part, _rows(noise, rows), problem.y[rows], problem.A[rows])
    mask = np.array(allowed, dtype=bool)[: len(bank.candidates)]
    chosen: tuple[int, ...] = ()
    for _ in range(count):
        found = evidence(scan)
        score = np.where(mask, found.score, -np.inf)
        best = int(np.argmax(score)) if len(score) else -1
        if best < 0 or not np.isfinite(score[best]):
            break
        entry = int(found.best_entry[best])
        chosen = (*chosen, entry)
        mask[best] = False
        scan = extend(scan, (entry,))
    return chosen


def _predict(
    problem: Problem, bank: Bank, noise: Noise, train: Index, test: Index, entries: tuple[int, ...]
) -> Array:
    """Prediction error on left-out rows (n,)."""
    X = np.hstack([problem.A, *(bank.columns[:, bank.slice(e)] for e in entries)])
    inner = _rows(noise, train)
    root = inner.root(noise.sharings[0], -0.5)
    W = inner.apply(root, np.column_stack([problem.y[train], X[train]]) / inner.spread[:, None])
    length = np.linalg.norm(W[:, 1:], axis=0)
    length[length == 0] = 1.0
    U, s, Vt = np.linalg.svd(W[:, 1:] / length, full_matrices=False)
    keep = s > 1e-9 * s[0]
    U, s, Vt = U[:, keep], s[keep], Vt[keep]
    inner_y = U.T @ W[:, 0]
    noise2 = (float(W[:, 0] @ W[:, 0]) - float(inner_y @ inner_y)) / max(len(train) - len(s), 1)
    # directions that the training poses hardly determine are drawn to zero as far as their noise demands:
    # columns of unit length have coefficients of the order of the signal shared among them
    expected2 = max(float(inner_y @ inner_y) / len(s), 1e-300)
    beta = Vt.T @ (inner_y * s / (s**2 + max(noise2, 0.0) / expected2)) / length
    return np.asarray(problem.y[test] - X[test] @ beta)
