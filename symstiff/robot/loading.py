"""Robot files: TOML in, a validated Robot out; every mistake is one line that names file, key and remedy."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from symstiff.errors import UserError
from symstiff.robot.schema import Robot

_MAX_BYTES = 1_000_000


def library() -> tuple[str, ...]:
    """Names of the built-in robots, sorted."""
    folder = resources.files("symstiff.robot") / "library"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")))


def load(robot: str | Path) -> Robot:
    """Read a robot from the library by name, or from a file by path. Raises UserError."""
    name = str(robot)
    if name in library():
        return _library_robot(name)
    path = Path(robot)
    if not path.exists() and path.suffix != ".toml":
        raise UserError(f"no robot {name!r}: give a path to a robot file or one of {', '.join(library())}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{name}: cannot read the robot file: {error.strerror}") from error
    return parse(data, name)


@cache
def _library_robot(name: str) -> Robot:
    return parse(
        (resources.files("symstiff.robot") / "library" / f"{name}.toml").read_bytes(), f"{name}.toml"
    )


def parse(data: bytes, origin: str = "robot file") -> Robot:
    """Validate the bytes of a robot file; ``origin`` stands in messages. Raises UserError."""
    if len(data) > _MAX_BYTES:
        raise UserError(f"{origin}: larger than {_MAX_BYTES} bytes: not a robot file")
    try:
        table = tomllib.loads(data.decode("utf-8"), parse_float=str)
    except UnicodeDecodeError as error:
        raise UserError(f"{origin}: not a text file in UTF-8 (byte {error.start})") from error
    except (tomllib.TOMLDecodeError, ValueError, RecursionError) as error:
        raise UserError(f"{origin}: not valid TOML: {error}") from error
    return from_table(table, origin)


def from_table(table: dict[str, Any], origin: str = "robot") -> Robot:
    """Validate a robot given as nested dictionaries. Raises UserError."""
    try:
        return Robot.model_validate(table)
    except UserError as error:
        raise UserError(f"{origin}: {error}") from error
    except ValidationError as error:
        raise UserError(f"{origin}: {explain(error)}") from error


def explain(error: ValidationError) -> str:
    """Say the first mistake of a pydantic error: its key, what is wrong, what to do."""
    details = error.errors()[0]
    parts = [str(p) if isinstance(p, str) else f"[{p + 1}]" for p in details["loc"]]
    key = ".".join(parts).replace(".[", "[")
    kind, message = details["type"], details["msg"].removeprefix("Value error, ")
    if kind == "extra_forbidden":
        message = "unknown key: remove it or correct its spelling"
    elif kind == "missing":
        message = "missing: add it"
    elif kind == "string_pattern_mismatch":
        message = f"{details['input']!r} is no identifier: use [a-z][a-z0-9_]*"
    elif kind == "too_short" and key == "joint":
        message = "a robot has at least one [[joint]]"
    elif kind == "too_long" and key == "joint":
        message = f"{details['ctx']['actual_length']} joints: at most {details['ctx']['max_length']}"
    elif kind == "literal_error":
        message = f"{details['input']!r}: use {details['ctx']['expected']}"
    return f"{key}: {message}" if key else message
