"""Friction lags behind the load: Δθ_j = −branch·width/2·h(τ), less deflection on the way up than down.

h is a smooth sign of the load, times |τ/τ₀|^power, or times 1 − (τ/τ₀)² where the loop closes at its ends. The load
is the one that the experiment adds, or with ``weights`` in the shape the total one, the links' weight included, or
with ``mass``, ``tapered_mass`` or ``beside_axis`` that of an assumed arm or body where the file tells no masses.

With ``knee`` r the loop closes at the load where it turned, τ_T (Masing's rule): an arm at rest gives way by
−width/2·τ/(r + |τ|) as the load grows, and on the way back follows the same curve from there, twice as large in both
directions: width·(τ_T − τ)/(2r + |τ_T − τ|) more. What the experiment adds turned at ``turn`` times its present size,
the weight does not turn: τ_T = τ_weight + turn·(τ − τ_weight). In positions τ holds the weight, which ``weights = -1``
tells; deflections are what the loop gives beyond that of the unloaded arm.
"""

from __future__ import annotations

import sympy as sp

from symstiff.effects.arm import ARM_MOVES, ASSUMED, TOLD, assumed_arms, most_weight_load, odds, own_load
from symstiff.effects.base import Effect, Move, Realisation, Scales, Shape, Where
from symstiff.effects.common import (
    BOTH,
    NEAR_ZERO,
    above_zero,
    angle_unit,
    exponent,
    joints,
    load_of,
    over,
    parameter,
    raised,
    size,
    smooth_sign,
)
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import BRANCH, TURN, Term, actuated_joint

NAME = "hysteresis"
WIDTHS, POWERS = (0.02, 0.15), (0.0, 0.5, 1.0)
KNEES = (0.05, 0.15, 0.4, 1.0)
"""Loads, of the largest, at which half of a loop is open."""
SHARP = 0.002
"""Width of a step that no measured load is near."""
WITHIN = -1.0
"""The entry ``weights`` where the load holds the links' weight: in positions of a robot with masses."""


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    j = int(where["joint"])
    load, width, own = load_of(j), above_zero(shape, "width", 5.0), sp.S.Zero
    if shape.get("weights") or ASSUMED.keys() & shape.keys():
        own = own_load(robot, j, shape)
    within = shape.get("weights") == WITHIN
    loop = parameter(NAME, where, "width", angle_unit(robot, j), 0.0, 5e-3, 5e-5)
    if "knee" in shape:
        law = _masing(load - own if within else load, own, above_zero(shape, "knee"), within)
        return Realisation((loop,), (Term(loop.name, actuated_joint(j), law),))
    load = load if within else load + own
    law = -BRANCH * smooth_sign(load, width) / 2
    scale = above_zero(shape, "load", 1.0)
    if shape.get("power"):
        law *= raised(_square(load, scale) + NEAR_ZERO**2, exponent(shape, "power") / 2)
    if "loop" in shape:
        law *= 1 - _square(load, above_zero(shape, "loop"))
    return Realisation((loop,), (Term(loop.name, actuated_joint(j), law),))


def _masing(added: sp.Expr, own: sp.Expr, knee: sp.Rational, whole: bool) -> sp.Expr:
    """−τ_T/(r + |τ_T|)/2 for a loop of unit width, and back from there by (τ_T − τ)/(2r + |τ_T − τ|).

    The load is its ``own`` weight and what is ``added``; not the ``whole`` of it: less what the weight does alone.
    """
    back = (TURN - 1) * added
    law = back / (2 * knee + size(back)) + _rest(own + TURN * added, knee)
    return law if whole or own == 0 else law - _rest(own, knee)


def _rest(load: sp.Expr, knee: sp.Rational) -> sp.Expr:
    """How a loop of unit width begins from rest: −τ/(r + |τ|)/2."""
    return -load / (2 * (knee + size(load)))


def _square(load: sp.Expr, scale: sp.Rational) -> sp.Expr:
    return raised(over(load, scale), sp.Integer(2))


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    joint = int(where["joint"])
    top = scales.of(actuated_joint(joint))
    widths = [float(f"{f * top:.3g}") for f in WIDTHS]
    grown: list[Shape] = [{"load": top, "power": p} if p else {} for p in POWERS]
    found: list[Shape] = [{"width": s, **power} for s in widths for power in grown]
    narrow = found[: len(POWERS)]
    found.append({"width": float(f"{SHARP * top:.3g}")})
    closed = {"width": widths[0]}
    within: Shape = {"weights": WITHIN} if scales.kind == "absolute" and robot.has_weights else {}
    if scales.kind == "deflection" and (most := most_weight_load(robot, joint)):
        loop = {**closed, "loop": float(f"{1.05 * (top + most):.3g}")}
        found += [{**s, "weights": 1.0} for s in (*found, loop)]
    found.append({**closed, "loop": float(f"{1.05 * top:.3g}")})
    found += [{"knee": float(f"{f * top:.3g}")} for f in KNEES]
    for arm, most in assumed_arms(robot, joint, scales):
        found += [{**s, **arm} for s in (*narrow, {**closed, "loop": float(f"{1.05 * most:.3g}")})]
    return tuple({**s, **within} for s in found)


EFFECT = Effect(
    identifier=NAME,
    title="Hysteresis of a joint",
    description="Loading and unloading leave the joint in different places under the same load.",
    seen_in=BOTH,
    places=joints,
    realise=_realise,
    shapes=_shapes,
    needs=frozenset({"branch"}),
    confused_with=("backlash", "hysteresis"),
    separated_by="poses in which the neighbouring joints carry loads in other proportions",
    told={
        "width": "turning over within ± {} LOAD", "load": "reference load {} LOAD",
        "power": "wide as the load over it to the power {}",
        "loop": "closed at {} LOAD", "knee": "closed where the load turned, half open {} LOAD from there",
        "weights": "links' weight counted", **TOLD,
    },
    assumed=ASSUMED,
    odds=odds,
    weights=0.0,
    within=WITHIN,
    moves=lambda robot, shape: {"width": Move(2.7), "loop": Move(1.2), "knee": Move(2.7), **ARM_MOVES},
)  # fmt: skip
