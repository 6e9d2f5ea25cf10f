"""A measuring device whose axes are turned against the base: the measured vector is d + δ × d.

In absolute data the placement of the device, six numbers, is always estimated.
"""

from __future__ import annotations

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import DEFLECTION, XYZ, couple, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, VirtualJoint, deflection

NAME = "frame_misalignment"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    parameters, terms = [], []
    for k, axis in enumerate(XYZ):
        p = parameter(NAME, where, f"r{axis}", "rad", -0.2, 0.2, 0.01)
        parameters.append(p)
        turn = [int(k == i) for i in range(3)]
        for first in (0, 3):
            for i, change in enumerate(couple(turn, [deflection(first + n) for n in (1, 2, 3)])):
                if change != 0:
                    terms.append(Term(p.name, VirtualJoint("measure", 0, first + i + 1), change))
    return Realisation(tuple(parameters), tuple(terms))


EFFECT = Effect(
    identifier=NAME,
    title="Misalignment of the measuring frame",
    description="The device's axes are turned against the base axes in which deflections are told.",
    seen_in=DEFLECTION,
    places=lambda robot: ({"measurement": "frame"},),
    realise=_realise,
    confused_with=("force_sensor_misalignment", "link_asymmetry", "joint_offset", "geometric_error"),
    separated_by="loads in several directions",
)
