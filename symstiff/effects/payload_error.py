"""A tool or payload of another weight than believed: ΔW from Δm and Δ(m·c), behind all springs.

In positions it is a tool, which is always there. With ``loaded = 1`` in the shape it is the load: there where a wrench
is told, and not in the states without one, as deflections have it anyway; with ``at_tcp = 1`` the mass alone is
another, and its place the tool centre point.
"""

from __future__ import annotations

import sympy as sp

from symstiff.effects.base import Effect, Realisation, Scales, Shape, Where
from symstiff.effects.common import BOTH, under_load
from symstiff.effects.weights import weight
from symstiff.robot.schema import Robot
from symstiff.robot.tool import tool_of

NAME = "payload_error"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    com = tool_of(robot) if shape.get("at_tcp") else None
    there = under_load() if shape.get("loaded") else sp.S.One
    return weight(NAME, where, robot, robot.dof, -500.0, com, there)


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    if scales.kind == "deflection":
        return ({},)
    load = ({"loaded": 1.0}, {"loaded": 1.0, "at_tcp": 1.0}) if scales.mixed else ()
    return {}, {"at_tcp": 1.0}, *load


EFFECT = Effect(
    identifier=NAME,
    title="Error of the payload",
    description="Mass and first moment of the tool or payload, in frame n, differ from what was told.",
    seen_in=BOTH,
    places=lambda robot: ({"load": "payload"},),
    realise=_realise,
    shapes=_shapes,
    told={"loaded": "the load's, where there is one", "at_tcp": "at the tool centre point"},
    confused_with=("force_sensor_bias", "link_weight", "geometric_error"),
    separated_by="several payloads, and poses that turn the last joints",
)
