"""The weight of a link as a load on every virtual joint before its DH frame: mass and first moment."""

from __future__ import annotations

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import ABSOLUTE
from symstiff.effects.weights import weight
from symstiff.robot.schema import Robot

NAME = "link_weight"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    link = int(where["link"])
    low = -robot.links[link].mass if robot.links[link].mass else 0.0
    return weight(NAME, where, robot, link, low)


EFFECT = Effect(
    identifier=NAME,
    title="Weight of a link",
    description="The link's own weight bends everything between it and the base; nothing of it shows "
    "in deflections.",
    seen_in=ABSOLUTE,
    places=lambda robot: tuple({"link": i} for i in range(1, robot.dof + 1)),
    realise=_realise,
    confused_with=("payload_error", "geometric_error", "joint_offset"),
    separated_by="several payloads, and poses near and far from the axis",
)
