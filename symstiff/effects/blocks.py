"""Compliance blocks of links as effects, with the names k<i>_<row><col> that compliances have in a model."""

from __future__ import annotations

from collections.abc import Callable

from symstiff.effects.base import EffectParameter, Realisation, Shape, Where
from symstiff.reduction.physical import UNITS
from symstiff.reduction.template import beam_pattern, pattern
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import AXES, link_terms

_RANGE = {"m/N": 1e-4, "rad/N": 1e-4, "rad/(N*m)": 1e-3}
_TURN = 1e-7
"""Typical compliance of a link against turning, rad/(N·m)."""
Pairs = Callable[[Robot, int], tuple[tuple[int, int], ...]]
ALL = tuple((r, c) for r in AXES for c in AXES if r <= c)


def template_pairs(robot: Robot, link: int) -> tuple[tuple[int, int], ...]:
    """Entries of the link's template; of the beam where the link is taken for rigid."""
    name = robot.links[link].template
    kept = beam_pattern() if name == "rigid" else pattern(robot, name)
    return tuple((r, c) for r, c in ALL if kept[r - 1][c - 1])


def other_pairs(robot: Robot, link: int) -> tuple[tuple[int, int], ...]:
    """Entries outside the template."""
    inside = template_pairs(robot, link)
    return tuple(pair for pair in ALL if pair not in inside)


def all_pairs(robot: Robot, link: int) -> tuple[tuple[int, int], ...]:
    """All 21 entries."""
    return ALL


def block(pairs: Pairs) -> Callable[[Robot, Where, Shape], Realisation]:
    """How a block at ``{"link": i}`` is realised."""

    def realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
        link = int(where["link"])
        chosen = pairs(robot, link)
        names = [f"k{link}_{r}{c}" for r, c in chosen]
        terms = [
            t
            for n, (r, c) in zip(names, chosen, strict=True)
            for t in link_terms(link, r, c, n, symmetric=True)
        ]
        length = robot.reach / max(robot.dof, 1)
        found = [_parameter(n, r, c, length) for n, (r, c) in zip(names, chosen, strict=True)]
        return Realisation(tuple(found), tuple(terms))

    return realise


def _parameter(name: str, row: int, column: int, length: float) -> EffectParameter:
    """Entries of a link of some length: a shift is to a turn as that length is to one, a coupling half as large."""
    unit = UNITS[row > 3, column > 3]
    high = _RANGE[unit]
    typical = _TURN * length ** ((row <= 3) + (column <= 3)) * (1.0 if row == column else 0.5)
    return EffectParameter(name, unit, 0.0 if row == column else -high, high, typical)
