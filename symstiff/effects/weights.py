"""Weights as wrenches on a body of the chain: what link weights and payload errors share."""

from __future__ import annotations

from symstiff.effects.arm import heaviest
from symstiff.effects.base import Realisation, Where
from symstiff.effects.common import GRAVITY, XYZ, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.chain import cross
from symstiff.symbolic.terms import Term, VirtualJoint, up


def weight(effect: str, where: Where, robot: Robot, body: int, lightest: float) -> Realisation:
    """Mass [kg] and first moment [kg·m] of a body, in the axes of its DH frame.

    The force is −m·g·up, the moment about the frame's origin is −g·(m·c) × up.
    """
    upward = [up(body, k) for k in (1, 2, 3)]
    most = heaviest(robot)
    farthest = most * robot.reach / 4
    mass = parameter(effect, where, "m", "kg", max(lightest, -most), most, 1.0, "mass")
    terms = [Term(mass.name, VirtualJoint("body", body, k), -GRAVITY * u) for k, u in enumerate(upward, 1)]
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
        unit = [int(k == i) for i in range(3)]
        for i, arm in enumerate(cross(unit, upward)):
            if arm != 0:
                terms.append(Term(moment.name, VirtualJoint("body", body, 4 + i), -GRAVITY * arm))
    return Realisation((mass, *moments), tuple(terms))
