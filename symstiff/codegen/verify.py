"""Proof of what was generated: compiled strictly, self-tested, and held against 50 digits."""

from __future__ import annotations

import ctypes
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from symstiff.codegen.batch import block_size
from symstiff.codegen.compiler import STRICT, Compiler
from symstiff.codegen.functions import Functions
from symstiff.codegen.names import moments
from symstiff.codegen.options import Options
from symstiff.codegen.reference import Case, cases, plausible_values, tolerance
from symstiff.codegen.runtime import pointer
from symstiff.errors import UserError
from symstiff.threads import in_threads

CONFIGURATIONS = 64
"""Random ones over the joint range at which the bounds of a compiled library are measured; laws of effects add those
where they bend."""
ABSOLUTE = "compensate"
"""The function whose error is one of joint variables [rad, m], relative to nothing."""
TWIST = (slice(0, 3), slice(3, 6))
Errors = dict[str, float]


@dataclass(frozen=True)
class Verification:
    """What was compiled and seen: greatest relative errors by function, against 50-digit values.

    reason: why nothing was compiled, "" where it was or nobody wanted it.
    errors: CasADi's and C's greatest, of C without ``compensate``;
    bounds: C's by function over so many configurations, the stiffness matrix's
    divided by its condition number, the compensated joint variables' absolute [rad, m]; footprint: code, stack,
    instructions by machine.
    """

    compiled: bool
    compiler: str = ""
    reason: str = ""
    selftest: float | None = None
    configurations: int = 0
    errors: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, float] = field(default_factory=dict)
    footprint: dict[str, Any] = field(default_factory=dict)

    @property
    def max_relative_error(self) -> float | None:
        """The greatest relative error seen anywhere."""
        seen = [e for e in (*self.errors.values(), self.selftest) if e is not None]
        return max(seen) if seen else None

    def table(self) -> dict[str, Any]:
        """For manifest.json."""
        return {
            "compiled": self.compiled,
            "compiler": self.compiler,
            **({"reason": self.reason} if self.reason else {}),
            "max_relative_error": self.max_relative_error,
            "selftest_error": self.selftest,
            "errors": self.errors,
            "bounds": {"configurations": self.configurations, **self.bounds} if self.bounds else {},
            "footprint": self.footprint,
        }


def verify(
    folder: Path,
    functions: Functions,
    compiler: Compiler | None,
    options: Options,
    footprint: bool = False,
    reason: str = "",
) -> Verification:
    """Compile and run the self-test in a scratch folder, then compare all evaluations of the model.

    footprint: also measure code, stack and instructions, on every machine that the tools at hand can show; reason:
    why there is no compiler.
    """
    if "c" not in options.targets:
        compiler = None
    values = plausible_values(functions.model)
    drawn = CONFIGURATIONS if compiler else 4
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(1) as beside:
        name = functions.model.robot.name
        built = beside.submit(_built, folder, Path(scratch), name, options, compiler) if compiler else None
        found = cases(functions, values, drawn, 23, options.single)  # while the compiler works
        errors: dict[str, float] = {}
        if "casadi" in options.targets:
            errors["casadi"] = _casadi_error(folder, functions, [*found[:4], *found[drawn:]], values)
            if not errors["casadi"] <= 100 * tolerance(single=False):
                raise RuntimeError(
                    f"CasADi's functions are wrong by {errors['casadi']:.2g} of their greatest value"
                )
        if compiler is None or built is None:
            return Verification(False, reason=reason, errors=errors)
        library, worst = built.result()
        bounds = c_errors(library, functions, found, values, options.single)
        bounds |= batch_errors(library, functions, found, values, options.single)
    _check_batches(bounds, options.single, compiler)
    errors["c"] = max(error for function, error in bounds.items() if function != ABSOLUTE)
    measured: dict[str, Any] = {}
    if footprint:
        from symstiff.codegen.footprint import measure

        measured = measure(folder, functions, options.single)
    return Verification(True, compiler.name, "", worst, len(found), errors, bounds, measured)


def _built(
    folder: Path, scratch: Path, name: str, options: Options, compiler: Compiler
) -> tuple[Path, float]:
    """The shared library of the code's sources, and the greatest error of its self-test."""
    objects = _objects(folder, scratch, options.sources(name), compiler)
    worst = _run_selftest(folder, scratch, name, compiler, objects)
    return _linked(scratch / f"lib{name}.so", objects, compiler), worst


def _objects(folder: Path, scratch: Path, sources: Sequence[str], compiler: Compiler) -> list[str]:
    def compiled(source: str) -> str:  # one source a command: zig's compiler writes no more than one object
        target = str(scratch / f"{source}.o")
        done = compiler.run(
            [*STRICT, "-O2", "-fPIC", f"-I{folder}", "-c", str(folder / source), "-o", target]
        )
        if done.returncode != 0:
            raise _refused(compiler, "C", done.stderr)
        return target

    return in_threads(compiled, sources)


def _run_selftest(
    folder: Path, scratch: Path, name: str, compiler: Compiler, objects: Sequence[str]
) -> float:
    program = scratch / "selftest"
    source = str(folder / f"test_{name}.c")
    done = compiler.run([*STRICT, f"-I{folder}", source, *objects, "-o", str(program), "-lm"])
    if done.returncode != 0:
        raise _refused(compiler, "self-test", done.stderr)
    run = subprocess.run([str(program)], capture_output=True, text=True, check=False, timeout=60)
    match = re.search(r"error ([-+.0-9e]+)", run.stdout)
    if run.returncode != 0 or match is None:
        raise _wrong(compiler, f"the self-test failed: {run.stdout}{run.stderr}")
    return float(match.group(1))


def _wrong(compiler: Compiler, what: str) -> Exception:
    """Whose fault wrong numbers are: the user's where the user chose compiler and flags."""
    if compiler.chosen:
        return UserError(
            f"$CC ({compiler.name}) makes code that fails its self-test: leave out what changes arithmetic"
        )
    return RuntimeError(what)


def _refused(compiler: Compiler, what: str, told: str) -> Exception:
    """Whose fault it is that code does not compile, in the same way."""
    if compiler.chosen:
        first = next((line for line in told.splitlines() if "error" in line), told.strip())[:200]
        return UserError(
            f"$CC ({compiler.name}) refuses the generated {what}: leave out what adds warnings: {first}"
        )
    return RuntimeError(f"the generated {what} does not compile:\n{told[:2000]}")


def _check_batches(bounds: Mapping[str, float], single: bool, compiler: Compiler) -> None:
    """Raise where a function for many poses differs from the one for a single pose by more than rounding."""
    for function in ("deflection", "observation"):
        error, scalar = bounds.get(f"{function}_batch", 0.0), bounds.get(function, 0.0)
        if not error <= tolerance(single) + 10 * scalar:
            raise _wrong(
                compiler, f"{function} of many poses is wrong by {error:.2g}, that of one by {scalar:.2g}"
            )


def _linked(library: Path, objects: Sequence[str], compiler: Compiler) -> Path:
    done = compiler.run(["-shared", *objects, "-o", str(library), "-lm"])
    if done.returncode != 0:
        raise UserError(f"{compiler.name} could not build a shared library: {done.stderr.strip()[:300]}")
    return library


def build_library(folder: Path, scratch: Path, name: str, compiler: Compiler) -> Path:
    """Compile a shared library of the generated sources of target ``c``."""
    sources = Options(targets=("c",)).sources(name)
    return _linked(scratch / f"lib{name}.so", _objects(folder, scratch, sources, compiler), compiler)


def relative(
    x: Sequence[float] | np.ndarray,
    reference: Sequence[Any],
    blocks: Sequence[slice],
    least: Sequence[float] = (),
) -> float:
    """Greatest difference over the greatest reference value, block by block (translations, rotations).

    ``least``: sizes of the blocks that differences are relative to where these are more.
    """
    a, b = np.asarray(x, float), np.array([float(v) for v in reference])
    worst = 0.0
    for block, smallest in zip(blocks, least or [0.0] * len(blocks), strict=True):
        size = np.abs(b[block]).max(initial=smallest)
        error = np.abs(a[block] - b[block]).max(initial=0.0)
        error = error if np.isfinite(error) else np.inf
        worst = max(worst, float(error / size) if size else float(error))
    return worst


def c_errors(
    library: Path, functions: Functions, found: Sequence[Case], values: Mapping[str, float], single: bool
) -> dict[str, float]:
    """Greatest errors of a compiled library's functions over configurations with 50-digit values."""
    model = functions.model
    loaded, prefix = ctypes.CDLL(str(library)), model.robot.name
    real: Any = ctypes.c_float if single else ctypes.c_double
    n, m = model.robot.dof, len(model.stiffness_parameters)
    p = struct_values(functions, values, real)
    rows, whole = _rows(m), [slice(None)]
    worst: Errors = {}

    def called(function: str, size: int, *inputs: Any) -> list[float]:
        output = (real * size)()
        status = getattr(loaded, f"{prefix}_{function}")(*inputs, output)
        if status:
            raise RuntimeError(f"{prefix}_{function} returned error {status} at a regular pose")
        return list(output)

    def compensated(case: Case, *inputs: Any) -> float:
        """The greatest error of a joint command; a pose that has none is refused as it should be."""
        output = (real * n)()
        status = getattr(loaded, f"{prefix}_compensate")(*inputs, output)
        if case.compensation is None:
            return 0.0
        if status != case.compensation:
            raise RuntimeError(f"{prefix}_compensate returned {status} instead of {case.compensation}")
        return _greatest_difference(list(output), case.q_cmd)

    for case in found:
        q, w = (real * n)(*case.q), (real * 6)(*case.w)
        seen = {
            "deflection": relative(called("deflection", 6, p, q, w), case.dt, TWIST, case.sizes),
            "jacobian": relative(called("jacobian", 6 * n, q), case.J, whole),
            "forward": relative(called("forward", 16, q), case.T, whole),
            "compensate": compensated(case, p, q, w),
        }
        if m:
            seen["observation"] = relative(called("observation", 6 * m, q, w), case.A, rows)
        if case.K is not None:
            seen["stiffness"] = relative(called("stiffness", 36, p, q), case.K, whole) / case.condition
        worst = {k: max(error, worst.get(k, 0.0)) for k, error in seen.items()}
    return worst


def batch_errors(
    library: Path, functions: Functions, found: Sequence[Case], values: Mapping[str, float], single: bool
) -> Errors:
    """Greatest errors of the functions for many poses over an odd number of configurations, in every layout.

    Odd: the last block of poses is never full. ``deflection_batch`` and ``observation_batch`` stand for the strided
    functions and tiles too.
    """
    found = found[: len(found) - 1 + len(found) % 2]
    loaded, prefix, real = (
        ctypes.CDLL(str(library)),
        functions.model.robot.name,
        np.float32 if single else float,
    )
    m = len(functions.model.stiffness_parameters)
    p = struct_values(functions, values, ctypes.c_float if single else ctypes.c_double)
    q, w, n = np.array([c.q for c in found], real), np.array([c.w for c in found], real), len(found)
    by_component = np.ascontiguousarray(q.T), np.ascontiguousarray(w.T)

    def layouts(function: str, size: int, *fixed: Any) -> list[np.ndarray]:
        """What the function gives, (poses, size), for one array a component and for poses one after the other."""
        first, inputs = (*fixed, ctypes.c_size_t(n)), (pointer(q), _strides(q), pointer(w), _strides(w))
        columns, poses = np.zeros((size, n), real), np.zeros((n, size), real)
        called(
            f"{function}_batch", *first, pointer(by_component[0]), pointer(by_component[1]), pointer(columns)
        )
        called(f"{function}_strided", *first, *inputs, pointer(poses), _strides(poses))
        if function != "observation":
            return [columns.T, poses]
        tile = block_size(size, single)
        tiles = np.zeros((-(-n // tile), size, tile), real)
        called(f"{function}_tiles", *first, *inputs, pointer(tiles))
        return [columns.T, poses, tiles.transpose(0, 2, 1).reshape(-1, size)[:n]]

    def called(function: str, *arguments: Any) -> None:
        if status := getattr(loaded, f"{prefix}_{function}")(*arguments):
            raise RuntimeError(f"{prefix}_{function} returned error {status} at a regular pose")

    moved = layouts("deflection", 6, p)
    errors = {
        "deflection_batch": max(
            relative(x, c.dt, TWIST, c.sizes) for r in moved for x, c in zip(r, found, strict=True)
        )
    }
    if m:
        columns = layouts("observation", 6 * m)
        errors["observation_batch"] = max(
            relative(x, c.A, _rows(m)) for r in columns for x, c in zip(r, found, strict=True)
        )
    return errors


def _strides(poses: np.ndarray) -> Any:
    """Strides of an array with one pose after the other: of a component, of a pose."""
    return (ctypes.c_size_t * 2)(1, poses.shape[1])


def _rows(m: int) -> list[slice]:
    """The six rows of an observation matrix of m columns."""
    return [slice(r * m, (r + 1) * m) for r in range(6)]


def struct_values(functions: Functions, values: Mapping[str, float], real: Any) -> Any:
    """The C struct of parameters as an array, with what holds at the moment as tested."""
    model = functions.model
    numbers = [*model.vector(values), *(m.tested for m in moments(model, functions.deflection))]
    return (real * len(numbers))(*numbers)


def _greatest_difference(x: Sequence[float], reference: Sequence[Any]) -> float:
    return max(abs(float(a - b)) for a, b in zip(x, reference, strict=True))


def _casadi_error(
    folder: Path, functions: Functions, found: Sequence[Case], values: dict[str, float]
) -> float:
    """The greatest error of all functions that CasADi loads."""
    import casadi as ca

    model, name = functions.model, functions.model.robot.name
    blocks = {"deflection": TWIST, "observation": _rows(len(model.stiffness_parameters))}
    worst = 0.0
    for program in functions.all:
        function = ca.Function.load(str(folder / f"{name}_{program.name}.casadi"))
        moment = [m.tested for m in moments(model, program)]
        for c in found:
            given = {"p": model.vector(values), "q": c.q, "w": c.w, "context": moment}
            expected = {"dt": c.dt, "A": c.A, "J": c.J, "C": c.C, "T": c.T}[program.outputs[0][0]]
            result = np.array(function(*(given[v.name] for v in program.inputs))).ravel()
            least = c.sizes if program.name == "deflection" else ()
            worst = max(worst, relative(result, expected, blocks.get(program.name, [slice(None)]), least))
    return worst
