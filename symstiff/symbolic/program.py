"""Program: a let-bound list of inputs, temporaries and outputs, in order; what every emitter walks.

A Program is mathematics without a language. ``evaluate`` walks it with an *algebra*, which says what numbers, sums,
products and functions are: NumPy arrays, 50-digit numbers, residues modulo a prime, CasADi graphs, operation counts,
text of a programming language. One walk, many meanings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import sympy as sp


@dataclass(frozen=True)
class Vector:
    """A named group of symbols: an argument of the function, in order."""

    name: str
    symbols: tuple[sp.Symbol, ...]


@dataclass(frozen=True)
class Constant:
    """An irrational constant: its exact value, and the angle of which it is the cosine where it is one."""

    symbol: sp.Symbol
    exact: sp.Expr
    turn: sp.Expr | None = None


@dataclass(frozen=True)
class Let:
    """A temporary: ``symbol = expression``."""

    symbol: sp.Symbol
    expression: sp.Expr


@dataclass(frozen=True)
class Emit:
    """An output element: ``vector[index] = expression``."""

    vector: str
    index: int
    expression: sp.Expr


Statement = Let | Emit


@dataclass(frozen=True)
class Program:
    """Inputs, constants, statements in order, and the sizes of the outputs (row-major shapes)."""

    name: str
    inputs: tuple[Vector, ...]
    constants: tuple[Constant, ...]
    statements: tuple[Statement, ...]
    outputs: tuple[tuple[str, tuple[int, ...]], ...]

    def size(self, output: str) -> int:
        """Number of elements of an output."""
        shape = dict(self.outputs)[output]
        return int(sp.prod(shape))

    def _repr_latex_(self) -> str:
        from symstiff.symbolic.latex import program_latex

        return program_latex(self)


class Algebra(Protocol):
    """What an interpretation of a Program must supply."""

    def number(self, value: sp.Expr) -> Any:
        """An exact number."""

    def constant(self, constant: Constant) -> Any:
        """An irrational constant."""

    def sum(self, terms: Sequence[tuple[int, Any]]) -> Any:
        """Σ ±x, signs +1 or −1."""

    def product(self, factors: Sequence[Any]) -> Any:
        """Π x."""

    def power(self, base: Any, exponent: sp.Expr) -> Any:
        """Base to an exact exponent."""

    def call(self, function: str, arguments: Sequence[Any]) -> Any:
        """A function by SymPy's class name: sin, cos, sqrt, tanh, sign, Abs, exp, …."""


def evaluate(
    program: Program,
    inputs: Mapping[str, Sequence[Any]],
    algebra: Algebra,
    visit: Callable[[Statement, Any], Any] | None = None,
) -> dict[str, list[Any]]:
    """Walk a program in an algebra; ``inputs`` has a sequence a vector. Returns the flat outputs by name.

    ``visit(statement, value)`` may replace the value of a temporary, as an emitter of text does with its name.
    """
    values: dict[sp.Symbol, Any] = {c.symbol: algebra.constant(c) for c in program.constants}
    for vector in program.inputs:
        values.update(zip(vector.symbols, inputs[vector.name], strict=True))
    outputs: dict[str, list[Any]] = {name: [None] * program.size(name) for name, _ in program.outputs}
    for statement in program.statements:
        value = walk(statement.expression, values, algebra)
        if visit is not None:
            value = visit(statement, value)
        if isinstance(statement, Let):
            values[statement.symbol] = value
        else:
            outputs[statement.vector][statement.index] = value
    return outputs


def walk(
    expression: sp.Expr,
    values: Mapping[sp.Symbol, Any],
    algebra: Algebra,
    known: dict[sp.Expr, Any] | None = None,
) -> Any:
    """Interpret one SymPy expression in an algebra.

    ``known`` holds what parts of expressions are for these ``values``; new ones are added to it.
    """
    if expression.is_Symbol:
        return values[expression]
    if known is None:
        return _interpreted(expression, algebra, lambda part: walk(part, values, algebra))
    if expression not in known:
        known[expression] = _interpreted(expression, algebra, lambda part: walk(part, values, algebra, known))
    return known[expression]


def _interpreted(expression: sp.Expr, algebra: Algebra, inner: Callable[[sp.Expr], Any]) -> Any:
    """An expression in an algebra from what its parts are there."""
    if expression.is_Number or expression.is_NumberSymbol:
        return algebra.number(expression)
    if expression.is_Add:
        terms = [split_sign(a) for a in expression.args]
        terms.sort(key=lambda t: t[0] < 0)
        return algebra.sum([(sign, inner(e)) for sign, e in terms])
    if expression.is_Mul:
        sign, positive = split_sign(expression)
        if sign < 0:
            return algebra.sum([(-1, inner(positive))])
        return algebra.product([inner(a) for a in positive.args])
    if expression.is_Pow:
        return algebra.power(inner(expression.base), expression.exp)
    if expression.is_Function:
        return algebra.call(type(expression).__name__, [inner(a) for a in expression.args])
    raise TypeError(f"no interpretation of {type(expression).__name__} in a program")


@lru_cache(maxsize=1 << 14)
def split_sign(expression: sp.Expr) -> tuple[int, sp.Expr]:
    """Split ±x into sign and x; only a numeric coefficient's sign counts."""
    if expression.is_Mul:
        head = expression.args[0]
        if head.is_Number and _below_zero(head):
            return -1, -expression
    elif expression.is_Number and _below_zero(expression):
        return -1, -expression
    return 1, expression


def _below_zero(number: sp.Number) -> bool:
    """``is_negative``, which SymPy deduces from all that it knows of a number."""
    if number.is_Rational:
        return bool(number.p < 0)
    return bool(number._mpf_[0]) if number.is_Float else bool(number.is_negative)


def negative(expression: sp.Expr) -> bool:
    """True for exactly one of x and −x: the one to bind with the other sign."""
    if not expression.is_Add:
        return split_sign(expression)[0] < 0
    split = [split_sign(a) for a in expression.args]
    balance = sum(sign for sign, _ in split)
    if balance:
        return balance < 0
    names = [tuple(sorted(s.name for s in e.free_symbols)) for _, e in split]
    first = min(names)
    if names.count(first) > 1:
        return bool(expression.could_extract_minus_sign())
    return split[names.index(first)][0] < 0
