"""A measuring device whose axes are turned against the base: the measured vector is d + δ × d.

In absolute data the placement of the device, six numbers, is always estimated.
"""

from __future__ import annotations

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import DEFLECTION, XYZ, parameter, turned
from symstiff.robot.schema import Robot

NAME = "frame_misalignment"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    parameters = tuple(parameter(NAME, where, f"r{axis}", "rad", -0.2, 0.2, 0.01) for axis in XYZ)
    terms = tuple(term for k, p in enumerate(parameters) for term in turned(p.name, k))
    return Realisation(parameters, terms)


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
