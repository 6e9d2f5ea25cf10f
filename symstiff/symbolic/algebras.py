"""Interpretations of a Program: NumPy arrays, 50-digit numbers, residues modulo a prime, operation counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import reduce
from operator import mul
from typing import Any

import numpy as np
import sympy as sp

from symstiff.arguments import reals, require
from symstiff.errors import UserError
from symstiff.symbolic.program import Constant, Program, evaluate

_NUMPY = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "tanh": np.tanh, "exp": np.exp, "log": np.log,
    "sign": np.sign, "Abs": np.abs, "atan": np.arctan, "asin": np.arcsin, "acos": np.arccos, "sqrt": np.sqrt,
    "atan2": np.arctan2,
}  # fmt: skip
FUNCTIONS = frozenset(_NUMPY)
"""What a law may be made of, beside sums, products and powers."""


class NumpyAlgebra:
    """Doubles, element by element over arrays."""

    def number(self, value: sp.Expr) -> Any:
        """Nearest double."""
        return float(value)

    def constant(self, constant: Constant) -> Any:
        """Nearest double."""
        return float(constant.exact)

    def sum(self, terms: Sequence[tuple[int, Any]]) -> Any:
        """Σ ±x."""
        sign, total = terms[0]
        total = total if sign > 0 else -total
        for sign, x in terms[1:]:
            total = total + x if sign > 0 else total - x
        return total

    def product(self, factors: Sequence[Any]) -> Any:
        """Π x."""
        return reduce(mul, factors)

    def power(self, base: Any, exponent: sp.Expr) -> Any:
        """x**e; whole exponents by the array library."""
        return base ** (int(exponent) if exponent.is_Integer else float(exponent))

    def call(self, function: str, arguments: Sequence[Any]) -> Any:
        """NumPy's function of that name."""
        return _NUMPY[function](*arguments)


class DecimalAlgebra(NumpyAlgebra):
    """mpmath numbers at the working precision that the caller has set."""

    def __init__(self) -> None:
        import mpmath

        self.mp = mpmath.mp

    def number(self, value: sp.Expr) -> Any:
        """The number at working precision."""
        if value.is_Rational:
            return self.mp.mpf(int(value.p)) / int(value.q)
        return self.mp.mpf(sp.N(value, self.mp.dps + 5)._mpf_)

    def constant(self, constant: Constant) -> Any:
        """The exact value at working precision."""
        return self.number(constant.exact)

    def power(self, base: Any, exponent: sp.Expr) -> Any:
        """x**e."""
        return self.mp.mpf(base) ** (int(exponent) if exponent.is_Integer else self.number(exponent))

    def call(self, function: str, arguments: Sequence[Any]) -> Any:
        """mpmath's function of that name."""
        return getattr(self.mp, {"Abs": "fabs"}.get(function, function))(*arguments)


@dataclass
class CountAlgebra:
    """Operation counts: additions, multiplications, sign changes, functions."""

    add: int = 0
    mul: int = 0
    neg: int = 0
    trig: int = 0
    other: int = 0

    def number(self, value: sp.Expr) -> None:
        """Free."""

    def constant(self, constant: Constant) -> None:
        """Free."""

    def sum(self, terms: Sequence[tuple[int, Any]]) -> None:
        """One addition less than terms; a sign change where no term is positive."""
        self.add += len(terms) - 1
        self.neg += terms[0][0] < 0

    def product(self, factors: Sequence[Any]) -> None:
        """One multiplication less than factors."""
        self.mul += len(factors) - 1

    def power(self, base: Any, exponent: sp.Expr) -> None:
        """Repeated multiplication, or one function."""
        if exponent.is_Integer and exponent > 0:
            self.mul += int(exponent) - 1
        else:
            self.other += 1

    def call(self, function: str, arguments: Sequence[Any]) -> None:
        """A function evaluation."""
        if function in ("sin", "cos"):
            self.trig += 1
        else:
            self.other += 1


def count(program: Program) -> dict[str, int]:
    """Operations of a program: ``add``, ``mul``, ``neg``, ``trig`` and ``other`` functions."""
    algebra = CountAlgebra()
    evaluate(program, {v.name: [None] * len(v.symbols) for v in program.inputs}, algebra)
    return asdict(algebra)


def evaluate_numpy(program: Program, **inputs: Any) -> dict[str, np.ndarray]:
    """Outputs of shape (N, …) for inputs of shape (N, size), by name; N configurations at once."""
    arrays = {name: np.atleast_2d(np.asarray(value, dtype=float)) for name, value in inputs.items()}
    lengths = {len(a) for a in arrays.values()}
    n = min(lengths) if 0 in lengths else max(lengths)
    flat = evaluate(program, {k: list(a.T) for k, a in arrays.items()}, NumpyAlgebra())
    result = {}
    for name, shape in program.outputs:
        stacked = np.empty((n, len(flat[name])))
        for k, x in enumerate(flat[name]):
            stacked[:, k] = x
        result[name] = stacked.reshape(n, *shape)
    return result


def evaluate_decimal(program: Program, digits: int = 50, **inputs: Sequence[Any]) -> dict[str, list[Any]]:
    """Flat outputs as mpmath numbers of ``digits`` digits for one configuration."""
    import mpmath

    with mpmath.workdps(digits):
        values = {k: [mpmath.mpf(x) for x in v] for k, v in inputs.items()}
        flat = evaluate(program, values, DecimalAlgebra())
        return {k: [mpmath.mpf(x) for x in v] for k, v in flat.items()}


def context_columns(context: Mapping[str, Any] | None, n: int, needed: str = "") -> dict[str, np.ndarray]:
    """The columns of ``context`` as arrays (n,).

    Raises UserError for other shapes, and where the needed one is not there or not finite.
    """
    require(context or {}, Mapping, "a context", "{'time': seconds} is one, with a number a row")
    found = {}
    for name, given in (context or {}).items():
        column = reals(given, f"context: {name}", f"({n},)")
        if column.shape not in ((), (1,), (n,)):
            raise UserError(f"context: {name}: expected an array of shape ({n},), found {column.shape}")
        found[name] = np.broadcast_to(column, n)
    if needed and needed not in found:
        raise UserError(
            f"the model needs the column {needed}: add it to the table, or from Python give context={{{needed!r}: …}}"
        )
    if needed and not (finite := np.isfinite(found[needed])).all():
        row = int(np.argmin(finite))
        raise UserError(f"context: {needed}: row {row} holds what is no finite number: correct it")
    return found
