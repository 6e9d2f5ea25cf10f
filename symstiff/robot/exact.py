"""Exact numbers of robot files: r + s·pi with rational r and s, parsed from text, never evaluated as code."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import date, time
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from symstiff.errors import UserError

if TYPE_CHECKING:
    import sympy

_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TOKEN = re.compile(rf"\s*({_NUMBER}|pi\b|π|[-+*/()])", re.ASCII)
_NON_FINITE = re.compile(r"\s*[+-]?(inf|infinity|nan)\s*", re.IGNORECASE)
_FRACTION = re.compile(r"-?[0-9]{1,400}/[0-9]{1,400}", re.ASCII)  # what a small number is saved as
_MAX_TEXT = 200
_MAX_BITS = 1024  # the greatest number is that of a double
_MAX_EXPONENT = 300


class _ArithmeticError(UserError):
    """Numbers of which an operation makes none."""


@dataclass(frozen=True)
class Exact:
    """The number ``rational + pi·π``, both parts exact fractions."""

    rational: Fraction = Fraction(0)
    pi: Fraction = Fraction(0)

    def __float__(self) -> float:
        return float(self.rational) + float(self.pi) * math.pi

    def __bool__(self) -> bool:
        return bool(self.rational or self.pi)

    def __neg__(self) -> Exact:
        return Exact(-self.rational, -self.pi)

    def __add__(self, other: Exact) -> Exact:
        return Exact(self.rational + other.rational, self.pi + other.pi)

    def __sub__(self, other: Exact) -> Exact:
        return self + (-other)

    def __mul__(self, other: Exact) -> Exact:
        if self.pi and other.pi:
            raise _ArithmeticError("a product of two multiples of pi is no length or angle: write one pi")
        return Exact(self.rational * other.rational, self.rational * other.pi + self.pi * other.rational)

    def __truediv__(self, other: Exact) -> Exact:
        if other.pi:
            raise _ArithmeticError("division by a multiple of pi is no length or angle: write a decimal")
        if not other.rational:
            raise _ArithmeticError("division by zero: write another divisor")
        return Exact(self.rational / other.rational, self.pi / other.rational)

    def __str__(self) -> str:
        if not self.pi:
            return str(self.rational)
        sign = "-" if self.pi < 0 else ""
        numerator, denominator = abs(self.pi.numerator), self.pi.denominator
        times = "" if numerator == 1 else f"{numerator}*"
        over = "" if denominator == 1 else f"/{denominator}"
        part = f"{sign}{times}pi{over}"
        return part if not self.rational else f"{self.rational}{'' if sign else '+'}{part}"

    def sympy(self) -> sympy.Expr:
        """Return the number as an exact SymPy expression."""
        import sympy as sp

        rational = sp.Rational(self.rational.numerator, self.rational.denominator)
        return rational + sp.Rational(self.pi.numerator, self.pi.denominator) * sp.pi


@dataclass(frozen=True)
class Decimal:
    """A TOML float as its file writes it: 0.1 is one tenth, and 1e999999999 has not been expanded."""

    text: str

    def __repr__(self) -> str:
        return self.text


def parse_exact(value: Any) -> Exact:
    """Read an integer, a decimal, or an expression of numbers, pi, ``+ - * / ( )``.

    Raises UserError for anything else: a non-finite number, another name, a malformed expression.
    """
    number = _read(value)
    try:
        float(number)
    except OverflowError:
        raise _infinite(shown(value)) from None
    return number


def shown(value: Any) -> str:
    """A value of a file as a message quotes it: short and printable, whatever it is."""
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return "an array"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, date | time):
        return value.isoformat()
    if isinstance(value, int) and value.bit_length() > _MAX_BITS:
        return "an integer beyond all bounds"
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _read(value: Any) -> Exact:
    match value:
        case Exact():
            return value
        case Decimal(text):
            return _expression(text.replace("_", ""))
        case str():
            return _expression(value)
        case bool():
            raise UserError(f"expected a number, found {shown(value)}")
        case int() if value.bit_length() <= _MAX_BITS:
            return Exact(Fraction(value))
        case Fraction():
            return Exact(value)
        case float() if math.isfinite(value):
            return Exact(Fraction(repr(float(value))))
        case int() | float():
            raise _infinite(shown(value))
    raise UserError(f'expected a number or an expression like "-pi/2", found {shown(value)}')


def _expression(text: str) -> Exact:
    if _NON_FINITE.fullmatch(text):
        raise _infinite(text.strip())
    tokens = _tokens(text)
    try:
        value = _sum(tokens)
    except (_MalformedError, RecursionError):
        raise _unreadable(text) from None
    except _ArithmeticError as error:
        raise UserError(f"{shown(text)}: {error}") from None
    if tokens:
        raise _unreadable(text)
    return value


def _infinite(found: str) -> UserError:
    return UserError(f'expected a finite number, found {found}: write one such as 0.35 or "-pi/2"')


def _unreadable(text: str) -> UserError:
    return UserError(
        f'cannot read {shown(text)} as a number: use integers, decimals, pi, + - * / ( ), e.g. "-pi/2"'
    )


class _MalformedError(Exception):
    """The tokens are no expression."""


def _tokens(text: str) -> list[str]:
    """The tokens of an expression, last one first: ``pop`` takes the next."""
    stripped, found, position = text.strip(), [], 0
    if not stripped or (len(text) > _MAX_TEXT and not _FRACTION.fullmatch(stripped)):
        raise _unreadable(text)
    while position < len(stripped):
        match = _TOKEN.match(stripped, position)
        if match is None:
            raise _unreadable(text)
        found.append(match.group(1))
        position = match.end()
    return found[::-1]


def _sum(tokens: list[str]) -> Exact:
    value = _product(tokens)
    while tokens and tokens[-1] in "+-":
        value = value + _product(tokens) if tokens.pop() == "+" else value - _product(tokens)
    return value


def _product(tokens: list[str]) -> Exact:
    value = _unary(tokens)
    while tokens and tokens[-1] in "*/":
        value = value * _unary(tokens) if tokens.pop() == "*" else value / _unary(tokens)
    return value


def _unary(tokens: list[str]) -> Exact:
    match tokens.pop() if tokens else "":
        case "+":
            return _unary(tokens)
        case "-":
            return -_unary(tokens)
        case "(":
            value = _sum(tokens)
            if not tokens or tokens.pop() != ")":
                raise _MalformedError
            return value
        case "pi" | "π":
            return Exact(pi=Fraction(1))
        case "" | "*" | "/" | ")":
            raise _MalformedError
        case number:
            return Exact(Fraction(_bounded(number)))


def _bounded(number: str) -> str:
    _, _, exponent = number.lower().partition("e")
    if exponent and abs(int(exponent)) > _MAX_EXPONENT:
        raise UserError(
            f"expected a finite number of at most {_MAX_EXPONENT} digits, found {shown(Decimal(number))}"
        )
    return number
