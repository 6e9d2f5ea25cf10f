"""All data of one pose shifted: a bump, a lost reflector, a wrong line in the table."""

from __future__ import annotations

import numpy as np

from symstiff.effects.base import Effect, Realisation, Shape, Situation, Where
from symstiff.effects.common import BOTH, XYZ, parameter
from symstiff.errors import UserError
from symstiff.robot.schema import Robot

NAME = "bad_poses"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    if not isinstance(where.get("rows"), list | tuple):
        raise UserError("a bad pose is told by the labels of its rows: give {'rows': ['p4']}")
    shift = tuple(parameter(NAME, where, x, "m", -1.0, 1.0, 1e-3) for x in XYZ)
    return Realisation(shift, ())


def _places(situation: Situation) -> tuple[Where, ...]:
    return tuple({"rows": [label]} for label in situation.labels)


def _columns(situation: Situation, where: Where, shape: Shape) -> np.ndarray:
    numbers = [k for k, label in enumerate(situation.labels) if label in where["rows"]]  # new poses are sound
    hit = np.isin(situation.row_pose, numbers)
    return np.stack([hit & (situation.row_axis == axis) for axis in range(3)], axis=1).astype(float)


EFFECT = Effect(
    identifier=NAME,
    title="A bad pose",
    description="The measured points of one pose are shifted together; nothing about the robot.",
    seen_in=BOTH,
    places=lambda robot: (),
    realise=_realise,
    confused_with=("thermal_drift", "joint_offset", "geometric_error"),
    separated_by="measuring the pose again",
    columns=_columns,
    places_in=_places,
)
