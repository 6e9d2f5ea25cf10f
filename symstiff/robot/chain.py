"""A robot as a product of exact elementary motions, whatever DH convention its file uses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from symstiff.robot.exact import Exact
from symstiff.robot.schema import Placement, Robot

Kind = Literal["tx", "ty", "tz", "rx", "ry", "rz"]
ZERO = Exact()


@dataclass(frozen=True)
class Elementary:
    """A translation along [m], or rotation about [rad], one axis of the frame reached so far."""

    kind: Kind
    value: Exact


@dataclass(frozen=True)
class Row:
    """Frame i-1 to frame i: Rz(theta + q)·Tz(d)·Tx(a)·Rx(alpha), or Rz(theta)·Tz(d + q)·… if prismatic."""

    prismatic: bool
    theta: Exact
    d: Exact
    a: Exact
    alpha: Exact


@dataclass(frozen=True)
class Chain:
    """World to frame 0 (``base``), frames 1 to n (``rows``), frame n to the tool centre point (``tool``)."""

    base: tuple[Elementary, ...]
    rows: tuple[Row, ...]
    tool: tuple[Elementary, ...]


def elementary_chain(robot: Robot) -> Chain:
    """Return the robot's standard chain; a modified (Craig) file is the same product, regrouped.

    The first modified row's Rx(alpha)·Tx(a) joins the base; every later row gives its a and alpha to the row
    before it, so that frame i stands at the far end of link i in both conventions.
    """
    shape = [(joint.a, joint.alpha) for joint in robot.joint]
    base = _motions(robot.base)
    if robot.convention == "modified":
        (a, alpha), *shape = shape
        base += _nonzero(("rx", alpha), ("tx", a))
        shape.append((ZERO, ZERO))
    rows = tuple(
        Row(joint.prismatic, joint.theta, joint.d, a, alpha)
        for joint, (a, alpha) in zip(robot.joint, shape, strict=True)
    )
    return Chain(base, rows, _motions(robot.tool))


def _motions(placement: Placement) -> tuple[Elementary, ...]:
    (x, y, z), (roll, pitch, yaw) = placement.xyz, placement.rpy
    return _nonzero(("tx", x), ("ty", y), ("tz", z), ("rz", yaw), ("ry", pitch), ("rx", roll))


def _nonzero(*motions: tuple[Kind, Exact]) -> tuple[Elementary, ...]:
    return tuple(Elementary(kind, value) for kind, value in motions if value)
