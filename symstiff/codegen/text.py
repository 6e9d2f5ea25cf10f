"""Programs as C text: one algebra whose values are expressions with their precedence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy as sp

from symstiff.errors import UserError
from symstiff.symbolic.program import Constant, Let, Program, Statement, evaluate

_SUM, _PRODUCT, ATOM = 1, 2, 3
_DIGITS = 30
_MOST_SINGLE = float(np.finfo(np.float32).max)
_FUNCTIONS = {
    "sin": "sin", "cos": "cos", "tan": "tan", "tanh": "tanh", "exp": "exp", "log": "log", "sqrt": "sqrt",
    "Abs": "fabs", "atan": "atan", "asin": "asin", "acos": "acos", "atan2": "atan2",
}  # fmt: skip


@dataclass(frozen=True)
class Text:
    """An expression and how tightly it binds."""

    code: str
    precedence: int = ATOM

    def inside(self, precedence: int) -> str:
        """The code, in parentheses where its context binds tighter."""
        return self.code if self.precedence >= precedence else f"({self.code})"


@dataclass(frozen=True)
class CAlgebra:
    """C expressions in ``double`` or ``float``."""

    single: bool = False

    def literal(self, value: float) -> str:
        """A literal that reads back as the nearest number of the type. Raises UserError where that is infinite."""
        if self.single and abs(value) > _MOST_SINGLE:
            raise UserError(
                f"the model holds the number {value:.3g}, which does not fit single precision: use double"
            )
        text = str(np.float32(value)) if self.single else repr(float(value))
        if not any(c in text for c in ".en"):
            text += ".0"
        if "e" in text and "." not in text:
            text = text.replace("e", ".0e")
        return text + ("f" if self.single else "")

    def number(self, value: sp.Expr) -> Text:
        """A literal."""
        number = float(value)
        return Text(self.literal(number), ATOM if number >= 0 else _SUM)

    def constant(self, constant: Constant) -> Text:
        """A literal of the exact value."""
        return self.number(float(sp.N(constant.exact, 30)))

    def sum(self, terms: Sequence[tuple[int, Text]]) -> Text:
        """Sums and differences; the first term carries the only sign change."""
        (sign, head), *rest = terms
        alone = _PRODUCT if not rest else ATOM
        code = _added(head) if sign > 0 else "-" + head.inside(alone)
        for sign, x in rest:
            code += f" + {_added(x)}" if sign > 0 else f" - {x.inside(ATOM)}"
        return Text(code, _SUM)

    def product(self, factors: Sequence[Text]) -> Text:
        """Products."""
        return Text("*".join(f.inside(_PRODUCT if k == 0 else ATOM) for k, f in enumerate(factors)), _PRODUCT)

    def power(self, base: Text, exponent: sp.Expr) -> Text:
        """Small whole powers as products; others by the library."""
        suffix = "f" if self.single else ""
        if exponent == sp.Rational(1, 2):
            return Text(f"sqrt{suffix}({base.code})")
        if exponent == -1:
            return Text(f"{self.literal(1.0)}/{base.inside(ATOM)}", _PRODUCT)
        if exponent.is_Integer and 1 < exponent <= 4:
            return self.product([base] * int(exponent))
        return Text(f"pow{suffix}({base.code}, {self.literal(float(exponent))})")

    def call(self, function: str, arguments: Sequence[Text]) -> Text:
        """A function of the mathematical library; ``sign`` by comparison."""
        inside = ", ".join(a.code for a in arguments)
        if function == "sign":
            zero, x = self.literal(0.0), arguments[0].inside(ATOM)
            one = self.literal(1.0)
            return Text(f"(({x} > {zero}) ? {one} : (({x} < {zero}) ? -{one} : {zero}))")
        return Text(f"{_FUNCTIONS[function]}{'f' if self.single else ''}({inside})")


def _added(x: Text) -> str:
    """A term of a sum: products in parentheses, as MISRA C rule 12.1 wants them."""
    return x.code if x.precedence == _SUM else x.inside(ATOM)


def c_body(
    program: Program,
    inputs: Mapping[str, Callable[[int], str]],
    *,
    single: bool = False,
    indent: str = "    ",
    algebra: CAlgebra | None = None,
    store: str = "{vector}[{index}]",
) -> str:
    """The statements of a program as C; ``inputs`` names the C expression of each element of each input.

    algebra: how expressions are written where not as plain C; store: where an output's element goes.
    """
    algebra = algebra or CAlgebra(single)
    real = "float" if single else "double"
    lines: list[str] = []
    names: dict[str, list[Any]] = {}
    used = set().union(*(s.expression.free_symbols for s in program.statements), set())
    for vector in program.inputs:
        names[vector.name] = []
        for k, symbol in enumerate(vector.symbols):
            source = inputs[vector.name](k)
            if symbol in used and source.endswith("]") and vector.name in ("q", "w"):
                local = f"{vector.name}{k + 1}"
                lines.append(f"const {real} {local} = {source};")
                source = local
            names[vector.name].append(Text(source))

    def visit(statement: Statement, value: Text) -> Text:
        if isinstance(statement, Let):
            lines.append(f"const {real} {statement.symbol.name} = {value.code};")
            return Text(statement.symbol.name)
        place = store.format(vector=statement.vector, index=statement.index)
        lines.append(f"{place} = {value.code};")
        return value

    evaluate(_folded(program), names, algebra, visit)
    return "\n".join(indent + line for line in lines)


def _folded(program: Program) -> Program:
    """The program with numbers for powers of numbers, which may be beyond the type where their product is not."""
    return replace(
        program, statements=tuple(replace(s, expression=_number(s.expression)) for s in program.statements)
    )


def _number(expression: sp.Expr) -> sp.Expr:
    """An expression in which what is free of symbols beside a power of a number is one number."""
    if not any(power.base.is_number for power in expression.atoms(sp.Pow)):
        return expression
    if expression.is_number:
        return sp.N(expression, _DIGITS)
    if expression.is_Mul:
        known, rest = expression.as_independent(*expression.free_symbols)
        if not known.is_Rational:
            return sp.Mul(sp.N(known, _DIGITS), *map(_number, sp.Mul.make_args(rest)), evaluate=False)
    return expression.func(*map(_number, expression.args), evaluate=False)


def context_names(program: Program) -> list[str]:
    """What a program knows of the moment besides joints and wrench: time, temperature, branch, turn."""
    return [s.name for v in program.inputs if v.name == "context" for s in v.symbols]
