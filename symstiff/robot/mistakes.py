"""A validation error in one line: the key as its file writes it, what is wrong, what to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from pydantic import ValidationError

from symstiff.errors import did_you_mean, printable
from symstiff.robot.exact import shown
from symstiff.robot.schema import KEYS

_ROWS = ("joint", "marker", "template")  # arrays of tables


def explain(error: ValidationError) -> str:
    """Say the mistake of a pydantic error that most likely caused the others."""
    details = min(error.errors(include_url=False), key=lambda d: _urgency(cast(Mapping[str, Any], d)))
    key = _key(details["loc"])
    message = _message(cast(Mapping[str, Any], details))
    return f"{key}: {message}" if key else message


def _urgency(details: Mapping[str, Any]) -> int:
    """Of several mistakes, an unknown format, then a misspelt key, explains the rest."""
    if details["loc"] == ("format",):
        return 0
    return 1 if details["type"] == "extra_forbidden" else 2


def _key(location: tuple[int | str, ...]) -> str:
    """A place such as ``joint[3].link.mass``, counted from one."""
    text = ""
    for part in location:
        text += f"[{part + 1}]" if isinstance(part, int) else f".{printable(part, 40)}"
    return text.removeprefix(".")


def _message(details: Mapping[str, Any]) -> str:
    """What is wrong and what to do."""
    kind, name, value = details["type"], details["loc"][-1] if details["loc"] else "", details["input"]
    match kind:
        case "value_error":
            return str(details["ctx"]["error"])
        case "extra_forbidden":
            return _unknown(str(name))
        case "missing" if name == "format":
            return "missing: add format = 1"
        case "missing" if details["loc"] in [(row,) for row in _ROWS]:
            return f"missing: add a [[{name}]]"
        case "missing":
            return "missing: add it"
        case "too_short" if name == "joint":
            return "a robot has at least one [[joint]]"
        case "too_short" | "too_long":
            bound = "at least" if kind == "too_short" else "at most"
            limit = details["ctx"].get("min_length" if kind == "too_short" else "max_length")
            return f"{details['ctx']['actual_length']} entries: give {bound} {limit}"
        case "tuple_type" if name in _ROWS:
            return f"expected an array of tables: write [[{name}]]"
        case "tuple_type":
            return f"expected an array [...], found {shown(value)}"
        case "model_type" | "model_attributes_type" | "dict_type":
            return f"expected a table, found {shown(value)}"
        case "string_pattern_mismatch":
            return f"{shown(value)} is no identifier: use {details['ctx']['pattern'].strip('^$')}"
        case "string_type":
            return f"expected text in quotes, found {shown(value)}"
        case "int_type" | "int_parsing" | "int_from_float":
            return f"expected an integer, found {shown(value)}"
        case "greater_than_equal" | "greater_than" | "less_than_equal" | "less_than":
            way = (
                "at least" if kind == "greater_than_equal" else "at most" if kind == "less_than_equal" else ""
            )
            limit = next(iter(details["ctx"].values()))
            return f"{shown(value)}: give {way or kind.split('_')[0] + ' than'} {limit}"
        case "literal_error":
            return f"{shown(value)}: use {details['ctx']['expected']}"
    return printable(f"{details['msg']}, found {shown(value)}", 200)


def _unknown(name: str) -> str:
    if name in KEYS:
        return "this key belongs in another table: move it or remove it"
    return f"unknown key: {did_you_mean(name, KEYS) or 'remove it'}".rstrip()
