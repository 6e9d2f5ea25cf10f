"""Laws of a joint's whole load, the links' weight in it: what they give under that, and not what a load adds to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sympy as sp

from symstiff.arrays import Array
from symstiff.discrepancy.findings.result import Found
from symstiff.effects.arm import ASSUMED, own_load
from symstiff.effects.registry import find
from symstiff.robot.schema import Robot
from symstiff.symbolic.algebras import NumpyAlgebra
from symstiff.symbolic.program import walk
from symstiff.symbolic.terms import actuated_joint, q, tau

_GRID = 400


@dataclass(frozen=True, eq=False)
class WholeLoad:
    """Of points (N,): the weight's load on the joint, and what the law gives under it alone; the law as a curve."""

    weight: Array
    start: Array
    curve: tuple[Array, Array]


def whole_load(
    robot: Robot, effect: Found, formula: sp.Expr, loads: Array, angles: Array
) -> WholeLoad | None:
    """For a law that counts the weight by itself; None where it takes the load as it comes, or nothing weighs on it.

    formula: the law with its size, f(weight + τ) − f(weight); loads (N,), angles (N, n).
    """
    known, joint = find(effect.effect), effect.where.get("joint")
    if known.weights is None or not isinstance(joint, int) or not len(loads):
        return None
    if not ASSUMED.keys() & effect.shape.keys() and effect.shape.get("weights", known.weights) != 1.0:
        return None
    own = own_load(robot, joint, {**effect.shape, "weights": 1.0})
    load = tau(actuated_joint(joint))
    turned = {q(k + 1): angles[:, k] for k in range(angles.shape[1])}
    if own == 0 or not formula.free_symbols <= {load, *turned}:
        return None
    weight = _values(own, turned, len(loads))
    start = -_values(formula, {**turned, load: -weight}, len(loads))
    whole = weight + loads
    grid = np.linspace(whole.min(), whole.max(), _GRID)
    first = {symbol: np.full(_GRID, x[0]) for symbol, x in turned.items()}
    along = _values(formula, {**first, load: grid - weight[0]}, _GRID) + start[0]
    return WholeLoad(weight, start, (grid, along))


def _values(expression: sp.Expr, at: dict[sp.Symbol, Array], count: int) -> Array:
    found = np.asarray(walk(expression, at, NumpyAlgebra()), dtype=float)
    return np.asarray(np.broadcast_to(found, (count,)))
