"""Proof of what was generated: compiled strictly, self-tested, and held against 50 digits."""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from symstiff.codegen.compiler import STRICT, Compiler
from symstiff.codegen.functions import Functions
from symstiff.codegen.names import moments
from symstiff.codegen.options import Options
from symstiff.codegen.reference import Case, cases, plausible_values
from symstiff.errors import UserError

CONFIGURATIONS = 64  # random ones over the joint range that the bounds of a compiled library are measured at
TWIST = (slice(0, 3), slice(3, 6))


@dataclass(frozen=True)
class Verification:
    """What was compiled and seen: greatest relative errors by function, against 50-digit values.

    reason: why nothing was compiled, "" where it was or nobody wanted it.
    errors: CasADi's and C's greatest; bounds: C's by function, the stiffness matrix's divided by its condition
    number, the compensated joint variables' absolute [rad, m]; footprint: code, stack, instructions by machine.
    """

    compiled: bool
    compiler: str = ""
    reason: str = ""
    selftest: float | None = None
    errors: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, float] = field(default_factory=dict)
    footprint: dict[str, Any] = field(default_factory=dict)

    @property
    def max_relative_error(self) -> float | None:
        """The greatest error seen anywhere."""
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
            "bounds": {"configurations": CONFIGURATIONS, **self.bounds} if self.bounds else {},
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
    found = cases(functions, values, CONFIGURATIONS if compiler else 4, 23, options.single)
    errors: dict[str, float] = {}
    if "casadi" in options.targets:
        errors["casadi"] = _casadi_error(folder, functions, found[:4], values)
    if compiler is None:
        return Verification(False, reason=reason, errors=errors)
    with tempfile.TemporaryDirectory() as scratch:
        name = functions.model.robot.name
        objects = _objects(folder, Path(scratch), options.sources(name), compiler)
        worst = _run_selftest(folder, Path(scratch), name, compiler, objects)
        library = _linked(Path(scratch) / f"lib{name}.so", objects, compiler)
        bounds = c_errors(library, functions, found, values, options.single)
    errors["c"] = max(bounds.values())
    measured: dict[str, Any] = {}
    if footprint:
        from symstiff.codegen.footprint import measure

        measured = measure(folder, functions, options.single)
    return Verification(True, compiler.name, "", worst, errors, bounds, measured)


def _objects(folder: Path, scratch: Path, sources: Sequence[str], compiler: Compiler) -> list[str]:
    objects = []
    for source in sources:  # one at a time: zig's compiler writes no more than one object
        target = str(scratch / f"{source}.o")
        done = compiler.run(
            [*STRICT, "-O2", "-fPIC", f"-I{folder}", "-c", str(folder / source), "-o", target]
        )
        if done.returncode != 0:
            raise RuntimeError(f"the generated C does not compile:\n{done.stderr[:2000]}")
        objects.append(target)
    return objects


def _run_selftest(
    folder: Path, scratch: Path, name: str, compiler: Compiler, objects: Sequence[str]
) -> float:
    program = scratch / "selftest"
    source = str(folder / f"test_{name}.c")
    done = compiler.run([*STRICT, f"-I{folder}", source, *objects, "-o", str(program), "-lm"])
    if done.returncode != 0:
        raise RuntimeError(f"the generated self-test does not compile:\n{done.stderr[:2000]}")
    run = subprocess.run([str(program)], capture_output=True, text=True, check=False, timeout=60)
    match = re.search(r"error ([-+.0-9e]+)", run.stdout)
    if run.returncode != 0 or match is None:
        if os.environ.get("CC"):
            raise UserError(
                f"$CC ({compiler.name}) makes code that fails its self-test: leave out what changes arithmetic"
            )
        raise RuntimeError(f"the self-test failed: {run.stdout}{run.stderr}")
    return float(match.group(1))


def _linked(library: Path, objects: Sequence[str], compiler: Compiler) -> Path:
    done = compiler.run(["-shared", *objects, "-o", str(library), "-lm"])
    if done.returncode != 0:
        raise UserError(f"{compiler.name} could not build a shared library: {done.stderr.strip()[:300]}")
    return library


def build_library(folder: Path, scratch: Path, name: str, compiler: Compiler) -> Path:
    """Compile a shared library of the generated sources of target ``c``."""
    sources = Options(targets=("c",)).sources(name)
    return _linked(scratch / f"lib{name}.so", _objects(folder, scratch, sources, compiler), compiler)


def relative(x: Sequence[float] | np.ndarray, reference: Sequence[Any], blocks: Sequence[slice]) -> float:
    """Greatest difference over the greatest reference value, block by block (translations, rotations)."""
    a, b = np.asarray(x, float), np.array([float(v) for v in reference])
    worst = 0.0
    for block in blocks:
        size = np.abs(b[block]).max(initial=0.0)
        error = np.abs(a[block] - b[block]).max(initial=0.0)
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
    rows, whole = [slice(r * m, (r + 1) * m) for r in range(6)], [slice(None)]
    worst: dict[str, float] = {}

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
            "deflection": relative(called("deflection", 6, p, q, w), case.dt, TWIST),
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
    import casadi as ca

    model, name = functions.model, functions.model.robot.name
    deflection = ca.Function.load(str(folder / f"{name}_deflection.casadi"))
    m = len(model.stiffness_parameters)
    observation = ca.Function.load(str(folder / f"{name}_observation.casadi")) if m else None
    worst = 0.0
    for case in found:
        context = [[m.tested for m in moments(model, functions.deflection)]] if deflection.n_in() > 3 else []
        dt = np.array(deflection(model.vector(values), case.q, case.w, *context)).ravel()
        worst = max(worst, relative(dt, case.dt, TWIST))
        if observation is not None:
            extra = (
                [[x.tested for x in moments(model, functions.observation)]] if observation.n_in() > 2 else []
            )
            A = np.array(observation(case.q, case.w, *extra)).ravel()
            worst = max(worst, relative(A, case.A, [slice(r * m, (r + 1) * m) for r in range(6)]))
    return worst
