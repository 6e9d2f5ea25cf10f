"""Competitors as C or C++ sources: what each is called, how long it took to derive, its operations, how to call it."""

from __future__ import annotations

import importlib.util
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.benchmarks import geometry
from tests.benchmarks.case import Case

SHAPE = {"deflection": 6, "observation": 6}
SPAN = Path(__file__).with_name("span.h")


@dataclass(frozen=True)
class Peer:
    """One competitor for one quantity.

    call: a C statement that computes ``y`` from ``q``, ``w`` and ``k``; entry: the function whose code and stack
    count; by_columns: whether matrices come column by column; operations: add, mul, neg, trig, other.
    """

    name: str
    quantity: str
    derivation: float
    operations: dict[str, int]
    entry: str
    declaration: str
    call: str
    sources: dict[str, str] = field(default_factory=dict)
    by_columns: bool = False
    note: str = ""

    @property
    def total(self) -> int:
        """Additions, multiplications and sign changes (and anything but sines and cosines)."""
        return sum(n for kind, n in self.operations.items() if kind != "trig")


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
    for quantity in SHAPE:
        start = time.process_time()
        program = getattr(functions, quantity)
        c_body(program, {v.name: (lambda k, n=v.name: f"{n}[{k}]") for v in program.inputs})
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
        set(re.findall(rf"\b{name}_\w+(?=\()", sources[f"{name}.h"])) | {f"{name}_default_params"}
    )
    renames = "".join(f"#define {f} cores_{f}\n" for f in public)
    sources[f"{name}_cores.c"] = renames + sources[f"{name}_cores.c"]
    parameters = f"(const {name}_params_t *)k"
    calls = {"deflection": f"{parameters}, q, w, y", "observation": "q, w, y"}
    cores = {"deflection": f"q, y, {parameters}, w", "observation": "q, y, w"}
    prototypes = (
        f"void core_deflection(const double *q, double *y, const {name}_params_t *p, const double *w);\n"
        "void core_observation(const double *q, double *y, const double *w);\n"
    )
    found = []
    for quantity in SHAPE:
        counts = functions.operations[quantity]
        common = {"quantity": quantity, "derivation": seconds[quantity], "operations": counts}
        found += [
            Peer(
                name="symstiff",
                entry=f"{name}_{quantity}",
                declaration=f'#include "{name}.h"',
                call=f"(void){name}_{quantity}({calls[quantity]});",
                sources=sources,
                note="checks of inputs and outputs included",
                **common,
            ),
            Peer(
                name="symstiff, core",
                entry=f"core_{quantity}",
                declaration=prototypes,
                call=f"core_{quantity}({cores[quantity]});",
                note="without the checks",
                **common,
            ),
        ]
    return found


# CasADi ---------------------------------------------------------------------------------------------------------------


def casadi_peers(case: Case) -> Iterator[Peer]:
    """Geometric formulations with ``cse`` in their best style, and automatic differentiation of the pose."""
    yield _best(case, "CasADi A·π + cse", "deflection", _casadi_product)
    yield _best(case, "CasADi ΣJ·k·JᵀW + cse", "deflection", _casadi_sum, styles=_plain())
    yield _best(case, "CasADi ΣJ·k·JᵀW + cse, tuned", "deflection", _casadi_sum)
    yield _casadi_peer(case, "CasADi AD + cse", "deflection", lambda q, w, k: _casadi_ad(case, q, w, k)[0])
    yield _best(case, "CasADi geometric + cse", "observation", _casadi_observation)
    yield _casadi_peer(case, "CasADi AD + cse", "observation", lambda q, w, k: _casadi_ad(case, q, w, k)[1])


def _plain() -> list[geometry.Style]:
    """Styles that multiply columns, as the formula stands."""
    return [s for s in geometry.STYLES if not s.twists and not s.shared_moment]


def _best(
    case: Case,
    name: str,
    quantity: str,
    graph: Callable[..., Any],
    styles: Any = geometry.STYLES,
    engine: Callable[..., Peer] | None = None,
) -> Peer:
    """The style with the fewest operations."""
    make = engine or _casadi_peer
    tried = [
        make(case, name, quantity, lambda q, w, k, s=style: graph(case, q, w, k, s), str(style))
        for style in styles
    ]
    return min(tried, key=lambda peer: peer.total)


def _casadi_columns(case: Case, q: Any, w: Any, style: geometry.Style) -> geometry.Columns:
    import casadi as ca

    f = geometry.frames(case, ca.vertsplit(q), ca.cos, ca.sin, style.merged)
    return geometry.Columns(case, f, ca.vertsplit(w), style)


def _casadi_observation(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    import casadi as ca

    rows = geometry.observation(case, _casadi_columns(case, q, w, style))
    return ca.vertcat(*[ca.horzcat(*map(ca.SX, row)) for row in rows])


def _casadi_product(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    return _casadi_observation(case, q, w, k, style) @ k


def _casadi_sum(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    import casadi as ca

    return ca.vertcat(*geometry.deflection(case, _casadi_columns(case, q, w, style), ca.vertsplit(k)))


def _casadi_ad(case: Case, q: Any, w: Any, k: Any) -> tuple[Any, Any]:
    """Deflection and observation matrix from derivatives of the pose with respect to the virtual joints at zero.

    Deflection: one reverse sweep for the loads, one forward sweep for the motion; observation: the Jacobian.
    """
    import casadi as ca

    joints = sorted({(e.body, axis) for e in case.entries for axis in (e.row, e.column)})
    theta = ca.SX.sym("theta", len(joints))
    zero = ca.SX.zeros(len(joints))
    pose = _pose(case, q, dict(zip(joints, ca.vertsplit(theta), strict=True)))
    number = {joint: i for i, joint in enumerate(joints)}
    loads = ca.substitute(ca.jtimes(pose, theta, w, True), theta, zero)
    amounts = [ca.SX(0)] * len(joints)
    for i, e in enumerate(case.entries):
        for at, by in {(e.row, e.column), (e.column, e.row)}:
            amounts[number[e.body, at]] += k[i] * loads[number[e.body, by]]
    dt = ca.substitute(ca.jtimes(pose, theta, ca.vertcat(*amounts)), theta, zero)
    jacobian = ca.substitute(ca.jacobian(pose, theta), theta, zero)
    tau = ca.mtimes(jacobian.T, w)
    columns = []
    for e in case.entries:
        a, b = number[e.body, e.row], number[e.body, e.column]
        column = jacobian[:, a] * tau[b]
        columns.append(column if a == b else column + jacobian[:, b] * tau[a])
    return dt, ca.horzcat(*columns)


def _pose(case: Case, q: Any, theta: dict[tuple[int, int], Any]) -> Any:
    """Position, and rotation against the undeflected pose, of a chain with virtual joints; exact to first order."""
    import casadi as ca

    def chain(deflected: dict[tuple[int, int], Any]) -> tuple[Any, Any]:
        rotation, position = ca.SX(case.base[0]), ca.SX(case.base[1])
        rotation, position = _give_way(case, 0, rotation, position, deflected)
        for i, row in enumerate(case.rows, start=1):
            shift = deflected.get((i, 0), ca.SX(0)) + q[i - 1]
            angle = ca.SX(row.theta) if row.prismatic else shift + row.theta
            c, s = ca.cos(angle), ca.sin(angle)
            position = position + rotation[:, 2] * (row.d + (shift if row.prismatic else 0))
            rotation = rotation @ ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.SX([[0, 0, 1]]))
            position = position + rotation[:, 0] * row.a
            ca_, sa = row.cos_alpha, row.sin_alpha
            rotation = rotation @ ca.SX(ca.DM([[1, 0, 0], [0, ca_, -sa], [0, sa, ca_]]))
            rotation, position = _give_way(case, i, rotation, position, deflected)
        return rotation, position + rotation @ ca.SX(case.tool[1])

    rotation, position = chain(theta)
    turn = rotation @ chain({})[0].T
    return ca.vertcat(position, turn[2, 1], turn[0, 2], turn[1, 0])


def _give_way(
    case: Case, body: int, rotation: Any, position: Any, deflected: dict[tuple[int, int], Any]
) -> Any:
    import casadi as ca

    amounts = [deflected.get((body, a), ca.SX(0)) for a in range(1, 7)]
    if all(x.is_zero() for x in amounts):
        return rotation, position
    axes = ca.SX(ca.DM(case.elastic_axes(body)))
    position = position + rotation @ (axes @ ca.vertcat(*amounts[:3]))
    return rotation @ (ca.SX.eye(3) + ca.skew(axes @ ca.vertcat(*amounts[3:]))), position


def _casadi_peer(
    case: Case,
    name: str,
    quantity: str,
    graph: Callable[..., Any],
    note: str = "derivatives at zero deflection",
) -> Peer:
    import casadi as ca

    start = time.process_time()
    symbols = [ca.SX.sym("q", case.dof), ca.SX.sym("w", 6), ca.SX.sym("k", len(case.entries))]
    out = ca.cse(ca.densify(ca.SX(graph(*symbols))))
    symbol = re.sub(
        r"\W+", "_", f"{quantity}_{name}".replace("π", "pi").replace("Σ", "sum").replace("ᵀ", "t")
    )
    arguments = symbols if quantity == "deflection" else symbols[:2]
    function = ca.Function(symbol, arguments, [out])
    generator = ca.CodeGenerator(f"{symbol}.c", {"with_header": False})
    generator.add(function)
    source = generator.dump()
    seconds = time.process_time() - start
    pointers = "q, w, k" if quantity == "deflection" else "q, w"
    return Peer(
        name=name,
        quantity=quantity,
        derivation=seconds,
        operations=casadi_operations(function),
        entry=symbol,
        declaration=f"int {symbol}(const double **arg, double **res, long long *iw, double *work, int mem);",
        call=f"const double *arg[] = {{{pointers}}}; double *res[] = {{y}}; (void){symbol}(arg, res, 0, 0, 0);",
        sources={f"{symbol}.c": source},
        by_columns=True,
        note=note,
    )


def casadi_operations(function: Any) -> dict[str, int]:
    """Counts from the instruction list; inputs, outputs and constants left out."""
    import casadi as ca

    kinds = {
        ca.OP_ADD: "add", ca.OP_SUB: "add", ca.OP_TWICE: "add", ca.OP_MUL: "mul", ca.OP_SQ: "mul", ca.OP_NEG: "neg",
        ca.OP_SIN: "trig", ca.OP_COS: "trig",
    }  # fmt: skip
    counts = dict.fromkeys(("add", "mul", "neg", "trig", "other"), 0)
    for i in range(function.n_instructions()):
        op = function.instruction_id(i)
        if op not in (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_PARAMETER):
            counts[kinds.get(op, "other")] += 1
    return counts


# wrenfold -------------------------------------------------------------------------------------------------------------


def wrenfold_peers(case: Case) -> Iterator[Peer]:
    """Geometric formulations in their best style, emitted as C++."""
    yield _best(case, "wrenfold ΣJ·k·JᵀW", "deflection", _wrenfold_sum, engine=_wrenfold_peer)
    yield _best(case, "wrenfold geometric", "observation", _wrenfold_observation, engine=_wrenfold_peer)


def _wrenfold_columns(case: Case, q: Any, w: Any, style: geometry.Style) -> geometry.Columns:
    from wrenfold import sym

    joints, wrench = [q[i] for i in range(case.dof)], [w[i] for i in range(6)]
    return geometry.Columns(
        case, geometry.frames(case, joints, sym.cos, sym.sin, style.merged), wrench, style
    )


def _wrenfold_observation(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    from wrenfold import sym

    return sym.matrix(geometry.observation(case, _wrenfold_columns(case, q, w, style)))


def _wrenfold_sum(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    from wrenfold import sym

    values = [k[i] for i in range(len(case.entries))]
    return sym.vector(*geometry.deflection(case, _wrenfold_columns(case, q, w, style), values))


def _wrenfold_peer(case: Case, name: str, quantity: str, graph: Callable[..., Any], note: str = "") -> Peer:
    from typing import Annotated

    from wrenfold import code_generation as wf
    from wrenfold import sym
    from wrenfold.type_annotations import Shape

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
        operations=wrenfold_operations(source),
        entry=symbol,
        declaration=f"void {symbol}({parameters}, double *y);",
        call=f"{symbol}({arguments});",
        sources={f"wrenfold_{quantity}.cpp": body},
        note=note,
    )


def wrenfold_operations(source: str) -> dict[str, int]:
    """Counts that wrenfold writes above its code."""
    stated = {kind: int(n) for kind, n in re.findall(r"// (add|multiply|negate|call|divide): (\d+)", source)}
    counts = {"add": stated.get("add", 0), "mul": stated.get("multiply", 0), "neg": stated.get("negate", 0)}
    return counts | {"trig": stated.get("call", 0), "other": stated.get("divide", 0)}


def peers(case: Case) -> tuple[list[Peer], list[str]]:
    """All competitors that compile, and the names of the engines that are not installed."""
    found, missing = own(case), []
    for module, make in (("casadi", casadi_peers), ("wrenfold", wrenfold_peers)):
        if importlib.util.find_spec(module) is None:
            missing.append(module)
        else:
            found += list(make(case))
    return found, missing
