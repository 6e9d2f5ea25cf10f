"""A robot as a nested table of plain values, as its file would have it; exact numbers stay exact."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from symstiff.robot.exact import Exact
from symstiff.robot.frozen import FrozenDict
from symstiff.robot.schema import Link, Robot


def to_table(robot: Robot) -> dict[str, Any]:
    """Return the table from which ``from_table`` makes the same robot; what equals its default is left out."""
    return {"format": 1, **_plain(robot)}


def structure_table(robot: Robot) -> dict[str, Any]:
    """The table of what decides a robot's laws: no words, markers, known compliances, nor limits of joints that turn.

    A slide's limits stay: its stroke is a length of the arm.
    """
    joints = [
        j.model_copy(
            update={
                "compliance": 0.0,
                "limits": j.limits if j.prismatic else None,
                "link": _unknown(j.link),
            }
        )
        for j in robot.joint
    ]
    base = robot.base.model_copy(update={"link": _unknown(robot.base.link)})
    plain = {"title": "", "source": "", "marker": (), "base": base, "joint": tuple(joints)}
    return to_table(robot.model_copy(update=plain))


def _unknown(link: Link) -> Link:
    return link.model_copy(update={"compliance": FrozenDict()})


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        fields = type(value).model_fields
        set_values = {name: getattr(value, name) for name in fields}
        return {n: _plain(v) for n, v in set_values.items() if v is not None and v != fields[n].default}
    if isinstance(value, Exact):
        whole = not value.pi and value.rational.denominator == 1
        return int(value.rational) if whole else str(value)
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value
