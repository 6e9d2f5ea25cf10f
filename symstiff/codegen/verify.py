"""Proof of what was generated: compiled strictly, self-tested, and compared with CasADi and 50 digits at random inputs."""

from __future__ import annotations

import ctypes
import re
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from symstiff.codegen.compiler import STRICT, Compiler
from symstiff.codegen.functions import Functions
from symstiff.codegen.reference import Case, cases, test_values
from symstiff.errors import UserError


@dataclass(frozen=True)
class Verification:
    """What was compiled and seen: greatest relative errors by pair, code size and stack by function [bytes]."""

    compiled: bool
    compiler: str = ""
    selftest: float | None = None
    errors: dict[str, float] = field(default_factory=dict)
    code_bytes: dict[str, int] = field(default_factory=dict)
    stack_bytes: dict[str, int] = field(default_factory=dict)

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
            "max_relative_error": self.max_relative_error,
            "selftest_error": self.selftest,
            "errors": self.errors,
            "code_bytes": self.code_bytes,
            "stack_bytes": self.stack_bytes,
        }


def verify(
    folder: Path, functions: Functions, compiler: Compiler | None, single: bool, casadi: bool, c: bool = True
) -> Verification:
    """Compile and run the self-test in a scratch folder, then compare all evaluations of the model."""
    values = test_values(functions.model)
    found = cases(functions, values, n=4, seed=23)
    errors: dict[str, float] = {}
    if casadi:
        errors["casadi"] = _casadi_error(folder, functions, found, values)
    if compiler is None or not c:
        return Verification(False, errors=errors)
    with tempfile.TemporaryDirectory() as scratch:
        name = functions.model.robot.name
        worst = _run_selftest(folder, Path(scratch), name, compiler)
        library = build_library(folder, Path(scratch), name, compiler)
        errors["c"] = _c_error(library, functions, found, values, single)
        sizes, stacks = _footprint(folder, Path(scratch), name, compiler)
    return Verification(True, compiler.name, worst, errors, sizes, stacks)


def _run_selftest(folder: Path, scratch: Path, name: str, compiler: Compiler) -> float:
    program = scratch / "selftest"
    sources = [str(folder / f) for f in (f"{name}.c", f"{name}_selftest.c", f"test_{name}.c")]
    done = compiler.run([*STRICT, "-O2", f"-I{folder}", *sources, "-o", str(program), "-lm"])
    if done.returncode != 0:
        raise RuntimeError(f"the generated C does not compile:\n{done.stderr[:2000]}")
    run = subprocess.run([str(program)], capture_output=True, text=True, check=False, timeout=60)
    match = re.search(r"error ([-+.0-9e]+)", run.stdout)
    if run.returncode != 0 or match is None:
        raise RuntimeError(f"the self-test failed: {run.stdout}{run.stderr}")
    return float(match.group(1))


def build_library(folder: Path, scratch: Path, name: str, compiler: Compiler, flags: Sequence[str] = ("-O2",)) -> Path:
    """Compile a shared library of the generated sources."""
    library = scratch / f"lib{name}.so"
    sources = [str(folder / f"{name}.c"), str(folder / f"{name}_selftest.c")]
    done = compiler.run([*STRICT, *flags, "-fPIC", "-shared", f"-I{folder}", *sources, "-o", str(library), "-lm"])
    if done.returncode != 0:
        raise UserError(f"{compiler.name} could not build a shared library: {done.stderr.strip()[:300]}")
    return library


def relative(x: Sequence[float] | np.ndarray, reference: Sequence[Any], blocks: Sequence[slice]) -> float:
    """Greatest difference over the greatest reference value, block by block (translations, rotations)."""
    a, b = np.asarray(x, float), np.array([float(v) for v in reference])
    worst = 0.0
    for block in blocks:
        size = np.abs(b[block]).max(initial=0.0)
        error = np.abs(a[block] - b[block]).max(initial=0.0)
        worst = max(worst, float(error / size) if size else float(error))
    return worst


TWIST = (slice(0, 3), slice(3, 6))


def _c_error(
    library: Path, functions: Functions, found: Sequence[Case], values: dict[str, float], single: bool
) -> float:
    model = functions.model
    loaded = ctypes.CDLL(str(library))
    real: Any = ctypes.c_float if single else ctypes.c_double
    n, m = model.robot.dof, len(model.stiffness_parameters)
    p = (real * len(model.parameters))(*model.vector(values))
    worst = 0.0
    for case in found:
        q, w = (real * n)(*case.q), (real * 6)(*case.w)
        dt, A = (real * 6)(), (real * (6 * m))()
        prefix = model.robot.name
        if getattr(loaded, f"{prefix}_deflection")(p, q, w, dt) or getattr(loaded, f"{prefix}_observation")(q, w, A):
            raise RuntimeError("a generated function returned an error at a regular pose")
        rows = [slice(r * m, (r + 1) * m) for r in range(6)]
        worst = max(worst, relative(dt, case.dt, TWIST), relative(A, case.A, rows))
    return worst


def _casadi_error(folder: Path, functions: Functions, found: Sequence[Case], values: dict[str, float]) -> float:
    import casadi as ca

    model, name = functions.model, functions.model.robot.name
    deflection = ca.Function.load(str(folder / f"{name}_deflection.casadi"))
    observation = ca.Function.load(str(folder / f"{name}_observation.casadi"))
    m = len(model.stiffness_parameters)
    worst = 0.0
    for case in found:
        context = [[1.0] * (deflection.numel_in(3))] if deflection.n_in() > 3 else []
        dt = np.array(deflection(model.vector(values), case.q, case.w, *context)).ravel()
        extra = [[1.0] * observation.numel_in(2)] if observation.n_in() > 2 else []
        A = np.array(observation(case.q, case.w, *extra)).ravel()
        rows = [slice(r * m, (r + 1) * m) for r in range(6)]
        worst = max(worst, relative(dt, case.dt, TWIST), relative(A, case.A, rows))
    return worst


def _footprint(folder: Path, scratch: Path, name: str, compiler: Compiler) -> tuple[dict[str, int], dict[str, int]]:
    """Bytes of code and of static stack of every public function, where the compiler tells (gcc)."""
    done = compiler.run(
        ["-std=c99", "-O2", "-fstack-usage", "-c", f"-I{folder}", str(folder / f"{name}.c"), "-o", "m.o"], cwd=scratch
    )
    usage = scratch / "m.su"
    if done.returncode != 0 or not usage.exists():
        return {}, {}
    stacks = {}
    for line in usage.read_text().splitlines():
        place, size, _ = line.split("\t")
        stacks[place.rsplit(":", 1)[1]] = int(size)
    sizes = {}
    listed = subprocess.run(["nm", "-S", "--defined-only", "m.o"], cwd=scratch, capture_output=True, text=True, check=False)
    for line in listed.stdout.splitlines():
        parts = line.split()
        if len(parts) == 4 and parts[2] in "tT":
            sizes[parts[3]] = int(parts[1], 16)
    return sizes, {k: v for k, v in stacks.items() if not k.endswith(".part.0")}
