"""Whether a law can be computed: what it is made of, and where it acts, are this robot's."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import sympy as sp

from symstiff.arguments import number, require
from symstiff.effects.base import NAME, EffectParameter, Realisation
from symstiff.effects.units import base_units
from symstiff.errors import UserError
from symstiff.robot.names import C_WORDS
from symstiff.robot.schema import Robot
from symstiff.symbolic.algebras import FUNCTIONS
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.terms import AXES, CONTEXT, Term, VirtualJoint, deflection, q, tau, up, w

_MEMBERS = frozenset({"k", "time", "temperature", "branch", "turn"})
"""What the C struct of a model's parameters holds beside those of effects."""


def check_realised(found: Any, robot: Robot) -> None:
    """Raise UserError for what is no realisation, and for parameters and laws that nothing can compute."""
    require(found, Realisation, "a Realisation of realise", "see symstiff.effects.base")
    for name, kind in (("parameters", EffectParameter), ("terms", Term)):
        several = getattr(found, name)
        if not isinstance(several, tuple) or not all(isinstance(one, kind) for one in several):
            raise UserError(f"its {name} are no {kind.__name__}s: give a tuple of them")
    check_parameters(found)
    check_laws(found.terms, robot)


def check_parameters(found: Realisation) -> None:
    """Refuse units that are none, ranges upside down, terms of no parameter, and names that no C struct can hold.

    What has no terms has no code, and its names may tell of rows.
    """
    for p in found.parameters:
        try:
            base_units(p.unit)
        except (TypeError, ValueError):
            raise UserError(
                f"the unit of {p.name} cannot be {p.unit!r}: give SI units, as rad/(N*m), m/N, kg or 1"
            ) from None
        low, high = number(p.low, f"{p.name}: low"), number(p.high, f"{p.name}: high")
        if low > high:
            raise UserError(f"{p.name}: low {low:g} is above high {high:g}: give the plausible range")
        if number(p.typical, f"{p.name}: typical") < 0.0:
            raise UserError(f"{p.name}: typical {p.typical:g} is below zero: give the size that is usual")
    for p in found.parameters if found.terms else ():
        if not NAME.fullmatch(p.name) or p.name in C_WORDS | _MEMBERS:
            raise UserError(
                f"an effect's parameter cannot be called {p.name!r}: it is a member of a C struct beside k, time, "
                "temperature and branch: use letters, digits and _, e.g. <effect>_<place>_<what>"
            )
    names = [p.name for p in found.parameters]
    for name in (*(t.parameter for t in found.terms), *found.nominal):
        if name not in names:
            raise UserError(f"a law has the parameter {name!r}, which is none of {names}: list it there")


def check_laws(terms: Iterable[Term], robot: Robot) -> None:
    """Raise UserError for a term that acts nowhere on the robot, or whose factor nothing can compute."""
    places, symbols = _known(robot)
    for term in terms:
        if term.at not in places:
            raise UserError(f"{term.parameter} acts at {term.at.name}, which {robot.name} does not have")
        for part in sp.preorder_traversal(term.factor):
            if wrong := _wrong(part, symbols):
                raise UserError(f"the law of {term.parameter} {wrong}")


def _wrong(part: sp.Basic, symbols: frozenset[sp.Symbol]) -> str:
    """What is wrong with a part of a law; empty for nothing."""
    if part.is_Symbol:
        known = "tau(…), q(…), w(…), up(…), TIME, TEMPERATURE, BRANCH and TURN of symstiff.symbolic.terms"
        return "" if part in symbols else f"depends on {part}, which this robot has not: use {known}"
    if part.is_Function:
        name = type(part).__name__
        return "" if name in FUNCTIONS else f"uses {name}: use {', '.join(sorted(FUNCTIONS))}"
    if part.is_Pow:
        return "" if part.args[1].is_number else f"has the power {part.args[1]}: use exp and log"
    if part.is_number:
        return "" if part.is_finite and part.is_real else f"holds {part}, which is no number"
    return (
        "" if part.is_Add or part.is_Mul else f"holds {type(part).__name__}: use sums, products and functions"
    )


@lru_cache(maxsize=32)
def _known(robot: Robot) -> tuple[frozenset[VirtualJoint], frozenset[sp.Symbol]]:
    """Where terms may act on a robot, and the symbols of their factors."""
    own = ElasticChain(robot).virtual_joints
    bodies = range(robot.dof + 1)
    beside = [VirtualJoint(kind, 0, a) for kind in ("load", "measure") for a in AXES]
    weights = [VirtualJoint("body", i, a) for i in bodies for a in AXES]
    symbols = [*map(tau, own), *map(w, AXES), *map(deflection, AXES), *CONTEXT]
    symbols += [q(j) for j in bodies[1:]] + [up(i, k) for i in bodies for k in (1, 2, 3)]
    return frozenset([*own, *beside, *weights]), frozenset(symbols)
