"""Whole-workspace speed: batches against a loop over the scalar function, CasADi's map and vectorised NumPy.

Run: python -m tests.benchmarks.bench_batch [--robot kuka_kr270] [--poses 20000] [--loads gravity] [--flags="-O3 …"]

Best of many rounds in which the contestants take turns, ns a pose. Bars: 5 times the scalar loop and 20 times NumPy,
on a machine with AVX2 or AVX-512.

An observation matrix is 6 × P numbers to write, so the working set decides. It is measured in three: outputs of 16
poses (first-level cache: whoever uses a tile at once), of 128 poses (second-level) and of all poses (memory), beside
``memset`` of the same bytes, which is about what memory allows. The bar of 5 holds in the caches; in memory the batches
may not be slower than the scalar loop.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np

from symstiff.codegen.casadi import casadi_functions
from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.emit import emit_c
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.robot import load

# outputs are written to the same `part` poses over and over: `part` sets the working set
LOOP = """
#include <string.h>
#include "{name}.h"
#define PARTS for (size_t b = 0; b + part <= n; b += part)
#define BOTH const size_t in[2] = {{n, 1}}
void loop_deflection(const {name}_params_t *p, size_t n, const double *q, const double *w, double *dt);
void loop_observation(size_t n, size_t part, const double *q, const double *w, double *A);
void parts_tiles(size_t n, size_t part, const double *q, const double *w, double *A);
void parts_components(size_t n, size_t part, const double *q, const double *w, double *A);
void parts_poses(size_t n, size_t part, const double *q, const double *w, double *A);
void parts_floor(size_t n, size_t part, const double *q, const double *w, double *A);
void loop_deflection(const {name}_params_t *p, size_t n, const double *q, const double *w, double *dt)
{{
    for (size_t i = 0; i < n; ++i) (void){name}_deflection(p, q + {dof} * i, w + 6 * i, dt + 6 * i);
}}
void loop_observation(size_t n, size_t part, const double *q, const double *w, double *A)
{{
    PARTS for (size_t i = 0; i < part; ++i)
        (void){name}_observation(q + {dof} * (b + i), w + 6 * (b + i), A + {size} * i);
}}
void parts_tiles(size_t n, size_t part, const double *q, const double *w, double *A)
{{
    BOTH;
    PARTS (void){name}_observation_tiles(part, q + b, in, w + b, in, A);
}}
void parts_components(size_t n, size_t part, const double *q, const double *w, double *A)
{{
    BOTH;
    const size_t out[2] = {{part, 1}};
    PARTS (void){name}_observation_strided(part, q + b, in, w + b, in, A, out);
}}
void parts_poses(size_t n, size_t part, const double *q, const double *w, double *A)
{{
    BOTH;
    const size_t out[2] = {{1, {size}}};
    PARTS (void){name}_observation_strided(part, q + b, in, w + b, in, A, out);
}}
void parts_floor(size_t n, size_t part, const double *q, const double *w, double *A)
{{
    (void)q, (void)w;
    PARTS memset(A, (int)b, part * {size} * sizeof(double));
}}
"""
WIDE = "-O3 -march=native -mprefer-vector-width=512 -ffp-contract=fast"
PARTS = {"first-level cache": 16, "second-level cache": 128}
SCALAR = "loop over the scalar C function"
FLOOR = "memset of the same bytes"


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


def build(model: StiffnessModel, folder: Path, flags: str) -> tuple[ctypes.CDLL, str]:
    """The generated sources and the loop, as one shared library; scalar files with the same flags."""
    compiler = find_compiler()
    if compiler is None:
        raise SystemExit("no C compiler was found")
    name = model.robot.name
    write_tree(folder, emit_c(Functions(model), Options(targets=("c",))))
    size = 6 * len(model.stiffness_parameters)
    (folder / "loop.c").write_text(LOOP.format(name=name, dof=model.robot.dof, size=size))
    sources = [f"{name}.c", f"{name}_batch.c", "loop.c"]
    done = compiler.run(
        ["-std=c99", *flags.split(), "-shared", "-fPIC", *sources, "-o", "all.so", "-lm"], cwd=folder
    )
    if done.returncode:
        raise SystemExit(done.stderr)
    version = subprocess.run(
        [*compiler.command, "--version"], capture_output=True, text=True, check=False
    ).stdout
    return ctypes.CDLL(str(folder / "all.so")), version.splitlines()[0]


@dataclass(frozen=True)
class Case:
    """A model, its library, poses q (N, n), wrenches w (N, 6), and how to measure."""

    model: StiffnessModel
    library: ctypes.CDLL
    q: np.ndarray
    w: np.ndarray
    values: Mapping[str, float]
    threads: int
    rounds: int

    def __len__(self) -> int:
        return len(self.q)


def python_side(case: Case, what: str) -> dict[str, Callable[[], object]]:
    """Contestants that are called from Python on arrays."""
    model, threads, n = case.model, case.threads, len(case)
    p = model.vector(case.values)
    shape = (n, 6) if what == "deflection" else (n, 6, len(model.parameters))
    arguments = (case.q, case.w, case.values) if what == "deflection" else (case.q, case.w)
    function = casadi_functions(Functions(model))[what]
    first = [p] if what == "deflection" else []
    inputs = [*first, ca.DM(case.q.T.copy()), ca.DM(case.w.T.copy())]
    one, many, out = model.compile(), model.compile(threads=threads), np.empty(shape)
    return {
        "model.compile(), new array": partial(getattr(one, what), *arguments),
        "model.compile(), array given": partial(getattr(one, what), *arguments, out=out),
        f"model.compile(threads={threads}), given": partial(getattr(many, what), *arguments, out=out),
        "CasADi map, serial": partial(function.map(n), *inputs),
        f"CasADi map, {threads} threads": partial(function.map(n, "thread", threads), *inputs),
        "NumPy": partial(getattr(model, what), *arguments),
    }


def deflections(case: Case) -> None:
    """The table of deflections, and its bars."""
    n, name = len(case), case.model.robot.name
    p, out = case.model.vector(case.values), np.empty((n, 6))
    qs, ws, outs = case.q.T.copy(), case.w.T.copy(), np.empty((6, n))
    count = ctypes.c_size_t(n)
    batch = partial(getattr(case.library, f"{name}_deflection_batch"), pointer(p), count)
    calls: dict[str, Callable[[], object]] = {
        SCALAR: partial(
            case.library.loop_deflection, pointer(p), count, pointer(case.q), pointer(case.w), pointer(out)
        ),
        "batch": partial(batch, pointer(qs), pointer(ws), pointer(outs)),
    }
    rows = measured(calls | python_side(case, "deflection"), n, case.rounds)
    report(f"deflection, {n} poses", rows, np.abs(outs.T - out).max() / np.abs(out).max())
    bar(5, "the scalar loop, deflection", rows[SCALAR] / rows["batch"])
    bar(20, "NumPy, deflection", rows["NumPy"] / min(rows["batch"], rows["model.compile(), array given"]))


def observations(case: Case, where: str, part: int, python: bool = False) -> None:
    """The table of observation matrices written to ``part`` poses over and over, and its bars."""
    n, size = len(case) // part * part, 6 * len(case.model.stiffness_parameters)
    qs, ws = case.q[:n].T.copy(), case.w[:n].T.copy()
    buffers = {k: aligned(size * (part + 8)) for k in ("scalar", "tiles", "components", "poses", "floor")}
    counts = ctypes.c_size_t(n), ctypes.c_size_t(part)

    def call(function: str, buffer: str, q: np.ndarray, w: np.ndarray) -> Callable[[], object]:
        return partial(
            getattr(case.library, function), *counts, pointer(q), pointer(w), pointer(buffers[buffer])
        )

    calls = {
        SCALAR: call("loop_observation", "scalar", case.q, case.w),
        "batch, tiles": call("parts_tiles", "tiles", qs, ws),
        "batch, one array a component": call("parts_components", "components", qs, ws),
        "batch, pose after pose": call("parts_poses", "poses", qs, ws),
        FLOOR: call("parts_floor", "floor", qs, ws),
    }
    rows = measured(calls | (python_side(case, "observation") if python else {}), n, case.rounds)
    scalar = buffers["scalar"][: size * part].reshape(part, size)
    difference = max(
        np.abs(found - scalar).max() / np.abs(scalar).max()
        for found in (
            buffers["tiles"][: size * (-(-part // 8) * 8)]
            .reshape(-1, size, 8)
            .swapaxes(1, 2)
            .reshape(-1, size)[:part],
            buffers["components"][: size * part].reshape(size, part).T,
            buffers["poses"][: size * part].reshape(part, size),
        )
    )
    report(f"observation matrices, outputs of {part} poses ({where})", rows, difference)
    if part < n:
        bar(5, f"the scalar loop, tiles ({where})", ratio(rows, "batch, tiles"))
        return
    print(f"memory: memset of the same bytes is {ratio(rows, FLOOR):.1f} times the scalar loop")
    for kind in ("batch, tiles", "batch, one array a component"):
        bar(1, f"the scalar loop, {kind} ({where})", ratio(rows, kind))


def aligned(numbers: int) -> np.ndarray:
    """Zeros that begin at a cache line."""
    raw = np.zeros(numbers + 8)
    begin = -raw.ctypes.data % 64 // 8
    return raw[begin : begin + numbers]


def measured(calls: Mapping[str, Callable[[], object]], n: int, rounds: int) -> dict[str, float]:
    """Least time [ns a pose] by contestant; they take turns, so that a busy machine is busy for all."""
    seen = dict.fromkeys(calls, np.inf)
    for k in range(rounds + 1):
        for name, call in calls.items():
            if k > 3 and name[:5] in ("CasAD", "NumPy"):
                continue
            start = time.perf_counter()
            call()
            if k:
                seen[name] = min(seen[name], (time.perf_counter() - start) / n * 1e9)
    return seen


def ratio(rows: Mapping[str, float], name: str) -> float:
    return rows[SCALAR] / rows[name]


def report(title: str, rows: Mapping[str, float], difference: float) -> None:
    """The table."""
    print(f"\n{title}: greatest difference between batch and loop {difference:.1e} of the greatest value")
    print(f"{'':36}{'ns/pose':>10}{'loop / it':>11}")
    for name, time_ns in rows.items():
        print(f"{name:36}{time_ns:10.1f}{ratio(rows, name):11.1f}")


def bar(wanted: float, of: str, found: float) -> None:
    print(f"bar: {wanted} times {of}: {found:.1f} {'met' if found >= wanted else 'MISSED'}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robot", default="kuka_kr270")
    parser.add_argument("--loads", default="gravity")
    parser.add_argument("--poses", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--flags", default=WIDE)
    options = parser.parse_args()
    model = StiffnessModel.of(reduce(load(options.robot), loads=options.loads))
    rng = np.random.default_rng(0)
    n, dof = options.poses, model.robot.dof
    ranges = np.array([j.range for j in model.robot.joint])
    q, w = rng.uniform(ranges[:, 0], ranges[:, 1], (n, dof)), rng.uniform(-1000, 1000, (n, 6))
    values = dict.fromkeys(model.parameters, 1e-7)
    with tempfile.TemporaryDirectory() as scratch:
        library, compiler = build(model, Path(scratch), options.flags)
        print(f"{options.robot}: {len(model.parameters)} parameters, {n} poses, {compiler}, {options.flags}")
        case = Case(model, library, q, w, values, os.cpu_count() or 1, options.rounds)
        deflections(case)
        for where, part in PARTS.items():
            observations(case, where, part)
        observations(case, "memory", n, python=True)


if __name__ == "__main__":
    main()
