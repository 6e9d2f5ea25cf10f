"""Effects and places in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def spoken(effect: str) -> str:
    """An effect's identifier as words."""
    return effect.replace("_", " ")


def place(where: Mapping[str, Any]) -> str:
    """A place as words: ``at joint 2``, ``at joints 4, 5``, ``of the force sensor``."""
    parts = []
    for key, value in where.items():
        shown = ", ".join(str(v) for v in value) if isinstance(value, list | tuple) else str(value)
        parts.append({
            "joint": f"at joint {shown}", "link": f"at link {shown}", "joints": f"between joints {shown}",
            "harmonics": f"({shown} a turn)", "load": f"({shown.replace('_', ' ')})",
            "measurement": f"(measuring {shown.replace('_', ' ')})", "rows": f"(pose {shown})",
            "robot": "",
        }.get(key, f"{key} {shown}"))  # fmt: skip
    return " ".join(p for p in parts if p)


def named(effect: str, where: Mapping[str, Any]) -> str:
    """An effect at its place: ``gravity compensator at joint 2``."""
    return f"{spoken(effect)} {place(where)}".strip()
