"""What a robot file's entries are: lengths, angles, masses, compliances, names; checked as they are read."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PlainValidator

from symstiff.errors import UserError
from symstiff.robot.exact import Exact, parse_exact, shown
from symstiff.robot.names import free_name

LONGEST = 20.0  # m; anything beyond is a length in millimetres
WIDEST = 8 * math.pi  # rad; joint limits beyond four turns are degrees
_HEAVIEST = 100_000.0  # kg
_DIGITS = 1e-9  # rad; a decimal closer to such a multiple is this multiple, written with all its digits
_RESIDUE, _TENS = 1e-9, 6
"""A beam's direction: rounding beside its largest component, and powers of ten that it keeps."""
_SOFTEST = 1000.0  # rad/(N·m) or m/N; anything beyond is a stiffness

Triple = tuple[Exact, Exact, Exact]
ZERO = Exact()


def _format(value: Any) -> Any:
    if type(value) is not int or value != 1:
        raise UserError(f"{shown(value)}: this program reads format 1: write format = 1")
    return value


def _length(value: Any) -> Exact:
    number = parse_exact(value)
    if abs(float(number)) > LONGEST:
        raise UserError(
            f"{float(number):g} m is longer than any robot: lengths are in metres, not millimetres"
        )
    return number


def _angle(value: Any) -> Exact:
    number = parse_exact(value)
    if abs(float(number)) > 2 * math.pi + 1e-9:
        raise UserError(f'{float(number):g} looks like degrees: angles are in radians, e.g. "-pi/2"')
    return in_parts_of_pi(number)


def in_parts_of_pi(angle: Exact, parts: int = 12) -> Exact:
    """The multiple of pi/parts that a decimal stands for: 1.5707963267948966 is a quarter turn."""
    meant = Exact(pi=Fraction(round(float(angle) / (math.pi / parts)), parts))
    return meant if not angle.pi and abs(float(angle) - float(meant)) < _DIGITS else angle


def _finite(value: Any) -> float:
    return float(parse_exact(value))


def _free_length(value: Any) -> float:
    number = _metres(value)
    if number < 0:
        raise UserError(f"a spring's free length is not negative, found {number:g}")
    return number


def _lever(value: Any) -> float:
    number = _metres(value)
    if number <= 0:
        raise UserError(f"a spring's lever is longer than nothing, found {number:g}")
    return number


def _metres(value: Any) -> float:
    return float(_length(value))


def _mass(value: Any) -> float:
    number = _finite(value)
    if not 0 <= number <= _HEAVIEST:
        raise UserError(f"a mass is between 0 and {_HEAVIEST:g} kg, found {number:g}")
    return number


def _compliance(value: Any) -> float:
    number = _finite(value)
    if number < 0:
        raise UserError(f"a compliance is not negative, found {number:g}")
    return _entry(number)


def _entry(value: Any) -> float:
    return not_a_stiffness(_finite(value))


def not_a_stiffness(compliance: float) -> float:
    """The compliance; UserError where it is too large for one."""
    if abs(compliance) > _SOFTEST:
        raise UserError(
            f'{compliance:g} looks like a stiffness: give its inverse, e.g. "1/{abs(compliance):g}"'
        )
    return compliance


def _beam_axis(value: Any) -> Any:
    if value is None or (isinstance(value, str) and value in ("x", "y", "z")):
        return value
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise UserError(f'use "x", "y", "z" or a direction such as [0.35, 0, 0.675], found {shown(value)}')
    direction = tuple(parse_exact(component) for component in value)
    if not any(direction):
        raise UserError('a beam\'s direction cannot be the zero vector: use "x", "y", "z" or a direction')
    sizes = [abs(float(component)) for component in direction]
    cut = tuple(x if size > _RESIDUE * max(sizes) else ZERO for x, size in zip(direction, sizes, strict=True))
    tens = round(math.log10(max(sizes)))
    return cut if abs(tens) <= _TENS else tuple(x * Exact(Fraction(10) ** -tens) for x in cut)


def _readable(value: str) -> str:
    if not value.isprintable() or len(value) > 1000:
        raise UserError("use one line of at most 1000 printable characters")
    return value


Format = Annotated[Literal[1], BeforeValidator(_format)]
Length = Annotated[Exact, BeforeValidator(_length)]
Angle = Annotated[Exact, BeforeValidator(_angle)]
Number = Annotated[float, BeforeValidator(_finite)]
Metres = Annotated[float, BeforeValidator(_metres)]
FreeLength = Annotated[float, BeforeValidator(_free_length)]
Lever = Annotated[float, BeforeValidator(_lever)]
Mass = Annotated[float, BeforeValidator(_mass)]
Compliance = Annotated[float, BeforeValidator(_compliance)]
Entry = Annotated[float, BeforeValidator(_entry)]
Text = Annotated[str, AfterValidator(_readable)]
Identifier = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,62}$")]
Name = Annotated[Identifier, AfterValidator(free_name)]
BeamAxis = Annotated[Literal["x", "y", "z"] | Triple | None, PlainValidator(_beam_axis)]
