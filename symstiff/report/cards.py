"""Cards of the page: an effect each, with sizes, shape, confidence and what it may be taken for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from symstiff.discrepancy.findings import numbers
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.result import Found
from symstiff.discrepancy.search.verdict import AMBIGUOUS
from symstiff.display import few
from symstiff.effects.base import Effect
from symstiff.effects.places import named
from symstiff.effects.registry import catalogue
from symstiff.report import naming, words


def explanations(finding: Finding) -> list[dict[str, Any]]:
    """Cards of the effects; those of an ambiguous verdict by what all explanations share, then by explanation."""
    if finding.verdict != AMBIGUOUS:
        return [{"title": "", "cards": cards_of(finding, finding.effects)}] if finding.effects else []
    common, own = words.explanations(finding)
    out = [{"title": "In every explanation", "cards": cards_of(finding, common)}] if common else []
    for k, members in enumerate(own, start=1):
        sure = f": {naming.confidence(finding, members)}" if members else ": nothing more"
        out.append({"title": f"Explanation {k}{sure}", "cards": cards_of(finding, members)})
    return out


def cards_of(finding: Finding, effects: Sequence[Found]) -> list[dict[str, Any]]:
    """A card an effect; one for all places of an effect that is at many."""
    groups: dict[tuple[int, str], list[Found]] = {}
    for e in effects:
        groups.setdefault((e.set_number, e.effect), []).append(e)
    cards = [
        part
        for group in groups.values()
        for part in ([group] if len(group) > naming.MANY else [[e] for e in group])
    ]
    return [_card(finding, group) for group in cards]


def _described(effect: Effect, group: list[Found]) -> str:
    """What an effect is, and which way it goes here."""
    ways = {effect.sense(e.shape, {n: size.value for n, size in e.parameters.items()}) for e in group}
    return " ".join(filter(None, (effect.description, *(ways if len(ways) == 1 else ()))))


def _card(finding: Finding, group: list[Found]) -> dict[str, Any]:
    e = group[0]
    entry = catalogue().get(e.effect)
    confounded = naming.each_name(n for g in group for n in g.confounded_with)
    sizes = {n: size for g in group for n, size in g.parameters.items()}
    zero = [n for n, size in sizes.items() if size.value == 0.0 and not math.isfinite(size.std)]
    return {
        "set": e.set_number + 1,
        "name": naming.names(group) if len(group) > 1 else named(e.effect, e.where),
        "wide": len(group) > 1,
        "description": _described(entry, group) if entry else "",
        "separated_by": entry.separated_by if entry else "",
        "parameters": [(n, numbers.quantity(size)) for n, size in sizes.items() if n not in zero],
        "zero": zero,
        "p": numbers.p_equals(max(g.p_value for g in group)),
        "confidence": naming.confidence(finding, group),
        "confounded": few(confounded, 6),
        "shape": naming.shape_text(finding, e),
    }
