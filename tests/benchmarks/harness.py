"""One program that holds all competitors: verified against each other, timed in turns, counted by callgrind."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from symstiff.codegen.footprint_parse import call_graph, instructions_per_call, symbol_sizes, totals
from tests.benchmarks.case import Case
from tests.benchmarks.peer import Peer

FLAGS = ("-O2",)


@dataclass(frozen=True)
class Measured:
    """ns per call (least and median), code and stack with everything called, instructions per call; 0: not known."""

    least: float
    median: float
    code: int
    stack: int
    instructions: int


@dataclass(frozen=True)
class Built:
    """The program and its folder."""

    folder: Path
    program: Path
    peers: tuple[Peer, ...]
    case: Case

    def outputs(self) -> list[np.ndarray]:
        """Values of every competitor at every input: (INPUTS, 6) or (INPUTS, 6, P)."""
        _run([str(self.program), "values", "values.bin"], self.folder)
        flat = np.fromfile(self.folder / "values.bin")
        found, start = [], 0
        for peer in self.peers:
            shape = _shape(self.case, peer)
            size = len(self.case.inputs) * int(np.prod(shape))
            values = flat[start : start + size].reshape(
                len(self.case.inputs), *(shape[::-1] if peer.by_columns else shape)
            )
            found.append(values.swapaxes(1, 2) if peer.by_columns and len(shape) == 2 else values)
            start += size
        return found

    def times(self, repeat: int) -> np.ndarray:
        """ns per call (repeat, competitors + 1): the competitors take turns; last column: sines and cosines alone."""
        printed = _run([str(self.program), "time", str(repeat)], self.folder)
        return np.array([[float(x) for x in line.split()] for line in printed.splitlines()])

    def instructions(self) -> dict[str, int]:
        """Instructions per call by competitor's number, library included; empty without valgrind."""
        if shutil.which("valgrind") is None:
            return {}
        command = [
            "valgrind",
            "--tool=callgrind",
            "--callgrind-out-file=counts",
            str(self.program),
            "values",
            "/dev/null",
        ]
        _run(command, self.folder)
        return instructions_per_call((self.folder / "counts").read_text(), "bench_")

    def size(self, peer: Peer) -> tuple[int, int]:
        """Code and stack [bytes] of a competitor with everything of its own that it calls."""
        for listing in sorted(self.folder.glob("*.ci")):
            graph = call_graph(listing.read_text())
            if peer.entry in graph.stack:
                sizes = symbol_sizes(_run(["nm", "-S", "--defined-only", f"{listing.stem}.o"], self.folder))
                entry = totals(graph, sizes, {"it": peer.entry})["it"]
                return entry["code"], entry["stack"]
        return 0, 0

    def measured(self, repeat: int) -> tuple[list[Measured], float]:
        """All figures of every competitor, and ns of the sines and cosines alone."""
        times, counts = self.times(repeat), self.instructions()
        figures = []
        for i, peer in enumerate(self.peers):
            code, stack = self.size(peer)
            figures.append(
                Measured(times[:, i].min(), float(np.median(times[:, i])), code, stack, counts.get(f"{i}", 0))
            )
        return figures, float(times[:, -1].min())


def _shape(case: Case, peer: Peer) -> tuple[int, ...]:
    return (6,) if peer.quantity == "deflection" else (6, len(case.entries))


def _run(command: Sequence[str], cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=900)
    if done.returncode:
        raise RuntimeError(f"{command[0]}: {done.stderr[:3000]}")
    return done.stdout


def build(case: Case, peers: Sequence[Peer], folder: Path) -> Built:
    """Compile every competitor with the same flags and link them into one program."""
    sources: dict[str, str] = {}
    for peer in peers:
        sources |= peer.sources
    sources["main.c"] = main_source(case, peers)
    for name, text in sources.items():
        (folder / name).write_text(text)
    objects = []
    for name in sorted(n for n in sources if not n.endswith(".h")):
        compiler = ["g++", "-std=c++17"] if name.endswith(".cpp") else ["gcc", "-std=gnu11"]
        target = f"{Path(name).stem}.o"
        _run([*compiler, *FLAGS, "-fcallgraph-info=su", "-I.", "-c", name, "-o", target], folder)
        objects.append(target)
    _run(["gcc", *objects, "-o", "bench", "-lm", "-lstdc++"], folder)
    return Built(folder, folder / "bench", tuple(peers), case)


def main_source(case: Case, peers: Sequence[Peer]) -> str:
    """The C program: ``values FILE`` or ``time REPEATS``."""
    n, width = case.dof, case.dof + 6
    rows = ",\n".join("{" + ", ".join(repr(float(x)) for x in row) + "}" for row in case.inputs)
    values = ", ".join(repr(float(x)) for x in case.values)
    declarations = "\n".join(dict.fromkeys(p.declaration for p in peers))
    # as callgrind reads it, the caller's cost is its callee's: one call each
    calls = "\n".join(
        f"static __attribute__((noinline)) void bench_{i}(const double *x, double *y)\n{{ call_{i}(x, y); }}"
        for i in range(len(peers))
    )
    bodies = "\n".join(
        f"static __attribute__((noinline)) void call_{i}(const double *x, double *y)\n"
        f"{{ const double *q = x; const double *w = x + {n}; (void)q; (void)w; {p.call} }}"
        for i, p in enumerate(peers)
    )
    table = ", ".join(f"bench_{i}" for i in range(len(peers)))
    sizes = ", ".join(str(int(np.prod(_shape(case, p)))) for p in peers)
    pairs = " ".join(f"y[{2 * i}] = sin(x[{i}]); y[{2 * i + 1}] = cos(x[{i}]);" for i in range(n))
    return f"""#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
{declarations}
#define N {len(case.inputs)}
#define PEERS {len(peers)}
static const double inputs[N][{width}] = {{
{rows}
}};
static double k[{len(case.entries)}] = {{ {values} }};
static double y[{6 * max(len(case.entries), n)}];
static volatile double sink;
{bodies}
{calls}
static __attribute__((noinline)) void bench_trig(const double *x, double *y) {{ {pairs} }}
static void (*const call[PEERS + 1])(const double *, double *) = {{ {table}, bench_trig }};
static const int size[PEERS] = {{ {sizes} }};

static double nanoseconds(void)
{{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}}

int main(int argc, char **argv)
{{
    if (argc == 3 && !strcmp(argv[1], "values")) {{
        FILE *file = fopen(argv[2], "wb");
        if (file == NULL) return 1;
        for (int i = 0; i < PEERS; ++i) {{
            for (int j = 0; j < N; ++j) {{
                for (int l = 0; l < size[i]; ++l) y[l] = NAN;
                call[i](inputs[j], y);
                fwrite(y, sizeof *y, (size_t)size[i], file);
            }}
        }}
        return fclose(file);
    }}
    for (int repeat = atoi(argv[2]); repeat > 0; --repeat) {{
        for (int i = 0; i <= PEERS; ++i) {{
            double total = 0.0;
            const double start = nanoseconds();
            for (int j = 0; j < N; ++j) {{
                call[i](inputs[j], y);
                total += y[j & 3];
            }}
            printf("%.2f ", (nanoseconds() - start) / N);
            sink = total;
        }}
        printf("\\n");
    }}
    return 0;
}}
"""
