"""From detection and judged sets to one of the verdicts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logsumexp

from symstiff.discrepancy.problem import Array, Options
from symstiff.discrepancy.scan import Evidence, Null, Scan, critical
from symstiff.discrepancy.search import Accepted, Judged, detection, grow, judge, polish, root

NOTHING, NAMED, AMBIGUOUS = "nothing_missing", "named", "ambiguous"
INSUFFICIENT, UNEXPLAINED, UNTESTABLE = "named_insufficient", "unexplained", "untestable"


@dataclass(frozen=True)
class Outcome:
    """The verdict before it is written out."""

    verdict: str
    reason: str
    null: Null
    found: Evidence
    p_named: float
    p_unnamed: float
    chosen: Judged | None
    """The named set, or the leader."""
    admissible: tuple[Judged, ...]
    """All sets that the data allow, best first."""
    confidence: tuple[float, ...]
    """Of each member of the chosen set."""
    tried: tuple[Judged, ...]


Plausible = Callable[[Accepted], bool]


def decide(
    start: Scan, allowed: Array, options: Options, plausible: Plausible, strata_p: float,
    progress: Callable[[str], None],
) -> Outcome:  # fmt: skip
    """Detect, then try sets of one, two and three effects until one is sufficient."""
    distribution, found, p_named, p_unnamed = detection(start, allowed, options)
    seen = p_named < options.alpha
    odd = p_unnamed < options.alpha_strata or strata_p < options.alpha_strata
    if not seen and not odd:
        return Outcome(NOTHING, "no test rejects", distribution, found, p_named, p_unnamed, None, (), (), ())
    tried: list[Judged] = []
    if seen:
        pool = [root(start)]
        for size in range(1, options.max_effects + 1):
            progress(f"sets of {size}")
            sets = _sets(start, pool, allowed, options, plausible)
            judged = [
                judge(start, m, allowed, options, options.seed + 100 * size + i) for i, m in enumerate(sets[:4])
            ]
            tried += judged
            good = [j for j in judged if _admissible(j, options)]
            if good:
                return _named(good, sets, distribution, found, p_named, p_unnamed, options, tuple(tried))
            if not sets:
                break
            pool = sets[:10]
    return _not_named(tried, distribution, found, p_named, p_unnamed, options)


def _sets(
    start: Scan, pool: list[Accepted], allowed: Array, options: Options, plausible: Plausible
) -> list[Accepted]:
    """Sets with one more member, best first: the leading extensions of every set in the pool."""
    bank = start.bank
    made: dict[frozenset[int], Accepted] = {}
    breadth = 12 if not pool[0].members else 3
    for base in pool:
        score = np.where(allowed.astype(bool) & ~bank.generic, base.evidence.score, -np.inf)
        score[list(base.members)] = -np.inf
        order = np.argsort(score)[::-1][:breadth]
        for candidate in order:
            key = frozenset((*base.members, int(candidate)))
            if score[candidate] < score[order[0]] - 14.0 or key in made or not np.isfinite(score[candidate]):
                continue
            model = grow(base, int(candidate))
            if plausible(model):
                made[key] = model
    ranked = sorted(made.values(), key=lambda m: -m.score)
    best = [polish(start, m) for m in ranked[:4]]
    return sorted([*best, *ranked[4:]], key=lambda m: -m.score)


def _admissible(judged: Judged, options: Options) -> bool:
    return judged.sufficient and max(judged.p_members) < options.alpha and judged.rival < 0.0


def _named(
    good: list[Judged], sets: list[Accepted], distribution: Null, found: Evidence,
    p_named: float, p_unnamed: float, options: Options, tried: tuple[Judged, ...],
) -> Outcome:  # fmt: skip
    good = sorted(good, key=lambda j: -j.model.score)
    accepted = {j.model.members for j in good}
    judged = {j.model.members for j in tried}
    # sets that were not judged (they trail) keep their weight; judged and refused ones lose it
    rest = [s for s in sets if s.members in accepted or s.members not in judged]
    total = logsumexp([s.score for s in rest])
    share = {s.members: float(np.exp(s.score - total)) for s in rest}
    leader = good[0]
    confidence = tuple(
        _calibrated(sum(w for members, w in share.items() if m in members), leader) for m in leader.model.members
    )
    verdict = NAMED if share[leader.model.members] >= options.name_at else AMBIGUOUS
    kept = tuple(j for j in good if share[j.model.members] > 0.05 * share[leader.model.members])
    if verdict == AMBIGUOUS and len(kept) < 2:
        verdict = NAMED
    reason = "sufficient, plausible and ahead" if verdict == NAMED else "several sets account for the data"
    return Outcome(verdict, reason, distribution, found, p_named, p_unnamed, leader, kept, confidence, tried)


def _calibrated(share: float, leader: Judged) -> float:
    """Posterior share, lowered by the best rival without a name, on the benchmark's scale."""
    share = float(np.clip(share, 1e-6, 1 - 1e-6))
    raw = np.log(share / (1 - share))
    rival = np.log1p(np.exp(min(leader.rival, 30.0)))
    return float(expit(CALIBRATION[0] + CALIBRATION[1] * min(raw, 8.0) - rival))


CALIBRATION = (0.0, 0.8)
"""Offset and slope of the logit, fitted on simulated benchmarks."""


def _not_named(
    tried: list[Judged], distribution: Null, found: Evidence, p_named: float, p_unnamed: float, options: Options
) -> Outcome:
    needed = [j for j in tried if max(j.p_members) < options.alpha]
    best = max(needed, key=lambda j: j.model.score, default=None)
    if best is not None and best.rival < -3.0 and best.missed_share < 0.3:
        return Outcome(
            INSUFFICIENT, "the leader explains most, but not all", distribution, found, p_named, p_unnamed,
            best, (best,), tuple(0.5 for _ in best.model.members), tuple(tried),
        )  # fmt: skip
    return Outcome(
        UNEXPLAINED, "no set of the catalogue accounts for the data", distribution, found, p_named, p_unnamed,
        best, (), (), tuple(tried),
    )  # fmt: skip


def threshold(outcome: Outcome, options: Options) -> float:
    """Score that a candidate must exceed to be detected."""
    return critical(outcome.null.named, options.alpha)
