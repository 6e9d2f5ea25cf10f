"""CasADi functions of a model: the same Programs walked over SX graphs; named inputs and outputs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import sympy as sp

from symstiff.symbolic.algebras import NumpyAlgebra
from symstiff.symbolic.program import Constant, Program, evaluate

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options

_NAMES = {"Abs": "fabs", "asin": "asin", "acos": "acos", "atan": "atan"}


class CasadiAlgebra(NumpyAlgebra):
    """Scalar SX expressions; sums and products as of doubles."""

    def __init__(self) -> None:
        import casadi

        self.ca = casadi

    def number(self, value: sp.Expr) -> Any:
        """A constant node."""
        return self.ca.SX(float(value))

    def constant(self, constant: Constant) -> Any:
        """A constant node of the exact value."""
        return self.ca.SX(float(sp.N(constant.exact, 30)))

    def power(self, base: Any, exponent: sp.Expr) -> Any:
        """x**e."""
        if exponent == -1:
            return 1 / base
        return super().power(base, exponent)

    def call(self, function: str, arguments: Sequence[Any]) -> Any:
        """CasADi's function of that name."""
        return getattr(self.ca, _NAMES.get(function, function))(*arguments)


def casadi_function(program: Program, name: str) -> Any:
    """A CasADi ``Function`` of a program: one vector an input, one matrix an output, named as in the Program."""
    import casadi as ca

    inputs = {v.name: ca.SX.sym(v.name, len(v.symbols)) for v in program.inputs}
    flat = evaluate(program, {k: ca.vertsplit(x) for k, x in inputs.items()}, CasadiAlgebra())
    outputs = {}
    for output, shape in program.outputs:
        rows, columns = shape if len(shape) == 2 else (shape[0], 1)
        elements = [ca.SX(x) if x is not None else ca.SX(0) for x in flat[output]]
        outputs[output] = ca.reshape(ca.vertcat(*elements), columns, rows).T
    return ca.Function(name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))


def casadi_functions(functions: Functions) -> dict[str, Any]:
    """All CasADi functions of a model, by name."""
    prefix = functions.model.robot.name
    return {p.name: casadi_function(p, f"{prefix}_{p.name}") for p in functions.all}


def emit_casadi(functions: Functions, options: Options) -> dict[str, bytes]:
    """One ``.casadi`` file a function; CasADi loads it without symstiff by ``Function.load``."""
    name = functions.model.robot.name
    files = {}
    with TemporaryDirectory() as scratch:  # CasADi saves to files only
        for key, function in casadi_functions(functions).items():
            path = Path(scratch) / f"{name}_{key}.casadi"
            function.save(str(path))
            files[path.name] = path.read_bytes()
    return files
