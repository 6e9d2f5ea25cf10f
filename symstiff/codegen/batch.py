"""Many poses at once: what the templates of the vectorised functions need."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import sympy as sp

from symstiff.codegen.names import SUMMARIES
from symstiff.codegen.sincos import DOUBLE, FLOAT, Sincos
from symstiff.codegen.text import CAlgebra, Text, c_body, context_names
from symstiff.symbolic.program import Constant, Let, Program, Statement, evaluate

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options

_LINE = 64  # bytes of a cache line: a component's part of a tile
_FEW = 12  # outputs of which a block may take two lines each
_LOADS = {
    "double": 1e75,
    "float": 1e9,
}  # largest wrench of the vectorised code [N, N·m]: no product overflows
_FRAMES = 1536  # bytes: return addresses, loop counters, tables of the compact layout, sine and cosine of the library
_LARGEST = {"double": 1e307, "float": 1e38}


@dataclass(frozen=True)
class SizeAlgebra:
    """Bounds of magnitudes instead of values; notes the bound of every argument of sine and cosine, in order."""

    arguments: list[float]

    def number(self, value: sp.Expr) -> float:
        """Its magnitude."""
        return abs(float(value))

    def constant(self, constant: Constant) -> float:
        """Its magnitude."""
        return abs(float(constant.exact))

    def sum(self, terms: Sequence[tuple[int, float]]) -> float:
        """Magnitudes add."""
        return sum(x for _, x in terms)

    def product(self, factors: Sequence[float]) -> float:
        """Magnitudes multiply; nothing is known of zero times infinity."""
        return math.inf if math.inf in factors else math.prod(factors)

    def power(self, base: float, exponent: sp.Expr) -> float:
        """Positive whole powers only; beyond all bounds where a double is."""
        if not (exponent.is_Integer and exponent > 0):
            return math.inf
        try:
            return base ** int(exponent)
        except OverflowError:
            return math.inf

    def call(self, function: str, arguments: Sequence[float]) -> float:
        """At most one for the bounded functions."""
        if function in ("sin", "cos"):
            self.arguments.append(arguments[0])
        return 1.0 if function in ("sin", "cos", "tanh", "sign") else math.inf


@dataclass(frozen=True)
class VectorAlgebra(CAlgebra):
    """C expressions whose sines and cosines vectorise wherever their argument is known to be small enough."""

    small: Iterator[bool] = field(default_factory=lambda: iter(()))

    def call(self, function: str, arguments: Sequence[Text]) -> Text:
        """``sine`` and ``cosine`` of the template, or the library's."""
        if function in ("sin", "cos") and next(self.small):
            return Text(f"{'sine' if function == 'sin' else 'cosine'}({arguments[0].code})")
        return super().call(function, arguments)


def constants(single: bool) -> Sincos:
    """Constants of the polynomials."""
    return FLOAT if single else DOUBLE


def small_arguments(program: Program, single: bool) -> list[bool]:
    """Whether each sine's or cosine's argument stays in the polynomials' domain while joint variables are in reach."""
    domain = constants(single).domain
    return [size <= domain for size in _sizes(program, single)[0]]


def always_finite(program: Program, single: bool) -> bool:
    """Whether no joint variable in reach and no load within its bound leads to a number that is not finite."""
    return max(_sizes(program, single)[1], default=0.0) < _LARGEST["float" if single else "double"]


def _sizes(program: Program, single: bool) -> tuple[list[float], list[float]]:
    """Bounds of the arguments of sine and cosine, and of everything that is computed on the way to the outputs."""
    known = {"q": constants(single).reach, "w": _LOADS["float" if single else "double"]}
    found: list[float] = []
    seen: list[float] = []

    def note(_: Statement, value: float) -> float:
        seen.append(value)
        return value

    inputs = {v.name: [known.get(v.name, math.inf)] * len(v.symbols) for v in program.inputs}
    evaluate(program, inputs, SizeAlgebra(found), note)
    return found, seen


def vector_context(single: bool) -> dict[str, Any]:
    """The literals of the template's sine and cosine."""
    numbers, literal = constants(single), CAlgebra(single).literal
    suffix = "f" if single else ""
    load = _LOADS["float" if single else "double"]
    exact = {
        "half": 0.5, "one": 1.0, "two": 2.0, "zero": 0.0, "two_over_pi": 2.0 / math.pi,
        "shift": numbers.shift, "reach": numbers.reach, "domain": numbers.domain, "load": load,
        "half_over_reach": 0.5 / numbers.reach, "half_over_load": 0.5 / load,
    }  # fmt: skip
    return {
        "real": "float" if single else "double",
        **{f: f + suffix for f in ("sin", "cos")},
        "ulp": numbers.ulp,
        "whole_bits": 22 if single else 51,
        "split": [literal(x) for x in numbers.split],
        "sine": _horner(numbers.sine, literal),
        "cosine": _horner(numbers.cosine, literal),
        **{k: literal(x) for k, x in exact.items()},
    }


def _horner(coefficients: Sequence[float], literal: Callable[[float], str]) -> str:
    """A polynomial in z."""
    *rest, code = [literal(c) for c in coefficients]
    for c in reversed(rest):
        code = f"({c} + (z * {code}))"
    return code


def line(single: bool) -> int:
    """Numbers in a cache line: poses of a tile."""
    return _LINE // (4 if single else 8)


def block_size(outputs: int, single: bool) -> int:
    """Poses a block: a cache line of each output, two where these are few."""
    return line(single) * (2 if outputs <= _FEW else 1)


def batch_function(
    program: Program, inputs: Mapping[str, Callable[[int], str]], parameter: str, single: bool, summary: str
) -> dict[str, Any]:
    """What the templates print of one program: its arguments, its loop body, the size of its blocks.

    inputs: the C expression of an element, for inputs that do not vary from pose to pose; parameter: how the
    parameters' argument is declared.
    """
    real = "float" if single else "double"
    names = [v.name for v in program.inputs]
    output, _ = program.outputs[0]
    size = f"{program.name.upper()}_BLOCK"
    fixed = {"p", *inputs}
    arrays = [f"const {real} *NO_ALIAS {n}" for n in names if n not in fixed]
    inner = [parameter] * ("p" in names) + arrays + [f"{real} *NO_ALIAS {output}"]
    algebra = VectorAlgebra(single, iter(small_arguments(program, single)))
    store = f"{{vector}}[({{index}} * {size}) + i]"
    sources = dict(inputs) | {n: _component(n, size) for n in names if n not in inputs}
    body = c_body(program, sources, single=single, indent=" " * 8, algebra=algebra, store=store)
    zero = f"] = {algebra.literal(0.0)};"
    lines = body.split("\n")
    body = "\n".join(line for line in lines if not line.endswith(zero))
    unused = [
        n for n in names if (n == "p" or n not in fixed) and f"{n}[" not in body and f"{n}->" not in body
    ]
    return {
        "name": program.name,
        "summary": summary,
        "size": size,
        "block": block_size(program.size(output), single),
        "many": program.size(output) > _FEW,
        "finite": always_finite(program, single),
        "parameters": "p" in names,
        "arguments": ", ".join(inner),
        "block_arguments": ", ".join(inner).replace("NO_ALIAS ", ""),
        "public_parameter": f"{parameter}, " if "p" in names else "",
        "given": ", ".join(["p"] * ("p" in names) + [f"block_{n}" for n in names if n not in fixed]),
        "prologue": "".join(f"    (void){n};\n" for n in unused),
        "body": body,
        "zeros": len(body) < sum(len(line) + 1 for line in lines) - 1,
        "arrays": [{"name": v.name, "size": len(v.symbols)} for v in program.inputs if v.name not in fixed],
        "output": output,
        "outputs": program.size(output),
        "temporaries": sum(isinstance(s, Let) for s in program.statements),
    }


def _component(name: str, size: str) -> Callable[[int], str]:
    return lambda k: f"{name}[({k} * {size}) + i]"


def stack_bytes(functions: Sequence[Mapping[str, Any]], joints: int, single: bool, register: int) -> int:
    """Stack that the hungriest function hardly exceeds: its blocks, what it keeps of temporaries, its callees.

    register: bytes of a vector register, which each temporary of a block may take. A pose that goes to the scalar
    function stands in arrays of its own.
    """
    real = 4 if single else 8
    found: list[int] = []
    for f in functions:
        pose: int = joints + 6 + f["outputs"]
        found.append(real * (pose + (pose + 1) * f["block"]) + register * f["temporaries"])
    return max(found) + _FRAMES


def batch_context(functions: Functions, options: Options) -> dict[str, Any]:
    """What ``batch.c.j2`` prints beside the common names."""
    model, single = functions.model, options.single
    fields = {n: f"p->k[{k}]" for k, n in enumerate(model.stiffness_parameters)}
    fields |= {e.name: f"p->{e.name}" for e in model.effect_parameters}
    order, moment = model.parameters, context_names(functions.deflection)
    fixed = {"p": lambda k: fields[order[k]], "context": lambda k: f"p->{moment[k]}"}
    parameter = f"const {model.robot.name}_params_t *p"
    batches = [
        batch_function(p, fixed, parameter, single, SUMMARIES[p.name])
        for p in functions.all
        if p.name in ("deflection", "observation")
    ]
    return {
        "batches": batches,
        "v": vector_context(single),
        **{
            name: stack_bytes(batches, model.robot.dof, single, register)
            for name, register in (("stack", 16), ("wide_stack", 64))
        },
    }
