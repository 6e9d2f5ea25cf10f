"""A tool or payload of another weight than believed: ΔW from Δm and Δ(m·c), behind all springs."""

from __future__ import annotations

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import BOTH
from symstiff.effects.weights import weight
from symstiff.robot.schema import Robot

NAME = "payload_error"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    return weight(NAME, where, robot, robot.dof, -500.0)


EFFECT = Effect(
    identifier=NAME,
    title="Error of the payload",
    description="Mass and first moment of the tool or payload, in frame n, differ from what was told.",
    seen_in=BOTH,
    places=lambda robot: ({"load": "payload"},),
    realise=_realise,
    confused_with=("force_sensor_bias", "link_weight", "geometric_error"),
    separated_by="several payloads, and poses that turn the last joints",
)
