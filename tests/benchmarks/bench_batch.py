"""Whole-workspace speed: batches against a loop over the scalar function, CasADi's map and vectorised NumPy.

Run: python -m tests.benchmarks.bench_batch [--robot kuka_kr270] [--poses 20000] [--loads gravity] [--flags="-O3 …"]

Best of several rounds, ns a pose. Bars: 5 times the scalar loop and 20 times NumPy for deflections, on a machine with
AVX2 or AVX-512. An observation matrix is 6 × P numbers to write: with many poses memory sets the pace, so they are
measured with a tenth of the poses too.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
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

LOOP = """
#include "{name}.h"
void loop_deflection(const {name}_params_t *p, size_t n, const double *q, const double *w, double *dt);
void loop_observation(size_t n, const double *q, const double *w, double *A);
void loop_deflection(const {name}_params_t *p, size_t n, const double *q, const double *w, double *dt)
{{
    for (size_t i = 0; i < n; ++i) (void){name}_deflection(p, q + {dof} * i, w + 6 * i, dt + 6 * i);
}}
void loop_observation(size_t n, const double *q, const double *w, double *A)
{{
    for (size_t i = 0; i < n; ++i) (void){name}_observation(q + {dof} * i, w + 6 * i, A + {size} * i);
}}
"""
WIDE = "-O3 -march=native -mprefer-vector-width=512 -ffp-contract=fast"


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


def best(call: Callable[[], object], poses: int, rounds: int) -> float:
    """Least time of several calls [ns a pose]."""
    call()
    seen = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        seen.append(time.perf_counter() - start)
    return min(seen) / poses * 1e9


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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robot", default="kuka_kr270")
    parser.add_argument("--loads", default="gravity")
    parser.add_argument("--poses", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--flags", default=WIDE)
    options = parser.parse_args()
    model = StiffnessModel.of(reduce(load(options.robot), loads=options.loads))
    rng = np.random.default_rng(0)
    n, dof = options.poses, model.robot.dof
    ranges = np.array([j.range for j in model.robot.joint])
    q, w = rng.uniform(ranges[:, 0], ranges[:, 1], (n, dof)), rng.uniform(-1000, 1000, (n, 6))
    values = dict.fromkeys(model.parameters, 1e-7)
    p, threads = model.vector(values), os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as scratch:
        library, compiler = build(model, Path(scratch), options.flags)
        print(f"{options.robot}: {len(model.parameters)} parameters, {n} poses, {compiler}, {options.flags}")
        for what, k in (("deflection", n), ("observation", n), ("observation", n // 10)):
            rows = measured(what, model, library, (p, q[:k], w[:k], values), threads, options.rounds)
            report(what, rows)


def measured(
    what: str,
    model: StiffnessModel,
    library: ctypes.CDLL,
    data: tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, float]],
    threads: int,
    rounds: int,
) -> dict[str, float]:
    """ns a pose, by contestant."""
    p, q, w, values = data
    n, name = len(q), model.robot.name
    size = 6 if what == "deflection" else 6 * len(model.stiffness_parameters)
    first = [pointer(p)] if what == "deflection" else []
    out, count = np.empty((n, size)), ctypes.c_size_t(n)
    qs, ws, outs = q.T.copy(), w.T.copy(), np.empty((size, n))
    loop, batch = getattr(library, f"loop_{what}"), getattr(library, f"{name}_{what}_batch")
    one, many = model.compile(), model.compile(threads=threads)
    arguments = (q, w, values) if what == "deflection" else (q, w)
    function = casadi_functions(Functions(model))[what]
    inputs = ([p] if what == "deflection" else []) + [ca.DM(qs), ca.DM(ws)]
    serial, threaded = function.map(n), function.map(n, "thread", threads)
    contestants: dict[str, Callable[[], object]] = {
        "loop over the scalar C function": lambda: loop(*first, count, pointer(q), pointer(w), pointer(out)),
        "batch, one array a component": lambda: batch(*first, count, pointer(qs), pointer(ws), pointer(outs)),
        "model.compile()": lambda: getattr(one, what)(*arguments),
        f"model.compile(threads={threads})": lambda: getattr(many, what)(*arguments),
        "CasADi map, serial": lambda: serial(*inputs),
        f"CasADi map, {threads} threads": lambda: threaded(*inputs),
        "NumPy": lambda: getattr(model, what)(*arguments),
    }
    rows = {k: best(call, n, rounds if k[0] not in "CN" else 3) for k, call in contestants.items()}
    difference = np.abs(outs.T - out).max() / np.abs(out).max()
    print(
        f"\n{what}, {n} poses: greatest difference between batch and loop {difference:.1e} of the greatest value"
    )
    return rows


def report(what: str, rows: dict[str, float]) -> None:
    """The table, and the bars."""
    loop, batch = rows["loop over the scalar C function"], rows["batch, one array a component"]
    print(f"{'':36}{'ns/pose':>10}{'loop / it':>11}")
    for name, time_ns in rows.items():
        print(f"{name:36}{time_ns:10.1f}{loop / time_ns:11.1f}")
    if what == "deflection":
        fast = min(batch, rows["model.compile()"])
        for bar, ratio in ((5, loop / batch), (20, rows["NumPy"] / fast)):
            of = "the scalar loop" if bar == 5 else "NumPy"
            print(f"bar: {bar} times {of}: {ratio:.1f} {'met' if ratio >= bar else 'MISSED'}")


if __name__ == "__main__":
    main()
