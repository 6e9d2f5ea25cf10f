"""Two joints of the wrist that share gears: the load on one turns the other, Δθ_j = c·τ_k and Δθ_k = c·τ_j.

Where the gears saturate, c·τ₀·tanh(τ/τ₀) takes the place of c·τ, τ with the weight of the links that the file tells.
"""

from __future__ import annotations

from itertools import combinations

import sympy as sp

from symstiff.effects.arm import of_total_load, weighed
from symstiff.effects.base import Effect, Move, Realisation, Scales, Shape, Where
from symstiff.effects.common import BOTH, above_zero, load_of, over, parameter, product
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, actuated_joint

NAME = "wrist_coupling"
SATURATIONS = (0.2, 0.5)
"""Loads from which the gears saturate, as shares of the largest on either joint."""


def _places(robot: Robot) -> tuple[Where, ...]:
    """Pairs of the last three joints that turn: a SCARA's arms may share belts as a wrist shares gears."""
    turning = [j for j, joint in enumerate(robot.joint, start=1) if not joint.prismatic][-3:]
    return tuple({"joints": [j, k]} for j, k in combinations(turning, 2))


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    j, k = (int(x) for x in where["joints"])
    c = parameter(NAME, where, "c", "rad/(N*m)", -1e-3, 1e-3, 1e-6)
    there = (Term(c.name, actuated_joint(to), _load(robot, by, shape)) for to, by in ((j, k), (k, j)))
    return Realisation((c,), tuple(there))


def _load(robot: Robot, joint: int, shape: Shape) -> sp.Expr:
    if "saturation" not in shape:
        return load_of(joint)
    scale = above_zero(shape, "saturation")
    return of_total_load(
        lambda x: product(scale, sp.tanh(over(x, scale), evaluate=False)), robot, joint, shape
    )


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    top = max(scales.of(actuated_joint(int(j))) for j in where["joints"])
    found = ({"saturation": float(f"{f * top:.3g}"), **weighed(scales.kind)} for f in SATURATIONS)
    return ({}, *(found if top > 0 else ()))


def _odds(robot: Robot, shape: Shape) -> float:
    """Gears that saturate are as likely, all together, as those that do not."""
    return 1.0 / len(SATURATIONS) if shape else 1.0


EFFECT = Effect(
    identifier=NAME,
    title="Coupling of two wrist joints",
    description="Gears that two wrist joints share, or belts of a SCARA's arms, make each turn under the other's load.",
    seen_in=BOTH,
    places=_places,
    realise=_realise,
    shapes=_shapes,
    confused_with=("joint_compliance", "link_compliance", "link_asymmetry"),
    separated_by="poses in which only one of the two joints is loaded",
    told={"saturation": "saturating beyond {} N·m", "weights": ""},
    odds=_odds,
    weights=1.0,
    moves=lambda robot, shape: {"saturation": Move(1.6)} if shape else {},
)
