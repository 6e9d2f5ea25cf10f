"""Code, stack and instructions of the generated functions, on every machine that the tools at hand can show.

Code and stack are those of a function with everything of ours that it calls; the mathematical library is left out.
Instructions are those of one call, sines and cosines of the mathematical library included.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from symstiff.codegen.emit import emit_c, environment
from symstiff.codegen.footprint_machines import MACHINES, Machine
from symstiff.codegen.footprint_parse import call_graph, instructions_per_call, symbol_sizes, totals
from symstiff.codegen.functions import Functions
from symstiff.codegen.names import moments
from symstiff.codegen.options import Options
from symstiff.codegen.reference import configurations, plausible_values
from symstiff.codegen.text import CAlgebra
from symstiff.files import write_tree

FUNCTIONS = ("deflection", "compensate", "observation", "jacobian", "stiffness", "forward")


def measure(folder: Path, functions: Functions, single: bool) -> dict[str, Any]:
    """Machine → compiler, flags, size of the object file and {function: code, stack, instructions}."""
    found = {}
    for machine in MACHINES:
        if not machine.missing and (single or machine.doubles):
            with (
                tempfile.TemporaryDirectory() as scratch,
                suppress(RuntimeError),
            ):  # half a toolchain, e.g. no newlib
                found[machine.name] = _measured(machine, folder, Path(scratch), functions, single)
    return found


def _measured(
    machine: Machine, folder: Path, scratch: Path, functions: Functions, single: bool
) -> dict[str, Any]:
    name = functions.model.robot.name
    source = str(folder / f"{name}.c")
    machine.compile(["-fcallgraph-info=su", "-c", f"-I{folder}", source, "-o", "model.o"], scratch)
    graph = call_graph((scratch / "model.ci").read_text())
    binutils = machine.compiler.removesuffix("gcc")
    sizes = symbol_sizes(_printed([f"{binutils}nm", "-S", "--defined-only", "model.o"], scratch))
    table = totals(graph, sizes, {f: f"{name}_{f}" for f in _emitted(functions)})
    (scratch / "bench.c").write_text(bench(functions, single))
    for function, count in _instructions(machine, [f"-I{folder}", "bench.c", source], scratch).items():
        if function in table:  # the compiler may have put one into another
            table[function]["instructions"] = count
    size = _printed([f"{binutils}size", "model.o"], scratch).splitlines()[1].split()
    return {
        "compiler": machine.version(),
        "flags": " ".join(["-O2", *machine.flags]),
        "object_bytes": int(size[0]) + int(size[1]),
        "functions": table,
    }


def _emitted(functions: Functions) -> list[str]:
    """The functions that a model has: no observation where no compliance is left."""
    return [f for f in FUNCTIONS if f != "observation" or functions.model.stiffness_parameters]


def _instructions(machine: Machine, arguments: list[str], scratch: Path) -> dict[str, int]:
    """Function → instructions of one call; nothing where no tool can count them."""
    if machine.board:
        machine.link_board(arguments, "bench.elf", scratch)
        printed = machine.run_board(scratch / "bench.elf").stdout
        counts = {f: int(count) for f, count in (line.split() for line in printed.splitlines())}
        return {f: count - counts["nothing"] for f, count in counts.items() if f != "nothing"}
    if shutil.which("valgrind") is None:
        return {}
    machine.compile([*arguments, "-o", "bench", "-lm"], scratch)
    _printed(["valgrind", "--tool=callgrind", "--callgrind-out-file=counts", "./bench"], scratch)
    return instructions_per_call((scratch / "counts").read_text(), "bench_")


def _printed(command: list[str], cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=300)
    if done.returncode:
        raise RuntimeError(f"{command[0]}: {done.stderr[:2000]}")
    return done.stdout


def bench(functions: Functions, single: bool) -> str:
    """A C program that calls every function at a few configurations."""
    model, literal = functions.model, CAlgebra(single).literal
    moment = [m.tested for m in moments(model, functions.deflection)]
    values = [literal(v) for v in (*plausible_values(model).values(), *moment)]
    stiffness = len(model.stiffness_parameters)
    context = {
        "name": model.robot.name,
        "real": "float" if single else "double",
        "n": model.robot.dof,
        "parameters": values[:stiffness],
        "effect_parameters": values[stiffness:],
        "inputs": [[literal(x) for x in (*q, *w)] for q, w in configurations(functions, 8, seed=5)],
        "largest": max(36, 6 * stiffness, 6 * model.robot.dof),
        "functions": [
            {"name": f, "p": f in ("deflection", "compensate", "stiffness"), "w": f in FUNCTIONS[:3]}
            for f in _emitted(functions)
        ],
    }
    return str(environment().get_template("footprint/bench.c.j2").render(context))


def unmeasured(measured: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Machines that no variant was measured on, each with the tool that is missing."""
    seen = {machine for machines in measured.values() for machine in machines}
    return [f"{m.name} ({m.missing or 'its library'})" for m in MACHINES if m.name not in seen]


def markdown(measured: Mapping[str, Mapping[str, Any]]) -> str:
    """All that was measured as a table in Markdown: one row a variant and function."""
    lines = [
        "| variant | machine | function | code [B] | stack [B] | instructions |",
        "|---|---|---|---:|---:|---:|",
    ]
    for variant, machines in measured.items():
        for machine, entry in machines.items():
            for function, f in entry["functions"].items():
                count = f.get("instructions", "–")
                lines.append(
                    f"| {variant} | {machine} | `{function}` | {f['code']} | {f['stack']} | {count} |"
                )
    return "\n".join(lines) + "\n"


def variants(functions: Functions) -> dict[str, Any]:
    """Footprints of both precisions and both layouts of a model's C code."""
    found = {}
    for precision in ("double", "float"):
        for layout in ("unrolled", "compact"):
            options = Options(precision=precision, layout=layout, targets=("c",))
            with tempfile.TemporaryDirectory() as scratch:
                write_tree(Path(scratch), emit_c(functions, options))
                found[f"{precision}, {layout}"] = measure(Path(scratch), functions, options.single)
    return found
