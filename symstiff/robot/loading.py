"""Robot files: TOML in, a validated Robot out; every mistake is one line that names file, key and remedy."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from symstiff.arguments import require, require_path
from symstiff.errors import UserError, did_you_mean, printable
from symstiff.robot.exact import Decimal
from symstiff.robot.mistakes import explain
from symstiff.robot.schema import Robot

_MAX_BYTES = 250_000
_MAX_LINE = 2000


def library() -> tuple[str, ...]:
    """Names of the built-in robots, sorted."""
    folder = resources.files("symstiff.robot") / "library"
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")))


def load(robot: str | Path) -> Robot:
    """Read a robot from the library by name, or from a file by path. Raises UserError."""
    require_path(robot, "a robot file")
    name = str(robot)
    if not name:
        raise UserError(
            "the robot's name is empty: give a path to a robot file, or one of " + ", ".join(library())
        )
    if name in library():
        return _library_robot(name)
    return parse(_read(Path(robot)), name)


@cache
def _library_robot(name: str) -> Robot:
    file = resources.files("symstiff.robot") / "library" / f"{name}.toml"
    return parse(file.read_bytes(), f"{name}.toml")


def _read(path: Path) -> bytes:
    name = printable(str(path))
    try:
        with path.open("rb") as file:
            return file.read(_MAX_BYTES + 1)
    except IsADirectoryError as error:
        raise UserError(f"{name}: is a directory: give a robot file (.toml)") from error
    except FileNotFoundError as error:
        known = library()
        what = "robot file" if path.suffix else "robot"
        raise UserError(
            f"{name}: no such {what}: {did_you_mean(name, known)}give a path to a robot file, or one of "
            f"{', '.join(known)}"
        ) from error
    except OSError as error:
        raise UserError(f"{name}: cannot read the robot file: {error.strerror}: check the path") from error
    except ValueError as error:  # a NUL or a lone surrogate
        raise UserError(f"{name}: is no path: {error}") from error


def parse(data: bytes, origin: str = "robot file") -> Robot:
    """Validate the bytes of a robot file; ``origin`` stands in messages. Raises UserError."""
    require(data, bytes, "the bytes of a robot file", "load('robot.toml') reads one")
    origin = printable(origin)
    return from_table(toml_table(data, origin, "robot file", Decimal), origin)


def toml_table(
    data: bytes, origin: str, what: str, parse_float: Callable[[str], Any] = float
) -> dict[str, Any]:
    """The table in the bytes of a TOML file; ``what`` is the kind of file that was expected. Raises UserError."""
    if len(data) > _MAX_BYTES:
        raise UserError(f"{origin}: larger than {_MAX_BYTES} bytes: not a {what}")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(
            f"{origin}: not a text file in UTF-8 (byte {error.start}): save it as UTF-8"
        ) from error
    # A key of thousands of dotted parts takes the TOML parser minutes.
    for number, line in enumerate(text.split("\n"), start=1):
        if len(line) > _MAX_LINE:
            raise UserError(f"{origin}: line {number} is longer than {_MAX_LINE} characters: not a {what}")
    try:
        return tomllib.loads(text, parse_float=parse_float)
    except RecursionError as error:
        raise UserError(f"{origin}: not valid TOML: arrays or tables nested too deeply") from error
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{origin}: not valid TOML: {printable(str(error), 200)}") from error
    except ValueError as error:  # an integer of thousands of digits, a date that does not exist
        raise UserError(f"{origin}: not valid TOML: a number or date out of range") from error


def from_table(table: dict[str, Any], origin: str = "robot") -> Robot:
    """Validate a robot given as nested dictionaries. Raises UserError."""
    require(table, Mapping, "a robot as a table", "load('kuka_kr270') gives a robot by its name")
    if "robot" in table and "parameters" in table:
        raise UserError(
            f"{printable(origin)}: is a model, not a robot: name the robot or its file, and give the model with "
            "--model (generate) or --start (identify, diagnose)"
        )
    try:
        return Robot.model_validate(table)
    except ValidationError as error:
        raise UserError(f"{printable(origin)}: {explain(error)}") from error
