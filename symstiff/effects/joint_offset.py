"""A wrong zero of a joint: Δθ_j = constant."""

from __future__ import annotations

import sympy as sp

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import ABSOLUTE, angle_unit, joints, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, actuated_joint

NAME = "joint_offset"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    j = int(where["joint"])
    offset = parameter(NAME, where, "offset", angle_unit(robot, j), -0.05, 0.05, 1e-3)
    return Realisation((offset,), (Term(offset.name, actuated_joint(j), sp.S.One),))


EFFECT = Effect(
    identifier=NAME,
    title="Offset of a joint",
    description="The joint's zero is not where the controller believes it to be.",
    seen_in=ABSOLUTE,
    places=joints,
    realise=_realise,
    confused_with=("geometric_error", "transmission_error", "frame_misalignment"),
    separated_by="a wide range of the joints on both sides; the first joint's offset is a turn of the "
    "measuring frame",
)
