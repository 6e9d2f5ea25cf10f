"""What callers of the library pass: taken as it is meant, or refused in one line that says what to pass."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from os import PathLike
from typing import TYPE_CHECKING, Any

from symstiff.errors import UserError

if TYPE_CHECKING:
    import numpy as np

A_ROBOT = ("a robot", "load('kuka_kr270') gives one")
A_TABLE = ("a measurement table", "read_table('data.csv') gives one")
A_CHAIN = ("an elastic chain", "ElasticChain(robot) is one")
A_MODEL = ("a stiffness model", "load_model('model.toml') or StiffnessModel.of(reduction) gives one")
"""What an argument has to be, and what gives one."""


def require(value: Any, kind: type | tuple[type, ...], what: str, remedy: str) -> None:
    """Raise UserError where an argument is of another type: what was expected, what was found, what to do."""
    if not isinstance(value, kind):
        raise UserError(f"expected {what}, found {_shown(value)}: {remedy}")


def require_path(path: Any, what: str) -> None:
    """Raise UserError where an argument is no path."""
    require(path, (str, PathLike), f"the path of {what}", "give it as text or as a Path")


def whole(value: Any, name: str, least: int = 0) -> int:
    """A whole number from ``least`` on. Raises UserError."""
    if not isinstance(value, Integral) or isinstance(value, bool) or int(value) < least:
        raise UserError(f"{name}: expected a whole number from {least} on, found {_shown(value)}")
    return int(value)


def real(value: Any, name: str, what: str) -> float:
    """A number, of which the caller checks the range. Raises UserError."""
    if not isinstance(value, Real) or isinstance(value, bool):
        raise UserError(f"{name}: expected {what}, found {_shown(value)}")
    return float(value)


def number(value: Any, name: str, what: str = "a finite number", above: float = -math.inf) -> float:
    """A finite number above ``above``. Raises UserError."""
    if not above < real(value, name, what) < math.inf:
        raise UserError(f"{name}: expected {what}, found {_shown(value)}")
    return float(value)


def reals(given: Any, name: str, shape: str) -> np.ndarray:
    """An array of real numbers, of which the caller checks the shape. Raises UserError; what is masked is no number."""
    import numpy as np

    try:
        if np.iscomplexobj(given):
            raise TypeError("found complex ones")
        if isinstance(given, np.ma.MaskedArray):
            given = np.ma.filled(given.astype(float), np.nan)
        return np.asarray(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise UserError(f"{name}: expected numbers of shape {shape}: {error}") from error


def listener(progress: Any) -> None:
    """Raise UserError where what is told the progress is no function."""
    if progress is not None and not callable(progress):
        raise UserError(
            f"expected a function that is told the progress, found {_shown(progress)}: leave it out"
        )


def words(values: Any, name: str, example: str) -> tuple[str, ...]:
    """Several texts; one text is not taken for its letters. Raises UserError."""
    several = isinstance(values, Iterable) and not isinstance(values, str | bytes | Mapping)
    listed = tuple(values) if several else ()
    if not several or not all(isinstance(v, str) for v in listed):
        raise UserError(f"{name}: expected a list of texts, found {_shown(values)}: {example} is one")
    return listed


def several(values: Any, kind: type, name: str, example: str) -> tuple[Any, ...]:
    """Several things of one type. Raises UserError."""
    listed = isinstance(values, Iterable) and not isinstance(values, str | Mapping)
    given = list(values) if listed else None
    wrong = [values] if given is None else [v for v in given if not isinstance(v, kind)]
    if wrong:
        raise UserError(f"{name}: expected a list, {example} is one, found {_shown(wrong[0])}")
    return tuple(given or ())


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"a {type(value).__name__}"
