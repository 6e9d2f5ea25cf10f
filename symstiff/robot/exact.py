"""Exact numbers of robot files: r + s·pi with rational r and s, parsed from text, never evaluated as code."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from symstiff.errors import UserError

if TYPE_CHECKING:
    import sympy

_TOKEN = re.compile(r"\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|(pi\b|π)|([-+*/()]))")
_MAX_TEXT = 200
_MAX_EXPONENT = 300


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
            raise UserError("a product of two multiples of pi is no length or angle")
        return Exact(self.rational * other.rational, self.rational * other.pi + self.pi * other.rational)

    def __truediv__(self, other: Exact) -> Exact:
        if other.pi:
            raise UserError("division by a multiple of pi is no length or angle")
        if not other.rational:
            raise UserError("division by zero")
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


def parse_exact(value: Any) -> Exact:
    """Read an integer, a decimal (as text) or an expression of numbers, pi, ``+ - * / ( )``.

    Raises UserError for anything else: a non-finite number, another name, a malformed expression.
    """
    if isinstance(value, Exact):
        return value
    if isinstance(value, bool):
        raise UserError(f"expected a number, found {value!r}")
    if isinstance(value, int):
        return Exact(Fraction(value))
    if isinstance(value, float):
        if not math.isfinite(value):
            raise UserError(f"expected a finite number, found {value}")
        return Exact(Fraction(repr(value)))
    if isinstance(value, Fraction):
        return Exact(value)
    if not isinstance(value, str):
        raise UserError(f'expected a number or an expression like "-pi/2", found {value!r}')
    return _Parser(value).parse()


class _Parser:
    """Recursive descent over ``expr = term {(+|-) term}``, ``term = unary {(*|/) unary}``."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = self._tokens(text)
        self.position = 0

    def _fail(self) -> UserError:
        shown = self.text if len(self.text) <= 40 else self.text[:37] + "..."
        return UserError(
            f'cannot read {shown!r} as a number: use integers, decimals, pi, + - * / ( ), e.g. "-pi/2"'
        )

    def _tokens(self, text: str) -> list[str]:
        stripped = (
            text.strip().replace("_", "") if re.fullmatch(r"[\d_.+\-eE]+", text.strip()) else text.strip()
        )
        if re.fullmatch(r"[+-]?(inf|nan)", stripped):
            raise UserError(f"expected a finite number, found {stripped}")
        if not stripped or len(text) > _MAX_TEXT:
            raise self._fail()
        tokens, position = [], 0
        while position < len(stripped):
            match = _TOKEN.match(stripped, position)
            if match is None:
                raise self._fail()
            tokens.append(match.group(0).strip())
            position = match.end()
        return tokens

    def _peek(self) -> str:
        return self.tokens[self.position] if self.position < len(self.tokens) else ""

    def _next(self) -> str:
        token = self._peek()
        self.position += 1
        return token

    def parse(self) -> Exact:
        value = self._sum()
        if self._peek():
            raise self._fail()
        return value

    def _sum(self) -> Exact:
        value = self._product()
        while self._peek() in ("+", "-"):
            value = value + self._product() if self._next() == "+" else value - self._product()
        return value

    def _product(self) -> Exact:
        value = self._unary()
        while self._peek() in ("*", "/"):
            value = value * self._unary() if self._next() == "*" else value / self._unary()
        return value

    def _unary(self) -> Exact:
        token = self._next()
        if token in ("+", "-"):
            operand = self._unary()
            return -operand if token == "-" else operand
        if token == "(":
            value = self._sum()
            if self._next() != ")":
                raise self._fail()
            return value
        if token in ("pi", "π"):
            return Exact(pi=Fraction(1))
        if not token or token in "*/)":
            raise self._fail()
        _, _, exponent = token.lower().partition("e")
        if exponent and abs(int(exponent)) > _MAX_EXPONENT:
            raise UserError(f"expected a finite number, found {token}")
        return Exact(Fraction(token))
