"""A gear whose stiffness depends on its load: Δθ_j = c₂·τ·|τ| + c₃·τ³, two slopes, or saturation.

Without a shape the polynomial with c₂ and c₃. Profiled shapes have one parameter c, Δθ_j = c·τ₀·h(τ/τ₀),
with h = sign(x)|x|^power (smooth near zero), x − clip(x, −1, 1) beyond a knee at τ₀, or tanh x; c is a slope
in rad/(N·m) whatever the shape. Where masses are known, τ is the total load and what its weight does alone is
taken away; with ``weights = 0`` in the shape τ is the load that the experiment adds, with ``mass`` or
``tapered_mass`` that load and the weight of an arm of so many kilograms, with ``beside_axis`` that of a body beside
the joint's axis. Between the shapes of the profile only that load is moved, and where a body hangs, not its weight:
a knee or a saturation far below the largest load is backlash.
"""

from __future__ import annotations

from collections.abc import Mapping

import sympy as sp

from symstiff.effects.arm import (
    ARM_MOVES,
    ASSUMED,
    BESIDE_AXIS,
    TOLD,
    TOWARDS,
    assumed_arms,
    odds,
    of_total_load,
    weighed,
    weight_load,
)
from symstiff.effects.base import Effect, Move, Realisation, Scales, Shape, Where
from symstiff.effects.common import (
    BOTH,
    NEAR_ZERO,
    above_zero,
    compliance_unit,
    exponent,
    joints,
    over,
    parameter,
    product,
    raised,
    size,
)
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, actuated_joint

NAME = "nonlinear_stiffness"
POWERS = (2.0, 3.0, 0.5)
KNEES = (0.17, 0.25, 0.35, 0.45, 0.57, 0.72)
SATURATIONS = (0.15, 0.25, 0.4, 0.65)
"""Loads at which a gear bends or saturates, as shares of the largest: what saturates far below is backlash."""


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    j = int(where["joint"])
    at, unit = actuated_joint(j), compliance_unit(robot, j)
    if "load" not in shape:
        c2 = parameter(NAME, where, "c2", _per_load(unit, 2), -1e-6, 1e-6, 1e-10, "of load*|load|")
        c3 = parameter(NAME, where, "c3", _per_load(unit, 3), -1e-8, 1e-8, 1e-13, "of load^3")
        laws = (lambda x: x * size(x), lambda x: raised(x, sp.Integer(3)))
        terms = [
            Term(p.name, at, of_total_load(law, robot, j, shape))
            for p, law in zip((c2, c3), laws, strict=True)
        ]
        return Realisation((c2, c3), tuple(terms))
    scale = above_zero(shape, "load")
    c = parameter(NAME, where, "c", unit, -1e-2, 1e-2, 1e-7)
    law = of_total_load(lambda x: product(scale, _bend(over(x, scale), shape)), robot, j, shape)
    return Realisation((c,), (Term(c.name, at, law),))


def _per_load(unit: str, power: int) -> str:
    """Unit of a coefficient of the load's power: rad/(N*m)^2, m/N^3."""
    return f"{unit}^{power}"


def _bend(x: sp.Expr, shape: Shape) -> sp.Expr:
    if "knee" in shape:
        return x - (size(x + 1) - size(x - 1)) / 2
    if "saturation" in shape:
        return sp.tanh(x, evaluate=False)
    power = exponent(shape, "power")
    if power == 2:
        return x * size(x)
    if power.is_odd:
        return raised(x, power)
    return product(x, raised(raised(x, sp.Integer(2)) + NEAR_ZERO**2, (power - 1) / 2))


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    joint = int(where["joint"])
    at = actuated_joint(joint)
    readings = [(weighed(scales.kind), scales.of_total(at))]
    if scales.kind == "deflection" and weight_load(robot, joint) != 0:
        # a balancer may carry the weight: the gear then sees the load alone
        readings.append(({"weights": 0.0}, scales.of(at)))
    known = tuple({**shape, **reading} for reading, top in readings for shape in _bends(top))
    return known + tuple(s for arm in assumed_arms(robot, joint, scales) for s in _under(*arm))


def _bends(top: float) -> list[Shape]:
    """The shapes of a gear whose largest load is ``top``."""
    found: list[Shape] = [{"load": top, "power": p} for p in POWERS]
    found += [{"load": float(f"{f * top:.3g}"), "knee": 1.0} for f in KNEES]
    return found + [{"load": float(f"{f * top:.3g}"), "saturation": 1.0} for f in SATURATIONS]


def _under(arm: Shape, most: float) -> tuple[Shape, ...]:
    """The shapes under an arm whose masses are not known, and the largest load on the joint under it.

    Bodies beside the axis are many, and have fewer of them.
    """
    most = float(f"{most:.3g}")
    knees, saturations = (
        (KNEES[2:3], SATURATIONS[1:2]) if BESIDE_AXIS in arm else (KNEES[::3], SATURATIONS[::2])
    )
    found = [{"load": most, "power": p} for p in POWERS[::2]]
    found += [{"load": float(f"{f * most:.3g}"), "knee": 1.0} for f in knees]
    found += [{"load": float(f"{f * most:.3g}"), "saturation": 1.0} for f in saturations]
    return tuple({**shape, **arm} for shape in found)


def _sense(shape: Shape, sizes: Mapping[str, float]) -> str:
    """A term that grows faster than the load softens the gear, one that grows more slowly hardens it."""
    signs = {value > 0 for value in sizes.values() if value}
    slower = "saturation" in shape or float(shape.get("power", 2.0)) < 1.0
    if len(signs) != 1:
        return ""
    return "Here it hardens." if signs == {slower} else "Here it softens."


EFFECT = Effect(
    identifier=NAME,
    title="Stiffness of a joint that depends on its load",
    description="The gear hardens (stiffer under load) or softens; small loads see another slope than "
    "large ones.",
    seen_in=BOTH,
    places=joints,
    realise=_realise,
    shapes=_shapes,
    confused_with=("gravity_compensator", "backlash", "large_deflection", "joint_compliance"),
    separated_by="several load levels at one pose, and the same load at several angles of the joint",
    told={
        "load": "reference load {} LOAD", "power": "load over it to the power {}",
        "knee": "two slopes that meet at it", "saturation": "saturating beyond it", "weights": "", **TOLD,
    },
    assumed=ASSUMED,
    odds=odds,
    weights=1.0,
    sense=_sense,
    moves=lambda robot, shape: {"load": Move(1.6), TOWARDS: ARM_MOVES[TOWARDS]},
)  # fmt: skip
