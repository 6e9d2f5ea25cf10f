"""A hint for exchanged markers: would the measured points, named otherwise, fit far better?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations

import numpy as np

from symstiff.calibration.measurements import Measurements
from symstiff.calibration.rows import equations
from symstiff.model import StiffnessModel

_FAR_BETTER = 0.5
"""Part of the squares left as named up to which another naming is spoken of."""
_FEWEST = 20
"""Degrees of freedom below which a few readings' noise is halved by chance."""
_MOST = 4
"""Points of which every order is tried; of more, two at a time change their names."""

Left = Callable[[tuple[str, ...]], tuple[float, int]]
"""Sum of squares that is left where the points of a table have other names, in their order; degrees of freedom."""


def marker_hint(points: Sequence[str], left: Left) -> str:
    """Which points look exchanged; empty if none do, or if too little is left to tell."""
    told = tuple(points)
    if len(told) < 2:
        return ""
    now, freedom = left(told)
    if freedom < _FEWEST or now == 0.0:
        return ""
    found = {names: left(names)[0] for names in _orders(told)}
    best = min(found, key=lambda names: found[names])
    if found[best] > _FAR_BETTER * now:
        return ""
    read = ", ".join(f"{a} as {b}" for a, b in zip(told, best, strict=True) if a != b)
    share = 100.0 * float(np.sqrt(found[best] / now))
    return f"markers look exchanged: to read {read} would leave {share:.0f} % of the residual"


def left_by(model: StiffnessModel, table: Measurements) -> tuple[float, int]:
    """Squares that the model, fitted to deflections, leaves of them [m², rad²], and degrees of freedom."""
    e = equations(model, table)
    size = np.linalg.norm(e.A, axis=0)
    columns = e.A / np.where(size > 0, size, 1.0)
    fitted, _, rank, _ = np.linalg.lstsq(columns, e.y, rcond=1e-10)
    rest = e.y - columns @ fitted
    return float(rest @ rest), len(e.y) - int(rank)


def _orders(told: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Other orders of some names."""
    if len(told) <= _MOST:
        return [names for names in permutations(told) if names != told]
    out = []
    for a in range(len(told)):
        for b in range(a):
            names = list(told)
            names[a], names[b] = told[b], told[a]
            out.append(tuple(names))
    return out
