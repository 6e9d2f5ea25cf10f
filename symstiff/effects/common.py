"""What the catalogue's files share: places, names, exact numbers, smooth signs."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import sympy as sp

from symstiff.effects.base import EffectParameter, Shape, Where
from symstiff.effects.places import place_name
from symstiff.robot.schema import Robot
from symstiff.symbolic.chain import ElasticChain, cross
from symstiff.symbolic.terms import AXES, Term, VirtualJoint, actuated_joint, deflection, link_joint, tau, w

GRAVITY = sp.Rational(980665, 100000)  # m/s²
BOTH = frozenset({"deflection", "absolute"})
DEFLECTION = frozenset({"deflection"})
ABSOLUTE = frozenset({"absolute"})
XYZ = "xyz"
_STEEPEST = 10.0
"""Largest power of a load."""
NEAR_ZERO = sp.Rational(1, 1000)
"""Share of a load below which a law with an infinite slope at zero is made smooth: it is differentiated."""


def joints(robot: Robot) -> tuple[Where, ...]:
    """Every actuated joint."""
    return tuple({"joint": j} for j in range(1, robot.dof + 1))


def links(robot: Robot) -> tuple[Where, ...]:
    """Every link, the pedestal included."""
    return tuple({"link": i} for i in range(robot.dof + 1))


def angle_unit(robot: Robot, joint: int) -> str:
    """Unit of a joint's deflection."""
    return "m" if robot.joint[joint - 1].prismatic else "rad"


def compliance_unit(robot: Robot, joint: int) -> str:
    """Unit of a joint's compliance."""
    return "m/N" if robot.joint[joint - 1].prismatic else "rad/(N*m)"


def parameter(
    effect: str,
    where: Where,
    what: str,
    unit: str,
    low: float,
    high: float,
    typical: float,
    meaning: str = "",
) -> EffectParameter:
    """A parameter named ``<effect>_<where>_<what>``."""
    return EffectParameter(f"{effect}_{place_name(where)}_{what}", unit, low, high, typical, meaning)


def exact(value: Any) -> sp.Rational:
    """The decimal number that a float shows, as a fraction."""
    return sp.Rational(repr(float(value)))


def above_zero(shape: Shape, key: str, otherwise: float | None = None) -> sp.Rational:
    """A value of a shape that divides. Raises ValueError where it is not above zero, KeyError where none is told."""
    value = shape[key] if otherwise is None else shape.get(key, otherwise)
    if not float(value) > 0:
        raise ValueError(f"{key} = {float(value)}: give a value above zero")
    return exact(value)


def exponent(shape: Shape, key: str) -> sp.Rational:
    """A power of a shape. Raises ValueError beyond what a law of a load has, KeyError where none is told."""
    if not 0 <= float(shape[key]) <= _STEEPEST:
        raise ValueError(f"{key} = {shape[key]:g}: give one from 0 to {_STEEPEST:g}")
    return exact(shape[key])


def smooth_sign(x: sp.Expr, width: sp.Expr) -> sp.Expr:
    """±1 away from zero, linear within ``width``: tanh(x/width)."""
    return sp.tanh(over(x, width), evaluate=False)


def over(x: sp.Expr, scale: sp.Rational) -> sp.Expr:
    """x/scale with the sum x left whole: what several laws share of it is then read once."""
    return sp.Mul(1 / scale, x, evaluate=False) if x.is_Add else x / scale


def product(a: sp.Expr, b: sp.Expr) -> sp.Expr:
    """a·b, left as it stands."""
    return sp.Mul(a, b, evaluate=False)


def raised(x: sp.Expr, exponent: sp.Expr) -> sp.Expr:
    """x^exponent, left as it stands: SymPy would ask about the signs of all that is in x."""
    return x if exponent == 1 else sp.Pow(x, exponent, evaluate=False)


def size(x: sp.Expr) -> sp.Expr:
    """|x|, left as it stands: SymPy's questions about a weight's sign take seconds."""
    return sp.Abs(x, evaluate=False)


def under_load() -> sp.Expr:
    """1 under any load of some newtons, 0 under none, and level at both, as laws are differentiated there."""
    return sp.tanh(sp.Add(*[w(k) ** 2 for k in AXES]), evaluate=False)


def load_of(joint: int) -> sp.Symbol:
    """τ of an actuated joint."""
    return tau(actuated_joint(joint))


def turned(name: str, axis: int) -> list[Term]:
    """Terms of a device that is turned about one of its axes, 0 to 2: δ × d for translations and rotations."""
    about = [int(axis == i) for i in range(3)]
    return [
        Term(name, VirtualJoint("measure", 0, first + i + 1), change)
        for first in (0, 3)
        for i, change in enumerate(cross(about, [deflection(first + n) for n in (1, 2, 3)]))
        if change != 0
    ]


def link_axes(link: int) -> tuple[VirtualJoint, ...]:
    """The six virtual joints of a link."""
    return tuple(link_joint(link, a) for a in AXES)


@lru_cache(maxsize=64)
def wrench_at(robot: Robot, body: int) -> tuple[sp.Expr, ...]:
    """The load's force (3) and moment (3) about the origin of a body's DH frame, in that frame's axes."""
    along = ElasticChain(robot).exact_axes(body)
    return tuple(
        sp.Add(*[along[k][r] * tau(link_joint(body, k + 1 + h)) for k in range(3)])
        for h in (0, 3)
        for r in range(3)
    )
