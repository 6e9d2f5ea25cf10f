"""Effects in words: names and places, sizes with units, confidence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.numbers import milli, quantity
from symstiff.discrepancy.findings.result import Found, Name, Quantity
from symstiff.display import counted, few, listing
from symstiff.effects.places import DETAILS, named, place, site, spoken

_FEW = 3
"""Compliances of an effect up to which one of them says how large it is."""
MANY = 3
"""Places of an effect up to which each is told by itself."""
_CLEAR = 2.0
"""Standard deviations from which a size is told from zero."""
_SIZES = 2
"""Parameters of an effect at most that are told for being determined best."""


def name_text(name: Name) -> str:
    """An effect and its place, by name, in words."""
    return named(name.effect, name.where)


def names(effects: Sequence[Found]) -> str:
    """Effects at their places; one that is at many places in one breath."""
    kinds: dict[str, list[Found]] = {}
    for e in effects:
        kinds.setdefault(e.effect, []).append(e)
    return "; ".join(
        f"{spoken(kind)} {places([e.where for e in group])}".strip() for kind, group in kinds.items()
    )


def places(wheres: Sequence[Mapping[str, Any]]) -> str:
    """Places as words, equal kinds together: ``at joints 1–4, 6``, ``at joint 2 (1–32 a turn)``."""
    numbers: dict[tuple[str, str], list[int]] = {}
    other: list[str] = []
    pairs = [where["joints"] for where in wheres if "joints" in where]
    if len(pairs) > 1:
        other = ["between joints " + ", ".join(" and ".join(map(str, pair)) for pair in pairs)]
        wheres = [where for where in wheres if "joints" not in where]
    details = _details(wheres)
    for where in wheres:
        at = site(where)
        key, value = next(iter(at.items()), ("", None))
        if len(at) == 1 and key in ("joint", "link") and isinstance(value, int):
            rest = details[place(at)] if len(at) < len(where) else ""
            numbers.setdefault((key, rest), []).append(value)
        else:
            other.append(place(where))
    text = [
        (place({key: n[0]}) if len(set(n)) == 1 else f"at {key}s {_ranges(sorted(set(n)))}") + rest
        for (key, rest), n in numbers.items()
    ]
    whole = list(dict.fromkeys(other))
    things = [f"of the {x[1:-1]}" if x.startswith("(") and x.endswith(")") else x for x in whole]
    return (
        " and ".join([", ".join(text), *things]) if text and things != whole else ", ".join([*text, *whole])
    )


def _details(wheres: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """The details of all places, together where they are of the same, by the place in words."""
    values: dict[str, dict[str, set[Any]]] = {}
    for where in wheres:
        for key in DETAILS.keys() & where.keys():
            values.setdefault(place(site(where)), {}).setdefault(key, set()).update(where[key])
    return {
        at: "".join(f" {DETAILS[key].format(_ranges(sorted(own)))}" for key, own in of.items())
        for at, of in values.items()
    }


def _ranges(numbers: list[int]) -> str:
    """1–4, 6."""
    runs: list[list[int]] = []
    for n in numbers:
        if runs and n == runs[-1][-1] + 1:
            runs[-1].append(n)
        else:
            runs.append([n])
    return ", ".join(
        str(r[0]) if len(r) == 1 else f"{r[0]}{'–' if len(r) > 2 else ', '}{r[-1]}" for r in runs
    )


def main_parameters(effect: Found) -> str:
    """The best determined parameters of an effect, and its mass, as text; of the others how many are determined.

    Those that the data do not tell are zero, and what they would make counts in the others.
    """
    sizes = effect.parameters
    known = [n for n, e in sizes.items() if math.isfinite(e.std) and e.std > 0]
    if not known:
        return ""
    best = sorted(known, key=lambda n: -abs(sizes[n].value) / sizes[n].std)
    shown = [best[0], *(n for n in best[1:_SIZES] if _determined(sizes[n]))]
    shown += [n for n, e in sizes.items() if e.unit == "kg" and n not in shown]
    held = [n for n, e in sizes.items() if n not in shown and e.value == 0.0 and not math.isfinite(e.std)]
    rest = [_determined(e) for n, e in sizes.items() if n not in (*shown, *held)]
    text = [f"{n} = {quantity(sizes[n])}{_doubt(sizes[n])}" for n in shown]
    text += [f"{sum(rest)} more"] * any(rest) + [f"{rest.count(False)} not told from zero"] * (not all(rest))
    zero = f" with {few(held, 2)} held at zero, which these data do not tell" if held else ""
    return listing(text) + zero


def _determined(size: Quantity) -> bool:
    """Whether a size is twice its deviation."""
    return _CLEAR * size.std <= abs(size.value)


def _doubt(size: Quantity) -> str:
    return "" if _determined(size) or not math.isfinite(size.std) else " (not told from zero)"


def magnitude(finding: Finding, effect: Found) -> str:
    """How large an effect is: its best determined parameters and what they move; of a block of compliances that."""
    told, reach = main_parameters(effect), _reach(finding, effect)
    units = [e.unit for e in effect.parameters.values()]
    if not told or not reach or all(u == "m" for u in units):  # a shift tells by itself what it moves
        return told
    if len(units) <= _FEW or not all("/N" in u or "/(N" in u for u in units):
        return f"{told}, by which readings move by up to {reach}"
    known = sum(math.isfinite(e.std) for e in effect.parameters.values())
    verb = "moves" if known == 1 else "move"
    return f"{counted(known, 'compliance')} that {verb} a reading by up to {reach}"


def _reach(finding: Finding, effect: Found) -> str:
    """The largest of what an effect adds to a position that was read; nothing where none was."""
    moved = np.abs(finding.added(effect)[finding.assembly.problem.axis < 3])
    return f"{milli(float(moved.max()))} mm" if moved.size else ""


def confidence(finding: Finding, group: Sequence[Found]) -> str:
    """The least confidence of a group, in words."""
    least, bet = finding.confidence(group)
    return "at most an even bet" if bet else f"confidence in the name {100 * least:.0f} %"


def each_told(finding: Finding, group: list[Found]) -> list[str]:
    """Effects of one kind with sizes and confidence, each by itself; many in one breath."""
    if len(group) > MANY:
        count = sum(math.isfinite(size.std) for e in group for size in e.parameters.values())
        return [f"{names(group)} ({count} parameters, {confidence(finding, group)})"]
    return [
        f"{named(e.effect, e.where)}{_or_else(e)} "
        f"({', '.join(t for t in (_over(finding, e, magnitude(finding, e)), confidence(finding, [e])) if t)})"
        for e in group
    ]


def _over(finding: Finding, effect: Found, sizes: str) -> str:
    """Sizes, after what they are counted over: a drift is one over a time or a change of temperature."""
    spans = effect.instance.span_phrases(finding.assembly.situation.view.robot)
    return f"{', '.join(spans)}: {sizes}" if spans and sizes else sizes


def shape_text(finding: Finding, effect: Found) -> str:
    """The shape of an effect's law, with units."""
    return ", ".join(effect.instance.shape_phrases(finding.assembly.situation.view.robot))


def _or_else(effect: Found) -> str:
    """Other names for the same columns."""
    if not effect.twins:
        return ""
    return f" (or {' or '.join(name_text(n) for n in effect.twins[:3])}: the same columns, no data tell them apart)"


def each_name(found: Iterable[Name]) -> list[str]:
    """Effects at their places in words, each once."""
    return list(dict.fromkeys(name_text(n) for n in found))
