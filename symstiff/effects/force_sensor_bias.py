"""A force sensor that does not read zero without load: W + b."""

from __future__ import annotations

import sympy as sp

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import DEFLECTION, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import AXES, Term, VirtualJoint

NAME = "force_sensor_bias"
WHAT = ("fx", "fy", "fz", "mx", "my", "mz")


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    parameters, terms = [], []
    for what, axis in zip(WHAT, AXES, strict=True):
        unit, high, typical = ("N", 500.0, 10.0) if axis <= 3 else ("N*m", 200.0, 2.0)
        p = parameter(NAME, where, what, unit, -high, high, typical)
        parameters.append(p)
        terms.append(Term(p.name, VirtualJoint("load", 0, axis), sp.S.One))
    return Realisation(tuple(parameters), tuple(terms))


EFFECT = Effect(
    identifier=NAME,
    title="Bias of the force sensor",
    description="A constant wrench acts in the loaded state on top of what the sensor tells.",
    seen_in=DEFLECTION,
    places=lambda robot: ({"load": "force_sensor"},),
    realise=_realise,
    needs=frozenset({"load_levels"}),
    confused_with=("backlash", "frame_misalignment", "payload_error", "bad_poses"),
    separated_by="several load levels, the smallest near zero",
)
