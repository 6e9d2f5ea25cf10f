"""What a law's shape leaves open of its size: a deviation, or where the data hardly tell the shape a range.

Then the shape that asks for the least stands for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from symstiff.discrepancy.problem import Parameter
from symstiff.discrepancy.statistics.between import Alternative, alternatives
from symstiff.discrepancy.statistics.scan import Scan
from symstiff.effects.base import Shape

_AS_WELL, _EXCLUDED = 1.0, 2.0
"""Log likelihood by which a shape may trail the best to stand for it, and from which it is excluded."""
_SAME = 1e-6
"""Log likelihood by which shapes differ at least that are not the same law."""
_FAR = 3.0
"""Standard deviations by which a size may be out of its physical range."""
_TOLD, _SHARE = 2.0, 0.25
"""Standard deviations within which, and share of the size by which, sizes in other shapes are the same."""
_DISTANCES = ("rad", "m")
"""Units of sizes that say how far a joint goes under whatever load: the least of them is the least that is asked."""


@dataclass(frozen=True)
class Spread:
    """The shape that stands for a law, and its sizes in all that account for the data as well."""

    shape: Shape
    sizes: tuple[float, float] | None = None
    """The least and the largest, where they are far apart."""
    deviation: float = 0.0
    """Of the size by what the data leave open of the shape, where they are not."""


def spread(scan: Scan, entries: Sequence[int], i: int) -> Spread:
    """Of one of a set's entries, beside the others.

    A gap that one pose alone crosses may be narrow and sharp or wide and blunt: a larger one than these data ask for
    would move the arm in poses that nobody measured.
    """
    bank, entry = scan.bank, entries[i]
    found = alternatives(scan, tuple(e for e in entries if e != entry), entry)
    if not found:
        return Spread(bank.shape_of(entry))
    size = bank.parameters(entry)[0]
    possible = [a for a in found if _physical(a, size)]
    best = max(a.likelihood for a in found)
    chosen = found[0]
    if size.unit in _DISTANCES:
        near = (a for a in possible if a.likelihood > best - _AS_WELL)
        least = min(near, key=lambda a: abs(a.value), default=chosen)
        chosen = least if _apart(least, chosen) else chosen
    else:  # shapes that differ by the unit of the size alone are the same
        possible = [a for a in possible if abs(a.likelihood - chosen.likelihood) > _SAME]
    likely = [a for a in possible if a.likelihood > best - _EXCLUDED]
    if any(_apart(a, chosen) for a in likely):
        values = [a.value for a in (chosen, *likely)]
        return Spread(chosen.shape, (min(values), max(values)))
    others = (a for a in possible if a is not chosen)
    return Spread(chosen.shape, deviation=_deviation((chosen, *others), chosen))


def _deviation(possible: Sequence[Alternative], chosen: Alternative) -> float:
    """Root mean square of sizes about the chosen one, by how likely their shapes are."""
    best = max(a.likelihood for a in possible)
    weight = np.exp([a.likelihood - best for a in possible])
    square = [(a.value - chosen.value) ** 2 for a in possible]
    return float(np.sqrt(weight @ square / weight.sum()))


def _physical(found: Alternative, size: Parameter) -> bool:
    margin = _FAR * found.std
    return size.low - margin <= found.value <= size.high + margin


def _apart(one: Alternative, other: Alternative) -> bool:
    """Whether a size is another one than in another shape, by the deviation there."""
    return abs(one.value - other.value) > max(_TOLD * other.std, _SHARE * abs(other.value))
