"""wrenfold's generated C++: the geometry as its expressions, transpiled with its own elimination of subexpressions."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Annotated, Any

from wrenfold import code_generation as wf
from wrenfold import sym
from wrenfold.type_annotations import Shape

from tests.benchmarks import geometry
from tests.benchmarks.case import Case
from tests.benchmarks.peer import Formula, Peer, best

SPAN = Path(__file__).with_name("span.h")


def peers(case: Case) -> list[Peer]:
    """Geometric formulations in their best style, emitted as C++."""
    return [
        best(case, "wrenfold ΣJ·k·JᵀW", "deflection", _made, _total),
        best(case, "wrenfold geometric", "observation", _made, _observation),
    ]


def _columns(case: Case, q: Any, w: Any, style: geometry.Style) -> geometry.Columns:
    joints, wrench = [q[i] for i in range(case.dof)], [w[i] for i in range(6)]
    return geometry.Columns(
        case, geometry.frames(case, joints, sym.cos, sym.sin, style.merged), wrench, style
    )


def _observation(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    return sym.matrix(geometry.observation(case, _columns(case, q, w, style)))


def _total(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    values = [k[i] for i in range(len(case.entries))]
    return sym.vector(*geometry.deflection(case, _columns(case, q, w, style), values))


def _made(case: Case, name: str, quantity: str, graph: Formula, note: str = "") -> Peer:
    start = time.process_time()
    vector = {n: Annotated[sym.MatrixExpr, Shape(n, 1)] for n in (case.dof, 6, len(case.entries))}

    def deflection(q: Any, w: Any, k: Any) -> Any:
        return [wf.OutputArg(graph(q, w, k), "y")]

    def observation(q: Any, w: Any) -> Any:
        return [wf.OutputArg(graph(q, w, None), "y")]

    function = {"deflection": deflection, "observation": observation}[quantity]
    sizes = {"q": case.dof, "w": 6, "k": len(case.entries)}
    function.__annotations__ = {n: vector[sizes[n]] for n in ("q", "w", "k")[: function.__code__.co_argcount]}
    definition = wf.transpile(wf.create_function_description(function, name=f"wrenfold_{quantity}"))
    source = wf.CppGenerator().generate(definition)
    seconds = time.process_time() - start
    parameters = "const double *q, const double *w" + (
        ", const double *k" if quantity == "deflection" else ""
    )
    arguments = "q, w, k, y" if quantity == "deflection" else "q, w, y"
    symbol = f"entry_wrenfold_{quantity}"
    body = (
        f"{SPAN.read_text()}\n{source}\n"
        f'extern "C" void {symbol}({parameters}, double *y) {{ wrenfold_{quantity}<double>({arguments}); }}\n'
    )
    return Peer(
        name=name,
        quantity=quantity,
        derivation=seconds,
        operations=operations(source),
        entry=symbol,
        declaration=f"void {symbol}({parameters}, double *y);",
        call=f"{symbol}({arguments});",
        sources={f"wrenfold_{quantity}.cpp": body},
        note=note,
    )


def operations(source: str) -> dict[str, int]:
    """Counts that wrenfold writes above its code."""
    stated = {kind: int(n) for kind, n in re.findall(r"// (add|multiply|negate|call|divide): (\d+)", source)}
    counts = {"add": stated.get("add", 0), "mul": stated.get("multiply", 0), "neg": stated.get("negate", 0)}
    return counts | {"trig": stated.get("call", 0), "other": stated.get("divide", 0)}
