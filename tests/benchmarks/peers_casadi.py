"""CasADi's generated C: the geometry as scalar graphs, and automatic differentiation, both after ``ca.cse``."""

from __future__ import annotations

import re
import time
from typing import Any

import casadi as ca

from tests.benchmarks import geometry
from tests.benchmarks.case import Case
from tests.benchmarks.peer import Formula, Peer, best

# Styles that multiply columns, as the formula stands.
PLAIN = [s for s in geometry.STYLES if not s.twists and not s.shared_moment]


def peers(case: Case) -> list[Peer]:
    """Geometric formulations in their best style, and automatic differentiation of the pose."""
    return [
        best(case, "CasADi A·π + cse", "deflection", _made, product),
        best(case, "CasADi ΣJ·k·JᵀW + cse", "deflection", _made, total, PLAIN),
        best(case, "CasADi ΣJ·k·JᵀW + cse, tuned", "deflection", _made, total),
        _made(case, "CasADi AD + cse", "deflection", lambda q, w, k: derivatives(case, q, w, k)[0]),
        best(case, "CasADi geometric + cse", "observation", _made, observation),
        _made(case, "CasADi AD + cse", "observation", lambda q, w, k: derivatives(case, q, w, k)[1]),
    ]


def _columns(case: Case, q: Any, w: Any, style: geometry.Style) -> geometry.Columns:
    f = geometry.frames(case, ca.vertsplit(q), ca.cos, ca.sin, style.merged)
    return geometry.Columns(case, f, ca.vertsplit(w), style)


def observation(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    rows = geometry.observation(case, _columns(case, q, w, style))
    return ca.vertcat(*[ca.horzcat(*map(ca.SX, row)) for row in rows])


def product(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    return observation(case, q, w, k, style) @ k


def total(case: Case, q: Any, w: Any, k: Any, style: geometry.Style) -> Any:
    return ca.vertcat(*geometry.deflection(case, _columns(case, q, w, style), ca.vertsplit(k)))


def derivatives(case: Case, q: Any, w: Any, k: Any) -> tuple[Any, Any]:
    """Deflection and observation matrix from derivatives of the pose with respect to the virtual joints at zero.

    Deflection: one reverse sweep for the loads, one forward sweep for the motion; observation: the Jacobian.
    """
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
    amounts = [deflected.get((body, a), ca.SX(0)) for a in range(1, 7)]
    if all(x.is_zero() for x in amounts):
        return rotation, position
    axes = ca.SX(ca.DM(case.elastic_axes(body)))
    position = position + rotation @ (axes @ ca.vertcat(*amounts[:3]))
    return rotation @ (ca.SX.eye(3) + ca.skew(axes @ ca.vertcat(*amounts[3:]))), position


def _made(
    case: Case,
    name: str,
    quantity: str,
    graph: Formula,
    note: str = "derivatives at zero deflection",
) -> Peer:
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
        operations=operations(function),
        entry=symbol,
        declaration=f"int {symbol}(const double **arg, double **res, long long *iw, double *work, int mem);",
        call=f"const double *arg[] = {{{pointers}}}; double *res[] = {{y}}; (void){symbol}(arg, res, 0, 0, 0);",
        sources={f"{symbol}.c": source},
        by_columns=True,
        note=note,
    )


def operations(function: Any) -> dict[str, int]:
    """Counts from the instruction list; inputs, outputs and constants left out."""
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
