"""All competitors that are compiled: this project's code, CasADi's and wrenfold's where they are installed."""

from __future__ import annotations

import importlib.util
import re
import time
from functools import partial

from tests.benchmarks.case import Case
from tests.benchmarks.peer import QUANTITIES, Peer


def peers(case: Case) -> tuple[list[Peer], list[str]]:
    """Competitors that compile, and the names of the engines that are not installed."""
    found, missing = own(case), []
    for module in ("casadi", "wrenfold"):
        if importlib.util.find_spec(module) is None:
            missing.append(module)
        else:
            found += importlib.import_module(f"tests.benchmarks.peers_{module}").peers(case)
    return found, missing


def own(case: Case) -> list[Peer]:
    """This project's C code as generated, and its cores without the checks of inputs and outputs."""
    from symstiff.codegen.emit import emit_c
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options
    from symstiff.codegen.text import c_body
    from symstiff.model import StiffnessModel

    model = StiffnessModel(case.robot, case.parameters)
    functions, name = Functions(model), case.robot.name
    seconds = {}
    for quantity in QUANTITIES:
        start = time.process_time()
        program = getattr(functions, quantity)
        c_body(program, {v.name: partial("{}[{}]".format, v.name) for v in program.inputs})
        seconds[quantity] = time.process_time() - start
    files = emit_c(functions, Options(targets=("c",)))
    sources = {f: files[f].decode() for f in (f"{name}.h", f"{name}.c")}
    sources[f"{name}_cores.c"] = (
        f'#include "{name}.c"\n'
        f"void core_deflection(const double *q, double *y, const {name}_params_t *p, const double *w);\n"
        "void core_observation(const double *q, double *y, const double *w);\n"
        f"void core_deflection(const double *q, double *y, const {name}_params_t *p, const double *w)\n"
        "{ deflection_core(q, y, p, w); }\n"
        "void core_observation(const double *q, double *y, const double *w) { observation_core(q, y, w); }\n"
    )
    # the cores' file repeats the public functions: give them other names
    public = sorted(
        set(re.findall(rf"\b{name}_\w+(?=\()", sources[f"{name}.h"]))
        | {f"{name}_default_params", f"{name}_model_hash"}
    )
    renames = "".join(f"#define {f} cores_{f}\n" for f in public)
    sources[f"{name}_cores.c"] = renames + sources[f"{name}_cores.c"]
    parameters = f"(const {name}_params_t *)k"
    public_calls = {"deflection": f"{parameters}, q, w, y", "observation": "q, w, y"}
    core_calls = {"deflection": f"q, y, {parameters}, w", "observation": "q, y, w"}
    prototypes = (
        f"void core_deflection(const double *q, double *y, const {name}_params_t *p, const double *w);\n"
        "void core_observation(const double *q, double *y, const double *w);\n"
    )
    return [
        Peer(
            name=title,
            quantity=quantity,
            derivation=seconds[quantity],
            operations=functions.operations[quantity],
            entry=f"{prefix}_{quantity}",
            declaration=declaration,
            call=f"(void){prefix}_{quantity}({calls[quantity]});",
            sources=sources,
            note="checks of inputs and outputs included" if checked else "without the checks",
        )
        for quantity in QUANTITIES
        for title, prefix, declaration, calls, checked in (
            ("symstiff", name, f'#include "{name}.h"', public_calls, True),
            ("symstiff, core", "core", prototypes, core_calls, False),
        )
    ]
