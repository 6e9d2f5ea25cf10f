"""Whether a law can be computed: what it is made of, and where it acts, are this robot's."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import sympy as sp

from symstiff.errors import UserError
from symstiff.robot.schema import Robot
from symstiff.symbolic.algebras import FUNCTIONS
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.terms import AXES, CONTEXT, Term, VirtualJoint, deflection, q, tau, up, w


def check_laws(terms: Iterable[Term], robot: Robot) -> None:
    """Raise UserError for a term that acts nowhere on the robot, or whose factor nothing can compute."""
    places, symbols = _known(robot)
    for term in terms:
        if term.at not in places:
            raise UserError(f"{term.parameter} acts at {term.at.name}, which {robot.name} does not have")
        for part in sp.preorder_traversal(sp.sympify(term.factor)):
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
