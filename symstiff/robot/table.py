"""A robot as a nested table of plain values, as its file would have it; exact numbers stay exact."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from symstiff.robot.exact import Exact
from symstiff.robot.schema import Robot


def to_table(robot: Robot) -> dict[str, Any]:
    """Return the table from which ``from_table`` makes the same robot; what equals its default is left out."""
    return {"format": 1, **_plain(robot)}


def structure(robot: Robot) -> dict[str, Any]:
    """The table without words, known compliances and joint limits, which no law of a model depends on."""
    table = to_table(robot)
    _drop(table, "title", "source", "marker")
    for body in (table.get("base", {}), *table["joint"]):
        _drop(body, "limits", "compliance")
        _drop(body.get("link", {}), "compliance")
        if not body.get("link", True):
            del body["link"]
    return table


def _drop(table: dict[str, Any], *keys: str) -> None:
    for key in keys:
        table.pop(key, None)


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
