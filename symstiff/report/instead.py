"""What would fit in the place of a named effect, in words: by more parameters, or nearly as well."""

from __future__ import annotations

import math
from collections.abc import Sequence

from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.numbers import number
from symstiff.discrepancy.findings.result import Found, Instead
from symstiff.discrepancy.search.rivals import AS_MUCH
from symstiff.display import counted, sentence_case
from symstiff.effects.places import named

_PLACED = 2
"""Others at most that are told in the place of a named effect."""
TRAILING = 5.0
"""Log evidence, 150 to 1, by which another effect may trail a named one to be told to fit nearly as well."""


def as_well(finding: Finding) -> str:
    """What would fit in the place of a named effect, where that is no explanation that is told anyhow."""
    told = {named(e.effect, e.where) for e in (*finding.named, *finding.alternatives)}
    parts = list[str]()
    for e in finding.named:
        known = told | {named(n.effect, n.where) for n in e.twins}
        others = [o for o in e.instead if named(o.name.effect, o.name.where) not in known]
        larger = [o for o in others if o.directions > o.own and o.worse < AS_MUCH and o.behind > 0]
        near = [o for o in others if o not in larger and o.behind < TRAILING]
        parts += [_larger(e, larger[:_PLACED]), _near(e, near)]
    return "".join(dict.fromkeys(parts))  # one may be refused in the places of several


def _larger(effect: Found, others: Sequence[Instead]) -> str:
    """Others that fit as well by more parameters."""
    if not others:
        return ""
    counts = [f"{counted(others[0].directions, 'parameter')} instead of {others[0].own}"]
    counts += [str(o.directions) for o in others[1:]]
    told = " or ".join(
        f"{named(o.name.effect, o.name.where)} ({n})" for o, n in zip(others, counts, strict=True)
    )
    simpler = sentence_case(named(effect.effect, effect.where))
    return f" {simpler} is named for being simpler: {told} would fit these data as well."


def _near(effect: Found, others: Sequence[Instead]) -> str:
    """The other that trails least, and by how little, or why."""
    if not others:
        return ""
    other = min(others, key=lambda o: o.behind)
    told = f"{sentence_case(named(other.name.effect, other.name.where))} would fit"
    if other.behind <= 0:
        return f" {told} these data as well, and is refused for other reasons: see the candidates."
    by = f"{number(math.exp(other.behind), 2) if other.behind > AS_MUCH else 'less than 3'} to 1"
    if other.worse < min(AS_MUCH, 0.5 * other.behind):
        return f" {told} these data as well: it is only less likely beforehand, {by}."
    return f" {told} nearly as well: these data favour {named(effect.effect, effect.where)} by {by}."
