"""The weight of a link as a load on every virtual joint before its DH frame: mass and first moment.

With ``centred = 1`` in the shape the mass alone is another, its centre where the robot file tells it; with
``at_frame = 1`` it is a body at the origin of the link's DH frame, such as the next joint's motor.
"""

from __future__ import annotations

from symstiff.effects.base import Effect, Realisation, Scales, Shape, Where
from symstiff.effects.common import ABSOLUTE
from symstiff.effects.weights import weight
from symstiff.robot.schema import Robot

NAME = "link_weight"
_HEAVY = 100.0
"""Mass of an arm [kg] from which it may have a spring that carries some of it."""


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    link = int(where["link"])
    own = robot.links[link]
    com = own.com if shape.get("centred") else (0.0, 0.0, 0.0) if shape.get("at_frame") else None
    return weight(NAME, where, robot, link, -own.mass, com)


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    told = robot.links[int(where["link"])].mass > 0
    return ({}, {"centred": 1.0}, {"at_frame": 1.0}) if told else ({},)


def _alike(robot: Robot, where: Where, shape: Shape) -> str:
    """The whole arm weighs, and a file without masses tells nothing of it; a spring carries some of a heavy arm."""
    if not robot.has_weights:
        return (
            "the robot file tells no masses, so that the weight of every link is missing, and neighbours' weights look "
            "alike: enter masses and centres of mass and diagnose again"
        )
    if robot.gravity_compensator is not None or sum(link.mass for link in robot.links) < _HEAVY:
        return ""
    return (
        "where the link looks too light, that may be a gravity compensator of which the robot file tells nothing: "
        "enter its joint under [gravity_compensator] and diagnose again"
    )


EFFECT = Effect(
    identifier=NAME,
    title="Weight of a link",
    description="The link's own weight bends everything between it and the base; nothing of it shows "
    "in deflections.",
    seen_in=ABSOLUTE,
    places=lambda robot: tuple({"link": i} for i in range(1, robot.dof + 1)),
    realise=_realise,
    shapes=_shapes,
    told={
        "centred": "its centre of mass where the robot file tells it",
        "at_frame": "a mass at the origin of its frame",
    },
    confused_with=("payload_error", "geometric_error", "joint_offset", "gravity_compensator"),
    separated_by="several payloads, and poses near and far from the axis",
    alike=_alike,
)
