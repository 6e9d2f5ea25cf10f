"""Weights as wrenches on a body of the chain: what link weights and payload errors share."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from symstiff.effects.arm import heaviest
from symstiff.effects.base import Realisation, Where
from symstiff.effects.common import GRAVITY, XYZ, exact, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.chain import cross
from symstiff.symbolic.terms import Term, VirtualJoint, up


def weight(
    effect: str, where: Where, robot: Robot, body: int, lightest: float, com: Sequence[float] | None = None,
    there: sp.Expr = sp.S.One,
) -> Realisation:  # fmt: skip
    """Mass [kg] and first moment [kg·m] of a body, in the axes of its DH frame; the mass alone at a known ``com`` [m].

    The force is −m·g·up, the moment about the frame's origin is −g·(m·c) × up, both times ``there``: 0 where the body
    is not.
    """
    upward = [up(body, k) * there for k in (1, 2, 3)]
    most = heaviest(robot)
    farthest = most * robot.reach / 4
    mass = parameter(effect, where, "m", "kg", max(lightest, -most), most, 1.0, "mass")
    terms = [Term(mass.name, VirtualJoint("body", body, k), -GRAVITY * u) for k, u in enumerate(upward, 1)]
    if com is not None:
        return Realisation(
            (mass,), (*terms, *_moment(mass.name, body, cross([exact(c) for c in com], upward)))
        )
    moments = [
        parameter(
            effect,
            where,
            f"m{x}",
            "kg*m",
            -farthest,
            farthest,
            0.5,
            f"first moment along {x} of frame {body}",
        )
        for x in XYZ
    ]
    for k, moment in enumerate(moments):
        terms += _moment(moment.name, body, cross([int(k == i) for i in range(3)], upward))
    return Realisation((mass, *moments), tuple(terms))


def _moment(name: str, body: int, arms: Sequence[sp.Expr]) -> list[Term]:
    return [
        Term(name, VirtualJoint("body", body, 4 + i), -GRAVITY * arm)
        for i, arm in enumerate(arms)
        if arm != 0
    ]
