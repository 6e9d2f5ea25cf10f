"""How a size or an option of an effect is written: a number, a list, a table of entries, labels of poses."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from symstiff.errors import UserError, printable

_NOTATION = re.compile(r"^(\w+)(?:\[(\d*)\]|(\{\}))?$")
_POSITIVE = ("knee", "tau0", "tau_ref", "tau_max", "T", "width")
"""Options that a law divides by."""


@dataclass(frozen=True)
class Form:
    """What a value has to be: of a list ``length`` numbers, any number of them for 0."""

    kind: Literal["number", "list", "entries", "labels"] = "number"
    length: int = 0
    positive: bool = False


def form_of_size(notation: str) -> tuple[str, Form]:
    """Name and form of a size: ``c`` a number, ``bias[6]`` a list, ``a[]`` one of any length, ``entries{}``."""
    match = _NOTATION.match(notation)
    assert match is not None, notation
    name, length, entries = match.groups()
    if entries:
        return name, Form("entries")
    return name, Form() if length is None else Form("list", int(length or 0))


def form_of_option(name: str, default: Any) -> Form:
    """Form of an option: that of its default; of any length where this has one entry, labels where it has none."""
    if not isinstance(default, tuple):
        return Form(positive=name in _POSITIVE)
    if not default:
        return Form("labels")
    return Form("list", len(default) if len(default) > 1 else 0)


def formed(value: Any, form: Form, label: str) -> Any:
    """A value as float, array, dictionary of float or tuple of text; a number fills a list.

    Raises UserError that begins with ``label``.
    """
    if form.kind == "list":
        return _list(value, form.length, label)
    if form.kind == "entries":
        if not isinstance(value, Mapping) or not value:
            raise _unlike(label, "a table such as {66 = 1e-7}", value)
        return {str(key): number(v, f"{label}.{printable(str(key), 40)}") for key, v in value.items()}
    if form.kind == "labels":
        labels = value if isinstance(value, list | tuple) else ()
        if not labels or any(isinstance(v, bool) or not isinstance(v, str | int) for v in labels):
            raise _unlike(label, 'a list of labels such as ["p4"]', value)
        return tuple(map(str, labels))
    found = number(value, label)
    if form.positive and found <= 0:
        raise _unlike(label, "a number greater than 0", value)
    return found


def number(value: Any, label: str) -> float:
    """A finite number as float. Raises UserError that begins with ``label``."""
    try:
        found = float(value) if _numeric(value) else math.nan
    except OverflowError:  # an integer of hundreds of digits
        found = math.inf
    if not math.isfinite(found):
        raise _unlike(label, "a finite number", value)
    return found


def _list(value: Any, length: int, label: str) -> Any:
    if _numeric(value):
        return np.full(length or 1, number(value, label))
    items = value if isinstance(value, list | tuple | np.ndarray) else []
    if not len(items) or (length and len(items) != length):
        raise _unlike(label, f"{length} numbers, or one for all" if length else "a list of numbers", value)
    return np.array([number(item, label) for item in items])


def _numeric(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _unlike(label: str, expected: str, value: Any) -> UserError:
    return UserError(f"{label}: expected {expected}, found {printable(repr(value), 40)}")
