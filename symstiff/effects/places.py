"""Effects and their places in words, and places as parts of names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

DETAILS = {"harmonics": "({} a turn)"}
"""Keys beside a place that say which of several effects is there, with their words; no parameter's name holds them."""
_WORDS = {
    "joint": "at joint {}", "link": "at link {}", "joints": "between joints {}", "load": "({})",
    "measurement": "(measuring {})", "rows": "(pose {})", "robot": "", **DETAILS,
}  # fmt: skip
_THINGS = ("load", "measurement")
"""Keys whose values are words of their own."""


def plain(where: Mapping[str, Any]) -> dict[str, Any]:
    """A place as a file holds it: lists, and none of NumPy's types."""
    return {key: _plain(value) for key, value in where.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def site(where: Mapping[str, Any]) -> dict[str, Any]:
    """The place alone, without details."""
    return {key: value for key, value in where.items() if key not in DETAILS}


def place_name(where: Mapping[str, Any]) -> str:
    """A place as part of a parameter's name: ``3``, ``4_5``, ``force_sensor``."""
    parts: list[str] = []
    for value in site(where).values():
        parts += [str(v) for v in value] if isinstance(value, list | tuple) else [str(value)]
    return "_".join(parts)


def place(where: Mapping[str, Any]) -> str:
    """A place as words: ``at joint 2``, ``between joints 4, 5``, ``(force sensor)``."""
    parts = []
    for key, value in where.items():
        shown = ", ".join(str(v) for v in value) if isinstance(value, list | tuple) else str(value)
        shown = shown.replace("_", " ") if key in _THINGS else shown
        parts.append(_WORDS[key].format(shown) if key in _WORDS else f"{key} {shown}")
    return " ".join(p for p in parts if p)


def spoken(effect: str) -> str:
    """An effect's identifier as words."""
    return effect.replace("_", " ")


def named(effect: str, where: Mapping[str, Any]) -> str:
    """An effect at its place: ``gravity compensator at joint 2``."""
    return f"{spoken(effect)} {place(where)}".strip()
