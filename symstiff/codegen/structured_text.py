"""IEC 61131-3 Structured Text (dialect of CODESYS and TwinCAT): one function block, deflection and compensation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy as sp

from symstiff.codegen.emit import base_context, environment
from symstiff.codegen.reference import LARGEST_CORRECTION, ROUNDED, unit_length
from symstiff.codegen.text import ATOM, CAlgebra, Text, context_names
from symstiff.errors import UserError
from symstiff.symbolic.program import Constant, Let, Program, Statement, evaluate

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options

_CALLS = {
    "sin": "SIN", "cos": "COS", "tan": "TAN", "exp": "EXP", "log": "LN", "sqrt": "SQRT", "Abs": "ABS",
    "atan": "ATAN", "asin": "ASIN", "acos": "ACOS",
}  # fmt: skip
_NEAR, _SERIES = 0.05, (62 / 153, 17 / 42, 2 / 5, 1 / 3)
"""Up to where tanh is its series, and the ratios of the series' terms, last first: each to the one before it."""
_MOMENT = {"time": "time_s"}  # TIME is a type of the language


@dataclass(frozen=True)
class StructuredAlgebra(CAlgebra):
    """Structured Text expressions in LREAL or REAL; operators are those of C."""

    def literal(self, value: float) -> str:
        """A typed literal in single precision, so that no value is widened."""
        text = str(np.float32(value)) if self.single else repr(float(value))
        mantissa, _, exponent = text.partition("e")
        mantissa += "" if "." in mantissa else ".0"
        text = f"{mantissa}E{int(exponent)}" if exponent else mantissa
        return f"REAL#{text}" if self.single else text

    def number(self, value: sp.Expr) -> Text:
        """A literal; a negative one in parentheses."""
        number = float(value)
        return Text(self.literal(number)) if number >= 0 else Text(f"(-{self.literal(-number)})")

    def constant(self, constant: Constant) -> Text:
        """A literal of the exact value."""
        return self.number(sp.N(constant.exact, 30))

    def power(self, base: Text, exponent: sp.Expr) -> Text:
        """Small whole powers as products; others by EXPT."""
        if exponent == sp.Rational(1, 2):
            return Text(f"SQRT({base.code})")
        if exponent == -1 or (exponent.is_Integer and 1 < exponent <= 4):
            return super().power(base, exponent)
        return Text(f"EXPT({base.code}, {self.number(exponent).code})")

    def call(self, function: str, arguments: Sequence[Text]) -> Text:
        """A standard function; what the standard lacks by others. Raises UserError."""
        x, one, zero = arguments[0].inside(ATOM), self.literal(1.0), self.literal(0.0)
        if function == "sign":
            return Text(f"SEL({x} > {zero}, SEL({x} < {zero}, {zero}, -{one}), {one})")
        if function == "tanh":
            return Text(self._tanh(x))
        if function not in _CALLS:
            raise UserError(f"target st: the model needs the function {function}: remove st from --targets")
        return Text(f"{_CALLS[function]}({x})")

    def _tanh(self, x: str) -> str:
        """By EXP, which loses the digits of a small argument: there by its series, to all digits of LREAL."""
        one, two, far, near = (self.literal(value) for value in (1.0, 2.0, 20.0, _NEAR))
        series = one
        for ratio in _SERIES:
            series = f"({one} - {x} * {x} * {self.literal(ratio)} * {series})"
        large = f"({one} - {two} / (EXP({two} * LIMIT(-{far}, {x}, {far})) + {one}))"
        return f"SEL(ABS({x}) < {near}, {large}, {x} * {series})"


@dataclass
class Body:
    """Statements of several programs; what one has computed, the next one does not compute again."""

    algebra: StructuredAlgebra
    known: dict[str, str]
    temporaries: list[str]

    def statements(
        self, program: Program, inputs: dict[str, Callable[[int], str]], output: str, prefix: str
    ) -> str:
        """The statements of a program, its only output in the array ``output``."""
        lines: list[str] = []

        def visit(statement: Statement, value: Text) -> Text:
            if not isinstance(statement, Let):
                lines.append(f"    {output}[{statement.index + 1}] := {value.code};")
                return value
            if value.code not in self.known:
                name = self.known[value.code] = prefix + statement.symbol.name
                self.temporaries.append(name)
                lines.append(f"    {name} := {value.code};")
            return Text(self.known[value.code])

        names = {v.name: [Text(inputs[v.name](i)) for i in range(len(v.symbols))] for v in program.inputs}
        evaluate(program, names, self.algebra, visit)
        return "\n".join(lines)


def emit_st(functions: Functions, options: Options) -> dict[str, bytes]:
    """One function block in a text file."""
    context = base_context(functions, options) | st_context(functions, options)
    text: str = environment().get_template("st/block.st.j2").render(context)
    return {f"FB_{functions.model.robot.name}.st": text.encode()}


def st_context(functions: Functions, options: Options) -> dict[str, Any]:
    """What the template prints beside the common names."""
    model, algebra = functions.model, StructuredAlgebra(options.single)
    order, literal = model.parameters, algebra.literal
    moment = [_MOMENT.get(n, n) for n in context_names(functions.deflection)]
    inputs: dict[str, Callable[[int], str]] = {
        "p": lambda i: order[i],
        "q": lambda i: f"q[{i + 1}]",
        "w": lambda i: f"w[{i + 1}]",
        "context": lambda i: moment[i],
    }
    body = Body(algebra, {}, [])
    deflection = body.statements(functions.deflection, inputs, "dt", "d_")
    jacobian = body.statements(functions.jacobian, inputs, "jac", "j_")
    between = {"q": lambda i: f"half_way[{i + 1}]"}
    half_way = body.statements(functions.jacobian, between, "jac", "h_")
    most = float(np.finfo(np.float32).max) if options.single else float(np.finfo(np.float64).max)
    return {
        "type": "REAL" if options.single else "LREAL",
        "starts": [algebra.number(sp.Float(x, 30)).code for x in model.known.values()],
        "moment": moment,
        "deflection": deflection,
        "jacobian": jacobian,
        "jacobian_half_way": half_way,
        "temporaries": body.temporaries,
        "rows": max(model.robot.dof, 6),
        "columns": min(model.robot.dof, 6),
        "redundant": model.robot.dof > 6,
        "unit": literal(unit_length(model)),
        "smallest": literal(1e-5 if options.single else 1e-10),
        "furthest": literal(LARGEST_CORRECTION),
        "half": literal(0.5),
        "rounded_st": literal(ROUNDED),
        "zero": literal(0.0),
        "most": literal(most),
    }
