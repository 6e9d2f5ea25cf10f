"""Which set of effects, if any, accounts for the data: sets of one, then two, then three, each held to sufficiency."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from symstiff.discrepancy.bank import Bank
from symstiff.discrepancy.problem import Array, Options
from symstiff.discrepancy.scan import Evidence, Null, Scan, evidence, explained, extend, null

PAIR_PRIOR = 0.1
"""Prior weight of one more effect against none more."""


@dataclass(frozen=True)
class Accepted:
    """A set of candidates with the columns that were added for it."""

    members: tuple[int, ...]
    """Candidates."""
    entries: tuple[int, ...]
    scan: Scan
    """With the entries in the model."""
    evidence: Evidence
    """Of what could still be added."""
    score: float
    """Log evidence of the set with prior."""
    explained: float
    """Sum of squares explained, in units of the noise variance left."""


@dataclass(frozen=True)
class Judged:
    """A set with its tests."""

    model: Accepted
    p_left_named: float
    p_left_unnamed: float
    missed_share: float
    rival: float
    """Log evidence of the best rival without a name, minus this set's."""
    rival_candidate: int
    sufficient: bool
    p_members: tuple[float, ...]
    """Family-wise p-value of each member given the others."""


def root(scan: Scan) -> Accepted:
    """The empty set."""
    return Accepted((), (), scan, evidence(scan), 0.0, 0.0)


def grow(model: Accepted, candidate: int) -> Accepted:
    """The set with one more candidate at its best shape."""
    entry = int(model.evidence.best_entry[candidate])
    scan = extend(model.scan, (entry,))
    scale2 = scan.best.rss / max(scan.freedom, 1)
    return Accepted(
        (*model.members, candidate),
        (*model.entries, entry),
        scan,
        evidence(scan),
        model.score + float(model.evidence.score[candidate]) + (np.log(PAIR_PRIOR) if model.members else 0.0),
        model.explained + (model.scan.best.rss - scan.best.rss) / max(scale2, 1e-300),
    )


def polish(start: Scan, model: Accepted) -> Accepted:
    """Choose each member's shape again, given the others."""
    if len(model.members) < 2:
        return model
    built = root(start)
    entries = list(model.entries)
    for place, member in enumerate(model.members):
        others = tuple(e for i, e in enumerate(entries) if i != place)
        entries[place] = int(evidence(extend(start, others)).best_entry[member])
    for member, entry in zip(model.members, entries, strict=True):
        best = np.array(built.evidence.best_entry)
        best[member] = entry
        built = grow(replace(built, evidence=replace(built.evidence, best_entry=best)), member)
    return built if built.explained > model.explained else model


def judge(start: Scan, model: Accepted, allowed: Array, options: Options, seed: int) -> Judged:
    """Is the set sufficient, and is each member needed?"""
    bank = model.scan.bank
    free = _free(bank, model.members, allowed)
    distribution = null(model.scan, options.draws, seed, free)
    score = np.where(free, model.evidence.score, -np.inf)
    p_named = distribution.p_named(_top(score, ~bank.generic))
    p_unnamed = distribution.p_generic(_top(score, bank.generic))
    missed = _missed_share(model, free)
    rival, who = _rival(start, model, allowed)
    lack = min(p_named, p_unnamed) < options.alpha_sufficient
    enough = (not lack) or missed < options.tolerated_share
    p_members = tuple(
        _needed(start, model, i, allowed, options, seed + 1 + i) for i in range(len(model.members))
    )
    return Judged(model, p_named, p_unnamed, missed, rival, who, enough, p_members)


def _free(bank: Bank, members: tuple[int, ...], allowed: Array) -> Array:
    free = allowed.astype(bool).copy()
    free[list(members)] = False
    return free


def _top(score: Array, mask: Array) -> float:
    return float(np.max(score[mask])) if np.any(mask) else -np.inf


def _missed_share(model: Accepted, free: Array) -> float:
    """Share of the explainable signal that the set leaves to the best further candidate, noise deducted."""
    bank = model.scan.bank
    layer_number = int(np.argmax(model.scan.log_likelihood))
    squares = explained(model.scan)[layer_number]
    scale2 = model.scan.best.rss / max(model.scan.freedom, 1)
    usable = free[bank.owner]
    if not np.any(usable):
        return 0.0
    further = float(np.max(np.where(usable, squares / scale2 - model.scan.best.rank, 0.0)))
    return further / max(further + model.explained, 1e-300)


def _rival(start: Scan, model: Accepted, allowed: Array) -> tuple[float, int]:
    """The best set in which an unnamed law of another form takes the place of one member."""
    bank = model.scan.bank
    best, who = -np.inf, -1
    for place in range(len(model.members)):
        others = tuple(e for i, e in enumerate(model.entries) if i != place)
        reduced = extend(start, others)
        found = evidence(reduced)
        gain = float(found.score[model.members[place]])
        score = np.where(bank.generic & allowed.astype(bool), found.score, -np.inf)
        for candidate in np.argsort(score)[::-1][:8]:
            if not np.isfinite(score[candidate]) or score[candidate] - gain < best:
                break
            if _overlap(reduced, int(found.best_entry[candidate]), model.entries[place]) < 0.85:
                best, who = float(score[candidate]) - gain, int(candidate)
                break
    return best, who


def _overlap(scan: Scan, first: int, second: int) -> float:
    """Share of the first entry's fitted signal that lies in the second's space."""
    layer, bank = scan.best, scan.bank
    a, b = layer.Q[:, bank.slice(first)], layer.Q[:, bank.slice(second)]
    signal = a @ (a.T @ layer.y)
    return float(np.sum((b.T @ signal) ** 2) / max(signal @ signal, 1e-300))


def _needed(start: Scan, model: Accepted, place: int, allowed: Array, options: Options, seed: int) -> float:
    others = tuple(e for i, e in enumerate(model.entries) if i != place)
    scan = extend(start, others)
    free = _free(model.scan.bank, tuple(m for i, m in enumerate(model.members) if i != place), allowed)
    score = float(evidence(scan).score[model.members[place]])
    return null(scan, options.draws, seed, free).p_named(score)


def weights(models: list[Accepted]) -> Array:
    """Posterior weights of competing sets."""
    score = np.array([m.score for m in models])
    return np.asarray(np.exp(score - logsumexp(score)))


def detection(start: Scan, allowed: Array, options: Options) -> tuple[Null, Evidence, float, float]:
    """Null distribution, evidence, and the family-wise p-values of the catalogue and of the unnamed laws."""
    bank = start.bank
    free = allowed.astype(bool)
    distribution = null(start, 2 * options.draws, options.seed, free)
    found = evidence(start)
    score = np.where(free, found.score, -np.inf)
    return (
        distribution,
        found,
        distribution.p_named(_top(score, ~bank.generic)),
        distribution.p_generic(_top(score, bank.generic)),
    )
