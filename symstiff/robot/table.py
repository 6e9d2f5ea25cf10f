"""A robot as a nested table of plain values, as its file would have it; exact numbers stay exact."""

from __future__ import annotations

from typing import Any

from symstiff.robot.exact import Exact
from symstiff.robot.schema import Robot


def to_table(robot: Robot) -> dict[str, Any]:
    """Return the table from which ``from_table`` makes the same robot."""
    return _plain(robot.model_dump(exclude_none=True, exclude_defaults=True) | {"format": 1})  # type: ignore[no-any-return]


def _plain(value: Any) -> Any:
    if isinstance(value, Exact):
        whole = not value.pi and value.rational.denominator == 1
        return int(value.rational) if whole else str(value)
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value
