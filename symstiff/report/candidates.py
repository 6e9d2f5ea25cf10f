"""Tables of the page on the whole catalogue: what was ranked, what could not be tested, what would have been seen."""

from __future__ import annotations

import math

from symstiff.discrepancy.findings import numbers
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.result import CandidateResult, Name
from symstiff.discrepancy.search.verdict import NOTHING
from symstiff.display import few
from symstiff.effects.instance import EffectInstance
from symstiff.effects.places import named, spoken
from symstiff.report import naming

_MOST_CANDIDATES = 20
_MOST_PLACES, _SEEN_AT = 8, 6
"""Places of an effect from which on their number, or the best of them, stands for all, and those shown else."""


def _best(c: CandidateResult) -> tuple[str, str]:
    """The parameter that is known best, where there are several, and its size."""
    known = {n: e for n, e in c.parameters.items() if math.isfinite(e.std) and e.std > 0}
    if not known:
        return "", "not determined one by one" if c.parameters else "–"
    name = max(known, key=lambda n: abs(known[n].value) / known[n].std)
    return name if len(c.parameters) > 1 else "", numbers.quantity(known[name])


def _smallest(c: CandidateResult) -> tuple[str, str]:
    """The smallest size that would be seen, and of which parameter where there are several."""
    finite = {n: e for n, e in c.smallest_detectable.items() if math.isfinite(e.value)}
    if not finite:
        return "–", ""
    name = next(iter(finite))
    return numbers.size_text(finite[name]), name if len(c.smallest_detectable) > 1 else ""


def candidates(finding: Finding) -> list[dict[str, str]]:
    """What could be tested, the likeliest first, a row each."""
    answer = {True: "yes", False: "no", None: "–"}
    return [
        {
            "name": named(c.effect, c.where),
            "parameter": _best(c)[0],
            "size": _best(c)[1],
            "p": numbers.p_text(c.p_value),
            "sufficient": answer[c.sufficient],
            "plausible": answer[c.plausible],
            "testable": f"yes, {numbers.percent(c.share_left)} left",
            "confused": few(
                naming.each_name([n for n in c.confused_with if n != Name(c.effect, c.where)]), 3
            ),
        }
        for c in [c for c in finding.candidates if c.testable][:_MOST_CANDIDATES]
    ]


def untested(finding: Finding) -> list[tuple[str, str]]:
    """Reasons why candidates could not be tested, or not in every shape, with those that they hold for."""
    reasons: dict[str, dict[str, list[CandidateResult]]] = {}
    for c in finding.candidates:
        if c.reason or not c.testable:
            reasons.setdefault(c.reason or "not testable", {}).setdefault(c.effect, []).append(c)
    return [(reason, "; ".join(_together(group) for group in by.values())) for reason, by in reasons.items()]


def _together(group: list[CandidateResult]) -> str:
    """One effect at its places; only their number where there are many."""
    if len(group) > _MOST_PLACES:
        return f"{spoken(group[0].effect)} ({len(group)} places)"
    return f"{spoken(group[0].effect)} {naming.places([c.where for c in group])}".strip()


def sensitivity(finding: Finding) -> list[tuple[str, str, str, str]]:
    """Per effect the place where it would have been seen best, and how large it had to be there."""
    source = finding.last.candidates if finding.verdict == NOTHING else finding.candidates
    best: dict[str, list[CandidateResult]] = {}
    for c in source:
        if any(math.isfinite(e.value) for e in c.smallest_detectable.values()):
            best.setdefault(c.effect, []).append(c)
    out = []
    for group in best.values():
        rows = sorted(group, key=_smallest_value)
        for c in rows[:1] if len(rows) > _MOST_PLACES else rows[:_SEEN_AT]:
            out.append((_as_seen(finding, c), *_smallest(c), "yes" if _would_show(finding, c) else "no"))
    return out


def _as_seen(finding: Finding, c: CandidateResult) -> str:
    """The effect at its place, with the shape that its smallest size is of where another one is not seen."""
    if not (c.testable and c.reason):
        return named(c.effect, c.where)
    told = EffectInstance(c.effect, c.where, c.seen_as).shape_phrases(finding.task.robot)
    return ", ".join([named(c.effect, c.where), *told])


def _would_show(finding: Finding, c: CandidateResult) -> bool:
    """Whether a believable size would be seen; of an effect whose size is known, that size."""
    if not c.testable:
        return False
    known = EffectInstance(c.effect, c.where, c.shape).realise(finding.task.robot).nominal
    return all(
        c.smallest_detectable[n].value <= abs(v) for n, v in known.items() if n in c.smallest_detectable
    )


def _smallest_value(c: CandidateResult) -> float:
    return next(e.value for e in c.smallest_detectable.values() if math.isfinite(e.value))
