"""From detection and judged sets to one of the verdicts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from scipy.special import expit

from symstiff.arrays import Array
from symstiff.discrepancy.problem import Options
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.search.judging import Judged, judge
from symstiff.discrepancy.search.proposals import (
    LEADING,
    Beyond,
    in_range,
    of_two,
    polish,
    proposals,
    ranked,
    together,
)
from symstiff.discrepancy.search.rivals import AS_MUCH
from symstiff.discrepancy.search.shares import other_names, places, same_columns, shares
from symstiff.discrepancy.search.workshop import Proposal, Workshop
from symstiff.discrepancy.statistics.evidence import Evidence
from symstiff.discrepancy.statistics.null import Null
from symstiff.discrepancy.statistics.scan import Scan, directions
from symstiff.discrepancy.statistics.strata import Stratum

NOTHING, NAMED, AMBIGUOUS = "nothing_missing", "named", "ambiguous"
INSUFFICIENT, UNEXPLAINED, UNTESTABLE = "named_insufficient", "unexplained", "untestable"

CALIBRATION = (0.0, 0.7, 4.5)
"""Offset, slope and limit of the confidence's logit, fitted on simulated benchmarks."""

_BASES, _JUDGED, _EQUALS = 8, 4, 2
"""Sets of a size, at most: those that larger ones are made from, those that are judged, and the leader's with one
effect elsewhere. Each further one costs time."""
_TRAILS = 5.0
"""Log evidence by which a set may trail the first and still be judged: behind that it weighs less than a hundredth."""

CLOSE = 3.0
"""Log evidence by which a set that is refused may lead one that is not, for that one still to be spoken of."""

CLEARLY, CLEAR_SHARE = 10.0, 0.1
"""Log evidence by which two laws of one joint have to lead one that suffices; its share if they leave something too."""

FAINT, FOURFOLD = 3.0, float(np.log(4.0))
"""Log evidence up to which a set is hardly more believable than nothing, and by which it has to lead all laws without a
name together then: taken one by one, each of several hundred trails a little."""

PARTLY = 0.75
"""Confidence in what is there whatever else is, beside something that may have no name."""
EVEN = 0.5
"""Confidence, at most, in a set that does not suffice or that other poses speak against: an even bet."""
_MOSTLY = 0.3
"""Share of the signal that a leader may miss and still be said to explain most."""
_LISTED = 0.05
"""Share of the leader's evidence from which a rival set is listed beside it."""
_AT_BEST = 0.5
"""Share of the evidence by best shapes alone that a leader needs among sets at the same places."""
_WEAK = 5.0
"""Confidence that is lost with a member's p-value: one of 0.02 takes a tenth."""
_DOUBT, _FAR_BEHIND = 1e-6, 30.0
"""Least share of either side in a logit, and lead beyond which a rival leaves no confidence anyhow: both are finite."""

_SAME = 1e-6
"""Distance from other directions at which directions are the same."""
_ROUNDING = 1e-9
"""Difference of two scores that is none."""

Tests = tuple[Null, Evidence, float, float]
"""Of the start: null distribution, evidence, p-values of the catalogue and of laws without a name."""


@dataclass(frozen=True)
class Outcome:
    """The verdict before it is written out."""

    verdict: str
    because: Reason
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


def decide(
    start: Scan, allowed: Array, options: Options, beyond: Beyond, parts: Sequence[Stratum],
    progress: Callable[[str], None], given: Sequence[int] = (),
    lack: Callable[[Scan], Sequence[Stratum]] = lambda scan: (),
) -> Outcome:  # fmt: skip
    """Detect, then try sets of one, two and three effects until the leading set is sufficient.

    Candidates that are ``given`` and that the model does not absorb are members of every set that does not turn out to
    have no need of them; ``parts`` are the strata of the start, and ``lack`` tells those that a set leaves.
    """
    shop = Workshop(start, allowed, options, lack, parts)
    distribution = shop.null((), ())
    found = shop.evidence(())
    p_named = distribution.p_named(float(np.max(shop.score((), (), False), initial=-np.inf)))
    p_unnamed = distribution.p_generic(float(np.max(shop.score((), (), True), initial=-np.inf)))
    strata_p = min((s.p_value for s in parts if s.p_value is not None), default=1.0)
    if p_named >= options.alpha:
        p_named = min(p_named, _p_two(shop, beyond))
    seen = p_named < options.alpha
    tests = (distribution, found, p_named, p_unnamed)
    if not seen and min(p_unnamed, strata_p) >= options.alpha_strata:
        return Outcome(NOTHING, Reason(Why.NOTHING), *tests, None, (), (), ())
    if not seen and p_unnamed >= options.alpha_strata:
        return Outcome(UNEXPLAINED, Reason(Why.ONE_STRATUM), *tests, None, (), (), ())
    tried: list[Judged] = []
    weighed: list[Proposal] = []
    given = [member for member in given if np.isfinite(found.score[member])]
    base = together(shop, given)
    bases = [base]
    for size in range(max(len(given), 1), options.max_effects + 1 if seen else 1):
        progress(f"sets of {size}")
        sets = [base] if size == len(given) else ranked(shop, bases, beyond)
        if not sets:
            break
        weighed += sets
        judged = [judge(shop, p) for p in sets[:_JUDGED] if p.score > sets[0].score - _TRAILS]
        less = _without_idle(shop, judged[0], tried, beyond)
        if less is not None:
            judged = [less, *judged]
            weighed.append(less.proposal)
        tried += judged
        if _admissible(judged[0], options) and judged[0].score >= max(p.score for p in weighed) - _ROUNDING:
            if size < options.max_effects:
                progress(f"other sets of {size + 1}")
                others = _others(shop, judged[0], sets[1:_BASES], beyond)
                tried += others
                weighed += [j.proposal for j in others]
            break
        bases = sets[:_BASES]
    return _conclude(shop, tried, weighed, tests)


def _p_two(shop: Workshop, beyond: Beyond) -> float:
    """P-value of two effects that hide each other; 1 unless it is small and they are more believable than nothing."""
    score = of_two(shop, beyond)
    p = shop.null((), ()).p_two(score) if score > 0 else 1.0
    return p if p < shop.options.alpha_pair else 1.0


def _without_idle(shop: Workshop, judged: Judged, tried: Sequence[Judged], beyond: Beyond) -> Judged | None:
    """The set without the members that it does not need, the others at shapes chosen anew; None if that is none, or
    not a new one.
    """
    needed = [m for m, p in zip(judged.members, judged.p_members, strict=True) if p < shop.options.alpha]
    if not needed or len(needed) == len(judged.members):
        return None
    less = in_range(polish(shop, together(shop, needed)), beyond)
    if less is None or any(sorted(j.entries) == sorted(less.entries) for j in tried):
        return None
    return judge(shop, less)


def _others(shop: Workshop, leader: Judged, bases: list[Proposal], beyond: Beyond) -> list[Judged]:
    """Sets of one effect more that hold without the leading set: each accounts for the data in its own way.

    What would only join the leading set is what its sufficiency is about, other laws of its joints excepted, and blocks
    that together are the same columns are the same way. One law bends to most of two of the same joint, and two bend
    to one whose shape is not at hand: they have to explain clearly more, and to leave nothing unless it is much more.
    """
    but = same_columns(leader, shop.start.bank)
    found = [*_joined(shop, leader, beyond), *ranked(shop, bases, beyond, but)[:LEADING]]
    lead = [_lead_of(shop, p, leader) for p in found]
    close = (p for p, by in zip(found, lead, strict=True) if p.score > leader.score + by)
    others = (p for p in close if not _same_columns(shop.start, p, leader))
    judged = [judge(shop, p) for p in islice(others, _JUDGED)]
    good = [j for j in judged if _admissible(j, shop.options) and _earned(shop, j, leader)]
    best = max((j.score for j in good), default=-np.inf)
    return [*good, *_as_many(shop, leader, best, beyond)] if best > leader.score else good


def _lead_of(shop: Workshop, found: Proposal | Judged, leader: Judged) -> float:
    """Log evidence by which a set of one effect more has to lead: laws of one joint without a shape, as waves of other
    periods, bend to nothing else, and have to be more believable alone.
    """
    if not _of_same_joints(shop, found, leader):
        return -CLOSE
    bank, joints = shop.start.bank, Counter(shop.start.bank.place[m] for m in found.members)
    several = [m for m in found.members if bank.place[m] and joints[bank.place[m]] > 1]
    return CLOSE if all(len(bank.candidates[m].shapes) == 1 for m in several) else CLEARLY


def _as_many(shop: Workshop, leader: Judged, best: float, beyond: Beyond) -> list[Judged]:
    """The leading set and one effect elsewhere, where sets as large explain more than it: they are its equals."""
    near = (p for p in ranked(shop, [leader.proposal], beyond)[:LEADING] if p.score > best - CLOSE)
    elsewhere = (p for p in near if not _of_same_joints(shop, p, leader))
    judged = [judge(shop, p) for p in islice(elsewhere, _EQUALS)]
    return [j for j in judged if _admissible(j, shop.options)]


def _earned(shop: Workshop, judged: Judged, leader: Judged) -> bool:
    """Whether a set with further laws of the leading one's joints leaves nothing, or much less."""
    much = judged.score > (1.0 + CLEAR_SHARE) * leader.score
    by_itself = _lead_of(shop, judged, leader) < CLEARLY
    return much or by_itself or not _leaves_something(judged, shop.options)


def _joined(shop: Workshop, leader: Judged, beyond: Beyond) -> list[Proposal]:
    """The leading set and another law of one of its joints, where what it misses passes for a shape only close."""
    if not _leaves_something(leader, shop.options):
        return []
    place = shop.start.bank.place
    joints = {place[m] for m in leader.members} - {""}
    more = (polish(shop, p) for p in proposals(shop, [leader.proposal]) if place[p.members[-1]] in joints)
    return [kept for p in more if (kept := in_range(p, beyond)) is not None]


def _leaves_something(judged: Judged, options: Options) -> bool:
    """Whether a set that suffices leaves something that passes for a shape only close."""
    return min(judged.p_left_named, judged.p_left_unnamed) < options.alpha_sufficient


def _of_same_joints(shop: Workshop, found: Proposal | Judged, leader: Judged) -> bool:
    """Whether a set has more laws than another, and of the same joints alone."""
    place = shop.start.bank.place
    own, other = ([place[m] for m in members] for members in (found.members, leader.members))
    return len(own) > len(other) and set(own) == set(other) and own.count("") == other.count("")


def _same_columns(scan: Scan, one: Proposal, other: Judged) -> bool:
    """Whether two sets add the same directions to the model."""
    a, b = (directions(scan, scan.best, s.entries)[0] for s in (one, other))
    return a.shape == b.shape and bool(np.linalg.norm(a - b @ (b.T @ a)) < _SAME * np.sqrt(a.shape[1]))


def _admissible(judged: Judged, options: Options) -> bool:
    """Whether a set suffices, needs all of its members, and is ahead of the unnamed laws."""
    return judged.sufficient and _needs_all(judged, options) and _ahead(judged)


def _nearly(judged: Judged, options: Options) -> bool:
    """Whether a set is refused for a law without a name alone, and that explains no more than it."""
    enough = judged.sufficient and _needs_all(judged, options)
    return enough and not _ahead(judged) and judged.rivals.best < AS_MUCH


def _needs_all(judged: Judged, options: Options) -> bool:
    """Whether a set has need of each of its members."""
    return max(judged.p_members) < options.alpha


def _ahead(judged: Judged) -> bool:
    """Whether a set is ahead of every unnamed law, and of all together where it is faint."""
    return judged.rivals.best < 0 and (judged.score > FAINT or judged.rivals.together < -FOURFOLD)


def _conclude(shop: Workshop, tried: list[Judged], weighed: list[Proposal], tests: Tests) -> Outcome:
    """The verdict on the sets that were ``tried``, beside all that were ``weighed``."""
    options = shop.options
    good = sorted((j for j in tried if _admissible(j, options)), key=lambda j: -j.score)
    refused = max((j.score for j in tried if not _admissible(j, options)), default=-np.inf)
    fewer = _as_believable(good[0], tried, options) if good else None
    if fewer is not None:
        return _insufficient(fewer, Why.PARTLY, tried, tests)
    if good and good[0].score > refused - AS_MUCH:
        return _named(shop, good, tried, weighed, tests)
    if good and good[0].score > refused - CLOSE:
        return _insufficient(good[0], Why.AS_WELL, tried, tests)
    needed = [j for j in tried if _needs_all(j, options)]
    enough = max((j for j in needed if j.sufficient), key=lambda j: j.score, default=None)
    best = max(needed, key=lambda j: j.score, default=None)
    if best is not None and best.rivals.best < -CLOSE and _ahead(best) and best.missed_share < _MOSTLY:
        stopped = len(best.members) >= options.max_effects and best.p_left_named < options.alpha_further
        return _insufficient(best, Why.ENOUGH if stopped else Why.PARTLY, tried, tests)
    if enough is not None and enough.rivals.best < CLOSE:
        sure = _sure(shop, enough)
        if sure is not None:
            believed = tuple(PARTLY for _ in sure.members)
            return Outcome(INSUFFICIENT, Reason(Why.SURE), *tests, enough, (sure,), believed, tuple(tried))
        why = Why.FAINT if enough.rivals.best < -AS_MUCH else Why.NOT_ALONE
        return Outcome(UNEXPLAINED, Reason(why), *tests, enough, (), (), tuple(tried))
    return Outcome(UNEXPLAINED, Reason(Why.NO_SET), *tests, best, (), (), tuple(tried))


def _as_believable(leader: Judged, tried: list[Judged], options: Options) -> Judged | None:
    """A part of the leading set that is as believable as all of it: what it leaves is not worth an effect more."""
    parts = (j for j in tried if set(j.members) < set(leader.members) and j.score >= leader.score)
    whole = (j for j in parts if _needs_all(j, options) and _ahead(j))
    return max(whole, key=lambda j: j.score, default=None)


def _sure(shop: Workshop, judged: Judged) -> Judged | None:
    """Some of the members, whose place no unnamed law may take; None where these are all, or theory expects them."""
    sure = [m for m, c in zip(judged.members, judged.rivals.challenge, strict=True) if c < -CLOSE]
    if len(sure) == len(judged.members) or all(judged.bank.candidates[m].expected for m in sure):
        return None
    alone = judge(shop, together(shop, sure))
    return alone if _needs_all(alone, shop.options) else None


def _insufficient(leader: Judged, why: Why, tried: list[Judged], tests: Tests) -> Outcome:
    even = tuple(EVEN for _ in leader.members)
    return Outcome(INSUFFICIENT, Reason(why), *tests, leader, (leader,), even, tuple(tried))


def _named(
    shop: Workshop, good: list[Judged], tried: list[Judged], weighed: list[Proposal], tests: Tests
) -> Outcome:
    """The verdict where sets are admissible, ``good``, best first: the leader alone, or several.

    A leader alone that is hardly ahead of a law without a name explains no more than that, which is told.
    """
    leader, options = good[0], shop.options
    bank = leader.bank
    good = [*good, *sorted((j for j in tried if _nearly(j, options)), key=lambda j: -j.score)]
    accepted = {same_columns(j, bank) for j in good}
    judged = {same_columns(j, bank) for j in tried}
    # sets that were not judged (they trail) keep their weight; judged and refused ones lose it
    rest = [p for p in weighed if same_columns(p, bank) in accepted or same_columns(p, bank) not in judged]
    share = shares([(same_columns(p, bank), p.score) for p in rest])
    own = share[same_columns(leader, bank)]
    same_places = [p for p in rest if places(p, bank.place) == places(leader, bank.place)]
    at_best = shares([(same_columns(p, bank), p.score + _spared(p, tests[1])) for p in same_places])
    confidence = tuple(
        _calibrated(sum(w for members, w in share.items() if bank.twins(e)[0] in members), leader, p)
        for e, p in zip(leader.entries, leader.p_members, strict=True)
    )
    first = {same_columns(j, bank): j for j in reversed(good)}
    kept = tuple(
        j for j in good if share[same_columns(j, bank)] > _LISTED * own and first[same_columns(j, bank)] is j
    )
    ahead = own >= options.name_at and (
        at_best[same_columns(leader, bank)] >= _AT_BEST or _without_shape(leader)
    )
    verdict = NAMED if ahead or len(kept) < 2 else AMBIGUOUS
    if verdict == NAMED and leader.rivals.best >= -AS_MUCH:
        return replace(
            _insufficient(leader, Why.AS_WELL, tried, tests), confidence=_in_doubt(leader, confidence)
        )
    others = [j for k in range(len(leader.members)) for j in other_names(shop, leader, k)]
    if others:
        verdict, kept = AMBIGUOUS, (leader, *others, *kept[1:])
    because = Reason(Why.AHEAD if verdict == NAMED else Why.SEVERAL)
    return Outcome(verdict, because, *tests, leader, kept, confidence, tuple(tried))


def _in_doubt(leader: Judged, confidence: Sequence[float]) -> tuple[float, ...]:
    """An even bet on the members that a law without a name may replace."""
    challenged = (c >= -CLOSE for c in leader.rivals.challenge)
    most = (EVEN if doubt else PARTLY for doubt in challenged)
    return tuple(min(c, m) for c, m in zip(confidence, most, strict=True))


def _without_shape(judged: Judged) -> bool:
    """Whether the laws of a set's joints have no shape: a linear one is the limit of those that bend."""
    bank = judged.bank
    own = [bank.candidates[m] for m in judged.members if bank.place[m]]
    return bool(own) and all(len(c.shapes) == 1 for c in own)


def _spared(proposal: Proposal, found: Evidence) -> float:
    """What the evidence of a set would gain if each member had its best shape alone, and none to choose from.

    Between laws at one place, a lead that rests on having had fewer shapes to choose from is none.
    """
    return float(sum(found.entry[found.best_entry[m]] - found.candidate[m] for m in proposal.members))


def _calibrated(share: float, leader: Judged, p: float) -> float:
    """Posterior share, lowered by the best laws without a name and by a weak detection, on the benchmark's scale."""
    offset, slope, limit = CALIBRATION
    share = float(np.clip(share, _DOUBT, 1 - _DOUBT))
    raw = min(float(np.log(share / (1 - share))), limit)
    alike = leader.rivals.alike
    ahead = (leader.rivals.best, -np.inf if alike is None else alike.lead)
    rival = sum(float(np.log1p(np.exp(min(lead, _FAR_BEHIND)))) for lead in ahead)
    return float(expit(offset + slope * raw - rival)) * (1.0 - min(1.0, _WEAK * p))
