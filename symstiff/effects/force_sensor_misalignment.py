"""A force sensor mounted askew: the true wrench is the measured one turned by a small angle, ΔW = δ × W."""

from __future__ import annotations

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import DEFLECTION, XYZ, couple, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, VirtualJoint, w

NAME = "force_sensor_misalignment"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    parameters, terms = [], []
    for k, axis in enumerate(XYZ):
        p = parameter(NAME, where, f"r{axis}", "rad", -0.2, 0.2, 0.01)
        parameters.append(p)
        turn = [int(k == i) for i in range(3)]
        for first in (0, 3):
            for i, change in enumerate(couple(turn, [w(first + n) for n in (1, 2, 3)])):
                if change != 0:
                    terms.append(Term(p.name, VirtualJoint("load", 0, first + i + 1), change))
    return Realisation(tuple(parameters), tuple(terms))


EFFECT = Effect(
    identifier=NAME,
    title="Misalignment of the force sensor",
    description="The sensor's axes are turned against the base axes in which the wrench is told.",
    seen_in=DEFLECTION,
    places=lambda robot: ({"load": "force_sensor"},),
    realise=_realise,
    confused_with=("frame_misalignment", "link_asymmetry"),
    separated_by="loads in several directions",
)
