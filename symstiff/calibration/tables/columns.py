"""The header of a table: which columns there are, in which units, and what would be implausible in them."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from math import inf
from typing import Literal

from symstiff.calibration.tables.measurements import COMPONENTS, CONTEXT, Kind
from symstiff.calibration.tables.units import FACTORS, LARGEST_LOAD, dimensions, parse_header
from symstiff.errors import UserError, printable
from symstiff.symbolic.terms import WRENCH

_LOADS = {c: "force" if c.startswith("f") else "moment" for c in WRENCH}
_MEASURED = {c: ("angle" if c.startswith("r") else "length") for c in COMPONENTS}
_DEFLECTIONS = {f"d{c}": kind for c, kind in _MEASURED.items()}
_SIGMAS = {f"sigma_{c}": kind for c, kind in _MEASURED.items()}
_TEXT = ("pose", "point", "branch")
_COUNTS = ("load_step", "repeat")
SHOWN = 40
"""Most characters of a header, a cell or a label that a message repeats."""
_JOINT = re.compile(r"^q([1-9]\d{0,3})$", re.ASCII)
_OTHER_BRACKETS = re.compile(r"(\w+)\s*[({<](.+)[)}>]")
_ALIKE = 0.7  # likeness, from 0 to 1, from which a name is taken for a slip of the pen

# Beyond these a number stands in the wrong unit rather than for a robot: SI.
_WIDEST_ANGLE = 12.6  # rad; joints that turn further than two turns each way do not occur
_FARTHEST_TURNED = 1e4  # rad; of a column in degrees, which no other unit is mistaken for
_LONGEST_STROKE = 100.0
_LARGEST_DEFLECTION = 1.0  # m, and rad
_FARTHEST_POINT = 1000.0
_LATEST = 1e11  # s; the years since 1970 are 2e9
_HOTTEST = 1000.0  # degC, K


@dataclass(frozen=True)
class Column:
    """One numeric or text column: its place in the row, unit, factor to SI, and largest plausible value."""

    index: int
    unit: str = ""
    factor: float = 1.0
    limit: float = inf
    complaint: str = ""


@dataclass(frozen=True)
class Columns:
    """The columns of a table by canonical name (``sigma_dx`` is filed as ``sigma_x``)."""

    headers: tuple[str, ...]
    named: dict[str, Column]
    joints: tuple[str, ...]
    joint_units: tuple[str, ...]
    kind: Kind


def read_header(cells: list[str], place: str, purpose: Literal["measured", "poses"]) -> Columns:
    """Understand a header row; ``place`` is file and line for messages. Raises UserError."""
    headers = tuple(cell.strip() for cell in cells)
    if len(headers) == 1 and (";" in headers[0] or "\t" in headers[0]):
        raise UserError(
            f"{place}: columns separated by semicolons or tabs: use commas, and points in numbers"
        )
    named: dict[str, Column] = {}
    for index, header in enumerate(headers):
        name, column = _column(header, index, place)
        if name in named:
            raise UserError(f"{place}: two columns {name!r}: keep one")
        named[name] = column
    if "pose" not in named and purpose == "measured":
        raise UserError(f"{place}: no column 'pose': add one with a label for each robot configuration")
    joints = _joints(named, place)
    joint_units = tuple("rad" if "angle" in dimensions(named[name].unit) else "m" for name in joints)
    return Columns(headers, named, joints, joint_units, _kind(named, place, purpose))


def _column(header: str, index: int, place: str) -> tuple[str, Column]:
    parsed, shown = parse_header(header), printable(header, SHOWN)
    if parsed is None or not parsed.name:
        raise UserError(f"{place}: column {index + 1}: cannot read {shown!r} as a header: write name[unit]")
    name, unit = parsed.name, parsed.unit
    if name.startswith("sigma_d"):
        name = "sigma_" + name.removeprefix("sigma_d")
    if name in _TEXT or name in _COUNTS:
        if unit:
            raise UserError(f"{place}: column {shown}: {name} has no unit: write {name}")
        return name, Column(index)
    allowed = _quantities(name)
    if allowed is None:
        raise UserError(f"{place}: unknown column {shown!r}: {_suggest(name)}")
    units = [u for quantity in allowed for u in FACTORS[quantity]]
    if not unit:
        raise UserError(
            f"{place}: column {shown}: a quantity without a unit: "
            f"write {name}[{units[0]}] (or {', '.join(units[1:])})"
        )
    if unit not in units:
        raise UserError(
            f"{place}: column {shown}: unit {printable(unit, SHOWN)!r} does not fit {name}: "
            f"use one of {', '.join(units)}"
        )
    quantity = next(q for q in allowed if unit in FACTORS[q])
    limit, complaint = _plausible(name, quantity, unit)
    return name, Column(index, unit, FACTORS[quantity][unit], limit, complaint)


def _quantities(name: str) -> tuple[str, ...] | None:
    if _JOINT.match(name):
        return ("angle", "length")
    for table in (_LOADS, _MEASURED, _DEFLECTIONS, _SIGMAS):
        if name in table:
            return (table[name],)
    return {"time": ("time",), "temperature": ("temperature",)}.get(name)


def _suggest(name: str) -> str:
    if name.startswith("#"):
        return "comments are not read: remove such lines, the first one names the columns"
    bracketed = _OTHER_BRACKETS.fullmatch(name)
    if bracketed is not None and _quantities(bracketed[1]) is not None:
        return f"write {bracketed[1]}[{printable(bracketed[2], SHOWN)}]"
    known = ["pose", "q1", "point", *_LOADS, *_DEFLECTIONS, *_MEASURED, *_SIGMAS, *CONTEXT]
    close = difflib.get_close_matches(name.lower(), known, 1, _ALIKE)
    hint = f"did you mean {close[0]!r}? Else " if close else ""
    return f"{hint}leave it out: known are pose, point, q1…, fx…mz, dx…drz or x…rz, sigma_x…, {', '.join(CONTEXT)}"


def _plausible(name: str, quantity: str, unit: str) -> tuple[float, str]:
    """Return the largest believable magnitude in SI and what to say beyond it."""
    if quantity == "angle" and unit != "deg":
        limit = _LARGEST_DEFLECTION if name.startswith(("d", "sigma")) else _WIDEST_ANGLE
        return limit, f"looks like degrees in a column of {unit}: correct the values or write {name}[deg]"
    if quantity == "angle":
        return _FARTHEST_TURNED, "is no angle in degrees: correct the value"
    if quantity == "length":
        if name.startswith(("d", "sigma")):
            limit = _LARGEST_DEFLECTION
        else:
            limit = _LONGEST_STROKE if _JOINT.match(name) else _FARTHEST_POINT
        smaller = "mm" if unit == "m" else "um"
        return limit, f"{unit} is too large for {name}: looks like another unit, e.g. {name}[{smaller}]"
    if quantity in ("force", "moment"):
        return LARGEST_LOAD, f"{unit} is no load a robot carries: correct the value or the unit"
    if quantity == "time":
        return _LATEST, f"{unit} is no time of a measurement: correct the value or the unit"
    return _HOTTEST, f"{unit} is no temperature that a robot has: correct the value or the unit"


def _joints(named: dict[str, Column], place: str) -> tuple[str, ...]:
    numbers = sorted(int(m.group(1)) for name in named if (m := _JOINT.match(name)))
    if not numbers:
        raise UserError(f"{place}: no joint columns: add q1[deg] … qn[deg], one for each joint")
    for expected, number in enumerate(numbers, 1):
        if number != expected:
            raise UserError(f"{place}: column q{number} but no q{expected}: give every joint, q1 to qn")
    return tuple(f"q{number}" for number in numbers)


def _kind(named: dict[str, Column], place: str, purpose: str) -> Kind:
    deflections = [name for name in named if name in _DEFLECTIONS]
    absolutes = [name for name in named if name in _MEASURED]
    if deflections and absolutes:
        raise UserError(
            f"{place}: deflection ({deflections[0]}) and absolute ({absolutes[0]}) data in one table: "
            "keep them in two tables"
        )
    rotations = [name for name in absolutes if name.startswith("r")]
    if rotations and len(rotations) < 3:
        raise UserError(
            f"{place}: column {rotations[0]} without the other two: a rotation vector has rx, ry, rz"
        )
    measured = {name.removeprefix("d") for name in deflections} | set(absolutes)
    for name in named:
        if (
            name in _SIGMAS
            and name.removeprefix("sigma_") not in measured
            and (measured or purpose == "measured")
        ):
            raise UserError(f"{place}: column {name}: its component is not measured: add it or drop {name}")
    if deflections:
        return "deflection"
    if absolutes:
        return "absolute"
    if purpose == "measured":
        raise UserError(
            f"{place}: nothing measured: "
            "add dx[mm], dy[mm], dz[mm] (deflections) or x[mm], y[mm], z[mm] (positions)"
        )
    return "none"
