"""What became of the effects that a start model has: those that changed their size since, and those that are gone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from symstiff.discrepancy.findings.numbers import quantity
from symstiff.discrepancy.findings.result import Quantity
from symstiff.effects.places import named as named_at
from symstiff.model import StiffnessModel

_CHANGED, _SHARE = 5.0, 0.2
"""Standard deviations, and share of its size, by which a parameter has to differ from what the start model says."""
_GONE = 3.0
"""Standard deviations within which what is left of an effect is none."""

_Pair = tuple[str, Quantity, Quantity]


def since(start: StiffnessModel, fitted: StiffnessModel) -> list[str]:
    """Remarks on effects of a start model whose sizes in it do not hold any more, by the deviations of both."""
    found = []
    for effect, realised in zip(start.effects, start.realisations, strict=True):
        if effect not in fitted.effects or realised.nominal:
            continue
        pairs = list(_pairs([p.name for p in realised.parameters], start, fitted))
        changed = [pair for pair in pairs if _differs(*pair[1:])]
        if not changed:
            continue
        gone = all(abs(now.value) < _GONE * now.std for _, _, now in pairs)
        told = "; ".join(f"{name} {quantity(then)}, now {quantity(now)}" for name, then, now in changed)
        meant = (
            "nothing is left of it: was the part mended or replaced?"
            if gone
            else "its size has changed since the start model was made"
        )
        found.append(f"{named_at(effect.effect, effect.where)}: {meant} ({told})")
    return found


def _pairs(names: list[str], start: StiffnessModel, fitted: StiffnessModel) -> Iterator[_Pair]:
    """Parameters of which both models tell how sure they are, with what they say."""
    for name in names:
        if name in start.deviations and name in fitted.deviations:
            then, now = (
                Quantity(float(m.values[name]), float(m.deviations[name]), m.units[name])
                for m in (start, fitted)
            )
            yield name, then, now


def _differs(then: Quantity, now: Quantity) -> bool:
    by = abs(now.value - then.value)
    return bool(by > _CHANGED * np.hypot(then.std, now.std) and by > _SHARE * abs(then.value))
