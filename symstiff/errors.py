"""The one exception that a user's mistake raises, one line and exit code 2 of the command line; checks of arguments."""

from __future__ import annotations

from os import PathLike
from typing import Any


class UserError(ValueError):
    """Input that cannot be used: the message names place, cause and remedy in one line of printable text."""

    def __init__(self, message: str) -> None:
        line = " ".join(message.split())
        super().__init__(printable(line, len(line)))


def printable(text: str, longest: int = 120) -> str:
    """The text without control characters, and cut where it is long."""
    clean = "".join(c if c.isprintable() else "?" for c in text)
    return clean if len(clean) <= longest else f"{clean[: longest - 3]}..."


A_ROBOT = ("a robot", "load('kuka_kr270') gives one")
A_TABLE = ("a measurement table", "read_table('data.csv') gives one")
A_CHAIN = ("an elastic chain", "ElasticChain(robot) is one")
A_MODEL = ("a stiffness model", "load_model('model.toml') or StiffnessModel.of(reduction) gives one")
"""What an argument has to be, and what gives one."""


def require(value: Any, kind: type | tuple[type, ...], what: str, remedy: str) -> None:
    """Raise UserError where an argument is of another type: what was expected, what was found, what to do."""
    if not isinstance(value, kind):
        text = repr(value)
        found = text if len(text) <= 40 else f"a {type(value).__name__}"
        raise UserError(f"expected {what}, found {found}: {remedy}")


def require_path(path: Any, what: str) -> None:
    """Raise UserError where an argument is no path."""
    require(path, (str, PathLike), f"the path of {what}", "give it as text or as a Path")
