"""A force sensor that does not read zero without load: W + b.

b is constant in base axes, or with ``tool = 1`` in the shape in the axes of frame n, about its origin, as of a sensor
between flange and tool. ``loaded = 1``, in positions: it is there where a wrench is told, and not
in the states without one, as deflections have it anyway.
"""

from __future__ import annotations

import sympy as sp

from symstiff.effects.base import Effect, Realisation, Scales, Shape, Where
from symstiff.effects.common import BOTH, parameter, under_load
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import AXES, WRENCH, Term, VirtualJoint

NAME = "force_sensor_bias"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    kind, body = ("body", robot.dof) if shape.get("tool") else ("load", 0)
    there = under_load() if shape.get("loaded") else sp.S.One
    parameters, terms = [], []
    for what, axis in zip(WRENCH, AXES, strict=True):
        unit, high, typical = ("N", 500.0, 10.0) if axis <= 3 else ("N*m", 200.0, 2.0)
        p = parameter(NAME, where, what, unit, -high, high, typical)
        parameters.append(p)
        terms.append(Term(p.name, VirtualJoint(kind, body, axis), there))
    return Realisation(tuple(parameters), tuple(terms))


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    axes: tuple[Shape, ...] = ({}, {"tool": 1.0})
    if scales.kind == "deflection":
        return axes
    # a wrench that is always there would be a weight, which positions show by itself
    return tuple({**shape, "loaded": 1.0} for shape in axes) if scales.mixed else ()


EFFECT = Effect(
    identifier=NAME,
    title="Bias of the force sensor",
    description="A constant wrench acts in the loaded state on top of what the sensor tells.",
    seen_in=BOTH,
    places=lambda robot: ({"load": "force_sensor"},),
    realise=_realise,
    shapes=_shapes,
    told={"tool": "constant in the tool's axes", "loaded": "where a wrench is told"},
    confused_with=(
        "payload_error",
        "force_sensor_misalignment",
        "backlash",
        "frame_misalignment",
        "bad_poses",
    ),
    separated_by="several load levels, the smallest near zero; its axes: poses that turn the tool",
)
