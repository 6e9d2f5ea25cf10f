"""A force sensor mounted askew: the true wrench is the measured one turned by a small angle, ΔW = δ × W.

δ is constant in base axes, or with ``tool = 1`` in the shape in the axes of frame n, about its origin, as of a sensor
between flange and tool.
"""

from __future__ import annotations

from symstiff.effects.base import Effect, Realisation, Scales, Shape, Where
from symstiff.effects.common import BOTH, XYZ, parameter, wrench_at
from symstiff.robot.schema import Robot
from symstiff.symbolic.chain import cross
from symstiff.symbolic.terms import AXES, Term, VirtualJoint, w

NAME = "force_sensor_misalignment"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    kind, body = ("body", robot.dof) if shape.get("tool") else ("load", 0)
    wrench = wrench_at(robot, body) if shape.get("tool") else tuple(w(c) for c in AXES)
    parameters, terms = [], []
    for k, axis in enumerate(XYZ):
        p = parameter(NAME, where, f"r{axis}", "rad", -0.2, 0.2, 0.01)
        parameters.append(p)
        turn = [int(k == i) for i in range(3)]
        for first in (0, 3):
            for i, change in enumerate(cross(turn, wrench[first : first + 3])):
                if change != 0:
                    terms.append(Term(p.name, VirtualJoint(kind, body, first + i + 1), change))
    return Realisation(tuple(parameters), tuple(terms))


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    # positions under loads alone hold little of it, and one candidate more hides what they do hold
    return ({}, {"tool": 1.0}) if scales.kind == "deflection" or scales.mixed else ()


EFFECT = Effect(
    identifier=NAME,
    title="Misalignment of the force sensor",
    description="The sensor's axes are turned against the axes in which the wrench is told.",
    seen_in=BOTH,
    places=lambda robot: ({"load": "force_sensor"},),
    realise=_realise,
    shapes=_shapes,
    told={"tool": "in the tool's axes"},
    confused_with=("frame_misalignment", "link_asymmetry", "force_sensor_bias"),
    separated_by="loads in several directions",
)
