"""The functions of a model as Programs: deflection by recursion, observation matrix by columns.

*Recursion*: loads from the base to the tip, deflections from the tip to the base (``symbolic/passes.py``).
*Columns*: Δt = A·π with A's column of a parameter Σ J_v·g over its terms (seed eq. 4, 5, 12). Tests hold both equal.
"""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from symstiff.symbolic.builder import Builder
from symstiff.symbolic.chain import (
    IDENTITY,
    ZERO,
    ElasticChain,
    Frames,
    Vec,
    cross,
    dot,
    frames,
    jacobian_columns,
    plus,
    point_offset,
    scaled,
    turn_x,
    turn_z,
)
from symstiff.symbolic.loads import in_base, passed_loads, turns
from symstiff.symbolic.passes import (
    Laws,
    Passes,
    bound,
    context_vector,
    p_vector,
    q_vector,
    split_twist,
    w_vector,
)
from symstiff.symbolic.program import Program
from symstiff.symbolic.terms import (
    AXES,
    Term,
    VirtualJoint,
    actuated_joint,
    deflection,
    link_joint,
    tau,
    up,
    w,
)


def deflection_program(chain: ElasticChain, terms: Sequence[Term], parameters: Sequence[str]) -> Program:
    """Δt(q, W; π) by recursion, every law of the terms applied; outputs ``dt`` (6)."""
    b = Builder("deflection", (p_vector(parameters), q_vector(chain), w_vector(), *context_vector(terms)))
    laws = Laws(tuple(terms))
    passes = Passes.start(chain, b)
    wrench = [b.let(w(c) + bound(b, laws.at(VirtualJoint("load", 0, c)), {})) for c in AXES]
    loads = passed_loads(chain, b, passes.turns, passes.r0, wrench)
    if laws.of_kind("body"):
        loads = _with_weights(passes, laws, loads)
    values = {tau(v): load for v, load in loads.items()} | (passes.upward() if laws.know_up else {})
    twist = passes.summed(lambda v: bound(b, laws.at(v), values))
    dt = list(passes.at_tool(twist))
    if laws.of_kind("measure"):
        dt = [b.let(x) for x in dt]
        seen = {deflection(c): x for c, x in zip(AXES, dt, strict=True)}
        dt = [
            x + bound(b, laws.at(VirtualJoint("measure", 0, c)), seen) for c, x in zip(AXES, dt, strict=True)
        ]
    b.output("dt", (6,), dt)
    return b.build()


def _with_weights(
    passes: Passes, laws: Laws, loads: dict[VirtualJoint, sp.Expr]
) -> dict[VirtualJoint, sp.Expr]:
    """Add the loads of wrenches on the links (kind ``body``) on all virtual joints before their frames.

    Their laws know the upward direction and the loads of the wrench at the tool.
    """
    chain, b = passes.chain, passes.b
    values = passes.upward() | {tau(v): load for v, load in loads.items()}
    total = dict(loads)
    force: Vec = ZERO
    moment: Vec = ZERO
    for i in range(chain.dof, -1, -1):
        body = [bound(b, laws.at(VirtualJoint("body", i, a)), values) for a in AXES]
        force = b.vector(plus(force, (body[0], body[1], body[2])))
        moment = b.vector(plus(moment, (body[3], body[4], body[5])))
        e = chain.elastic_axes(b, i)
        for k in range(3):
            total[link_joint(i, k + 1)] += dot(e[k], force)
            total[link_joint(i, k + 4)] += dot(e[k], moment)
        if i:
            ca, sa = chain.alpha(b, i)
            c, s = passes.turns[i - 1]
            force = b.vector(turn_x(force, ca, sa))
            moment = b.vector(turn_x(moment, ca, sa))
            moment = b.vector(plus(moment, cross(chain.offset(i), force)))
            force, moment = b.vector(turn_z(force, c, s)), b.vector(turn_z(moment, c, s))
            total[actuated_joint(i)] += force[2] if chain.rows[i - 1].prismatic else moment[2]
    return {v: b.let(x) for v, x in total.items()}


def observation_program(
    chain: ElasticChain, terms: Sequence[Term], parameters: Sequence[str], points: Sequence[str] = ()
) -> Program:
    """A(q, W), 6 × len(parameters), row-major ``A``: column of π is Σ J_v·g over its terms (seed eq. 5, 12).

    With ``points`` its rows are translations of these markers, three each.
    """
    b = Builder("observation", (q_vector(chain), w_vector(), *context_vector(terms)))
    f, columns, values = _geometry(chain, b)
    values |= {up(i, k + 1): axes[k][2] for i, axes in enumerate(f.axes) for k in range(3)}
    for c in AXES:
        columns[VirtualJoint("measure", 0, c)] = tuple(sp.Integer(int(r == c)) for r in AXES)
    by_parameter: dict[str, list[Term]] = {}
    for term in terms:
        by_parameter.setdefault(term.parameter, []).append(term)
    matrix = []
    for name in parameters:
        column = [sp.S.Zero] * 6
        for term in by_parameter.get(name, []):
            factor = bound(b, term.factor, values)
            column = [x + j * factor for x, j in zip(column, columns[term.at], strict=True)]
        matrix.append(column)
    if points:
        offsets = [point_offset(chain, b, f, point) for point in points]
        matrix = [_seen_at(b, column, offsets) for column in matrix]
    _emit_columns(b, "A", matrix, 3 * len(points) or 6)
    return b.build()


def _seen_at(b: Builder, column: Sequence[sp.Expr], offsets: Sequence[Vec]) -> list[sp.Expr]:
    """Translations of points that move with the tool: d + φ × r for each offset r."""
    d, turn = split_twist([b.let(x) for x in column])
    return [x for r in offsets for x in b.vector(plus(d, cross(turn, r)))]


def _geometry(
    chain: ElasticChain, b: Builder
) -> tuple[Frames, dict[VirtualJoint, tuple[sp.Expr, ...]], dict[sp.Symbol, sp.Expr]]:
    """Frames, columns J_v and loads τ_v, all bound; weights and load errors are no part of the columns."""
    single = turns(chain, b)  # before the frames: sums of these angles then need no functions of their own
    f = frames(chain, b)
    columns = jacobian_columns(chain, b, f)
    r0: Vec = b.vector(in_base(f.axes[0], f.levers[0]))
    loads = passed_loads(chain, b, single, r0, [w(c) for c in AXES])
    return f, columns, {tau(v): load for v, load in loads.items()}


def _emit_columns(b: Builder, name: str, matrix: Sequence[Sequence[sp.Expr]], rows: int = 6) -> None:
    b.output(name, (rows, len(matrix)), [column[r] for r in range(rows) for column in matrix])


def jacobian_program(chain: ElasticChain) -> Program:
    """The actuated joints' Jacobian at the tool centre point, 6 × n, row-major ``J``."""
    b = Builder("jacobian", (q_vector(chain),))
    columns = jacobian_columns(chain, b, frames(chain, b))
    _emit_columns(b, "J", [columns[actuated_joint(i)] for i in range(1, chain.dof + 1)])
    return b.build()


def virtual_jacobian_program(chain: ElasticChain) -> Program:
    """The virtual-joint Jacobian J_θ, 6 × m, columns in the order of ``chain.virtual_joints``, row-major ``J``."""
    b = Builder("virtual_jacobian", (q_vector(chain),))
    columns = jacobian_columns(chain, b, frames(chain, b))
    _emit_columns(b, "J", [columns[v] for v in chain.virtual_joints])
    return b.build()


def forward_program(chain: ElasticChain) -> Program:
    """Pose of the tool centre point in world axes, 4 × 4 row-major ``T``."""
    b = Builder("forward", (q_vector(chain),))
    f = frames(chain, b)
    axes = f.axes[-1]
    for motion in chain.tool:
        if motion.kind[0] == "r":
            value = motion.value.sympy()
            c, s = b.turn(value)
            axes = _turned_about(b, axes, "xyz".index(motion.kind[1]), c, s)
    position = plus(f.levers[0], _base_origin(chain, b))
    rows = [[axes[k][r] for k in range(3)] + [position[r]] for r in range(3)]
    rows.append([sp.S.Zero, sp.S.Zero, sp.S.Zero, sp.S.One])
    b.output("T", (4, 4), [x for row in rows for x in row])
    return b.build()


def _turned_about(
    b: Builder, axes: tuple[Vec, Vec, Vec], k: int, c: sp.Expr, s: sp.Expr
) -> tuple[Vec, Vec, Vec]:
    i, j = (k + 1) % 3, (k + 2) % 3
    new = list(axes)
    new[i] = b.vector(plus(scaled(axes[i], c), scaled(axes[j], s)))
    new[j] = b.vector(plus(scaled(axes[j], c), scaled(axes[i], -s)))
    return tuple(new)  # type: ignore[return-value]


def _base_origin(chain: ElasticChain, b: Builder) -> Vec:
    """Origin of frame 0 in world axes."""
    axes, origin = IDENTITY, ZERO
    for motion in chain.base:
        value = motion.value.sympy()
        k = "xyz".index(motion.kind[1])
        if motion.kind[0] == "t":
            origin = plus(origin, scaled(axes[k], value))
        else:
            axes = _turned_about(b, axes, k, *b.turn(value))
    return origin
