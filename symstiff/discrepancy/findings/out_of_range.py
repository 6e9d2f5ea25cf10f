"""Sizes against their physical ranges: which go astray, and which nobody would believe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from symstiff.discrepancy.bridge.ranges import CATALOGUE, Extent, at_size
from symstiff.discrepancy.findings.numbers import quantity
from symstiff.discrepancy.findings.result import Found, Quantity
from symstiff.effects.base import EffectParameter
from symstiff.effects.places import named as named_at
from symstiff.robot.schema import Robot

_DOUBTS = 4.0
"""Standard deviations by which a size is beyond its physical range for sure."""


def astray(effects: Sequence[Found], robot: Robot, extent: Extent = CATALOGUE) -> bool:
    """Whether a size is beyond its physical range by more than the range is wide, and not for want of data."""
    for effect in effects:
        for p in at_size(effect.instance.realise(robot).parameters, extent):
            found, width = effect.parameters.get(p.name), p.high - p.low
            far = max(width, _DOUBTS * found.std) if found is not None else np.inf
            if found is not None and np.isfinite(width) and outside(p, found) > far:
                return True
    return False


def out_of_range(effects: Sequence[Found], robot: Robot, extent: Extent = CATALOGUE) -> list[str]:
    """Remarks on effects with sizes that nobody would believe, though the data allow sizes within the range."""
    out = []
    for effect in effects:
        ranges = at_size(effect.instance.realise(robot).parameters, extent)
        known = [(p, effect.parameters.get(p.name)) for p in ranges]
        told = [(p, found) for p, found in known if found is not None and np.isfinite(found.std)]
        odd = [(p, found) for p, found in told if _unbelievable(p, found)]
        if not odd:
            continue
        told_of = "; ".join(beyond(p, found) for p, found in odd)
        merged = ", ".join(p.name for p, found in known if found is None or not np.isfinite(found.std))
        below = all(p.low == 0.0 and found.value < 0.0 for p, found in odd)
        why = _of_a_sum(merged) if merged and below else _of_chance(len(odd))
        out.append(f"{named_at(effect.effect, effect.where)}: {told_of} is physical{why}")
    return out


def _of_chance(count: int) -> str:
    it, them = ("it", "its size") if count == 1 else ("them", "their sizes")
    return (
        f": what these data do not tell from {it} may be in {it}, so do not rely on {them} before more poses were "
        "measured"
    )


def _of_a_sum(merged: str) -> str:
    return (
        f" for it alone: here it is a sum with {merged}, which these data do not tell from it, "
        "and a sum may be below zero"
    )


def outside(parameter: EffectParameter, found: Quantity) -> float:
    """How far a size is out of its physical range, in its unit."""
    return max(found.value - parameter.high, parameter.low - found.value, 0.0)


def _unbelievable(parameter: EffectParameter, found: Quantity) -> bool:
    """Whether a size is out of its physical range; one that is zero within its deviation may fall below zero."""
    return found.value > parameter.high or found.value + found.std < parameter.low


def beyond(parameter: EffectParameter, found: Quantity) -> str:
    """A size out of its range beside the limit that it passes, for a sentence that ends with "is physical"."""
    high = found.value > parameter.high
    side, limit = ("at most", parameter.high) if high else ("at least", parameter.low)
    return f"{parameter.name} is {quantity(found)}, where {side} {quantity(Quantity(limit, 0.0, parameter.unit))}"
