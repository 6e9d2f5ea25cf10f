"""The functions of a model as Programs: deflection and compliance by recursion, observation matrix by columns.

*Recursion*: the tool centre point's lever passes from the tip to the base, loads from the base to the tip,
deflections from the tip to the base; O(n), no Jacobian. *Columns*: Δt = A·π with A's column of a parameter
Σ J_v·g over its terms (seed eq. 4, 5, 12). Tests hold both equal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial

import sympy as sp

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
from symstiff.symbolic.loads import Turns, in_base, joint_variables, lever, passed_loads, turns
from symstiff.symbolic.program import Builder, Program, Vector
from symstiff.symbolic.terms import (
    AXES,
    CONTEXT,
    Term,
    VirtualJoint,
    actuated_joint,
    deflection,
    link_joint,
    tau,
    up,
    w,
)

Twist = tuple[Vec, Vec]
STILL: Twist = (ZERO, ZERO)


def q_vector(chain: ElasticChain) -> Vector:
    """Input ``q``: the joint variables."""
    return Vector("q", joint_variables(chain))


def w_vector() -> Vector:
    """Input ``w``: the wrench at the tool centre point, base axes."""
    return Vector("w", tuple(w(c) for c in AXES))


def p_vector(parameters: Sequence[str]) -> Vector:
    """Input ``p``: the parameters, in order."""
    return Vector("p", tuple(parameter_symbol(p) for p in parameters))


def parameter_symbol(name: str) -> sp.Symbol:
    """The symbol of a parameter in programs and in notebooks."""
    return sp.Symbol(name, real=True)


def context_vector(terms: Iterable[Term]) -> tuple[Vector, ...]:
    """Input ``context``: time, temperature and branch, those that the terms use."""
    used = set().union(*(t.factor.free_symbols for t in terms), set())
    symbols = tuple(s for s in CONTEXT if s in used)
    return (Vector("context", symbols),) if symbols else ()


@dataclass(frozen=True)
class Passes:
    """What the recursion knows before any law is applied."""

    chain: ElasticChain
    b: Builder
    turns: Turns
    r0: Vec
    base: tuple[Vec, Vec, Vec]

    @classmethod
    def start(cls, chain: ElasticChain, b: Builder) -> Passes:
        """Bind the joints' sines and cosines and the lever of the tool centre point."""
        t = turns(chain, b)
        return cls(chain, b, t, lever(chain, b, t), chain.base_axes(b))

    def lifted(self, i: int, twist: Twist) -> Twist:
        """A twist of the tip at frame i's origin and axes, seen at frame i−1's."""
        b, (c, s) = self.b, self.turns.pairs[i - 1]
        ca, sa = self.chain.alpha(b, i)
        v: Vec = b.vector(turn_x(twist[0], ca, sa))
        r: Vec = b.vector(turn_x(twist[1], ca, sa))
        v = b.vector(plus(v, cross(self.chain.offset(i), r)))
        return b.vector(turn_z(v, c, s)), b.vector(turn_z(r, c, s))

    def at_tool(self, twist: Twist) -> tuple[sp.Expr, ...]:
        """A twist at frame 0 moved to the tool centre point, in world axes."""
        v: Vec = self.b.vector(plus(twist[0], cross(twist[1], self.r0)))
        rows = tuple(zip(*self.base, strict=True))
        return (*(dot(r, v) for r in rows), *(dot(r, twist[1]) for r in rows))

    def spring(self, i: int, by_axis: Sequence[sp.Expr]) -> Twist:
        """Deflections of link i's six springs as a twist in the axes of frame i."""
        e = self.chain.elastic_axes(self.b, i)
        return tuple(  # type: ignore[return-value]
            self.b.vector(sp.Add(*[by_axis[3 * h + k] * e[k][r] for k in range(3)]) for r in range(3))
            for h in range(2)
        )

    def joint(self, i: int, amount: sp.Expr) -> Twist:
        """Deflection of actuated joint i as a twist in the axes of frame i−1."""
        along: Vec = (sp.S.Zero, sp.S.Zero, amount)
        return (along, ZERO) if self.chain.rows[i - 1].prismatic else (ZERO, along)

    def summed(self, laws: Callable[[VirtualJoint], sp.Expr]) -> Twist:
        """Pass the deflections from the tip to frame 0."""
        twist = STILL
        for i in range(self.chain.dof, -1, -1):
            twist = self._add(twist, self.spring(i, [laws(link_joint(i, a)) for a in AXES]))
            if i:
                twist = self._add(self.lifted(i, twist), self.joint(i, laws(actuated_joint(i))))
        return twist

    def _add(self, a: Twist, c: Twist) -> Twist:
        return self.b.vector(plus(a[0], c[0])), self.b.vector(plus(a[1], c[1]))

    def upward(self) -> dict[sp.Symbol, sp.Expr]:
        """The vertical in the axes of every frame, bound."""
        ups = [in_base(self.base, IDENTITY[2])]
        for i in range(1, self.chain.dof + 1):
            c, s = self.turns.pairs[i - 1]
            ca, sa = self.chain.alpha(self.b, i)
            ups.append(self.b.vector(turn_x(self.b.vector(turn_z(ups[-1], c, -s)), ca, -sa)))
        return {up(i, k + 1): u[k] for i, u in enumerate(ups) for k in range(3)}


@dataclass(frozen=True)
class Laws:
    """The terms, sorted by where they act."""

    terms: tuple[Term, ...]
    by_joint: dict[VirtualJoint, list[Term]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for term in self.terms:
            self.by_joint.setdefault(term.at, []).append(term)

    def at(self, joint: VirtualJoint) -> sp.Expr:
        """Δθ_v (or its analogue) as an expression in its symbols."""
        return sp.Add(*[parameter_symbol(t.parameter) * t.factor for t in self.by_joint.get(joint, [])])

    def of_kind(self, kind: str) -> bool:
        """Whether any term acts at virtual joints of this kind."""
        return any(v.kind == kind for v in self.by_joint)

    @property
    def know_up(self) -> bool:
        """Whether any law depends on the vertical."""
        return any(s.name.startswith("up_") for term in self.terms for s in term.factor.free_symbols)


def bound(b: Builder, expression: sp.Expr, values: dict[sp.Symbol, sp.Expr]) -> sp.Expr:
    """Replace symbols by bound values and bind every product, power and function inside."""
    if expression.is_Symbol:
        return values.get(expression, expression)
    if expression.is_Atom:
        return expression
    if (known := b.turned(expression)) is not None:
        return known
    return b.let(expression.func(*[bound(b, a, values) for a in expression.args]))


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
            c, s = passes.turns.pairs[i - 1]
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
    d, turn = _split([b.let(x) for x in column])
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


def compliance_program(chain: ElasticChain, terms: Sequence[Term], parameters: Sequence[str]) -> Program:
    """Cartesian compliance K_C⁻¹ = J_θ·k·J_θᵀ at small load (seed eq. 2), 6 × 6 row-major ``C``, by recursion."""
    b = Builder("compliance", (p_vector(parameters), q_vector(chain), *context_vector(terms)))
    laws = Laws(tuple(terms))
    passes = Passes.start(chain, b)
    slope = _Slopes(b, laws, passes.upward() if laws.know_up else {})
    matrix = sp.zeros(6, 6).tolist()
    for i in range(chain.dof, -1, -1):
        matrix = _added(b, matrix, _local(passes, slope, i))
        if i:
            matrix = _congruent(matrix, partial(passes.lifted, i))
            k = 2 if chain.rows[i - 1].prismatic else 5
            matrix[k][k] = b.let(matrix[k][k] + slope(actuated_joint(i), actuated_joint(i)))
    matrix = _congruent(matrix, lambda twist: _split(b.vector(passes.at_tool(twist))))
    crossed = _crossed(chain, b, laws, slope)
    b.output("C", (6, 6), [matrix[min(i, j)][max(i, j)] + crossed[i, j] for i in range(6) for j in range(6)])
    return b.build()


def _crossed(chain: ElasticChain, b: Builder, laws: Laws, slope: _Slopes) -> sp.Matrix:
    """Σ J_at·∂Δθ_at/∂τ_by·J_byᵀ over laws that follow the load of another body's virtual joint."""
    slopes = {
        (at, by): slope(at, by)
        for at in chain.virtual_joints
        for by in chain.virtual_joints
        if (at.kind, at.body) != (by.kind, by.body) and laws.at(at).has(tau(by))
    }
    total = sp.zeros(6, 6)
    if any(value != 0 for value in slopes.values()):
        columns = jacobian_columns(chain, b, frames(chain, b))
        for (at, by), value in slopes.items():
            total += value * sp.Matrix(columns[at]) * sp.Matrix(columns[by]).T
    return total.applyfunc(lambda x: bound(b, x, {}))


def _split(twist: Sequence[sp.Expr]) -> Twist:
    return tuple(twist[:3]), tuple(twist[3:])


def _congruent(matrix: list[list[sp.Expr]], move: Callable[[Twist], Twist]) -> list[list[sp.Expr]]:
    """T·X·Tᵀ for the linear map T of twists: columns first, then rows."""
    half = [_joined(move(_split([matrix[r][c] for r in range(6)]))) for c in range(6)]  # (T X)ᵀ
    rows = [_joined(move(_split([half[c][r] for c in range(6)]))) for r in range(6)]
    return [[rows[min(i, j)][max(i, j)] for j in range(6)] for i in range(6)]


def _joined(twist: Twist) -> list[sp.Expr]:
    return [*twist[0], *twist[1]]


def _added(b: Builder, x: list[list[sp.Expr]], y: list[list[sp.Expr]]) -> list[list[sp.Expr]]:
    total = [[x[i][j] + y[i][j] if i <= j else sp.S.Zero for j in range(6)] for i in range(6)]
    return [[b.let(total[min(i, j)][max(i, j)]) for j in range(6)] for i in range(6)]


@dataclass(frozen=True)
class _Slopes:
    """How the laws give way at small load; ``ups`` are what they may know of the vertical."""

    b: Builder
    laws: Laws
    ups: dict[sp.Symbol, sp.Expr]

    def __call__(self, at: VirtualJoint, by: VirtualJoint) -> sp.Expr:
        """∂Δθ_at/∂τ_by without load; a law that is not smooth there gives none."""
        slope = sp.diff(self.laws.at(at), tau(by))
        slope = slope.subs({s: 0 for s in slope.free_symbols if s.name.startswith("tau_")})
        if slope.has(sp.nan, sp.zoo, sp.oo) or slope.has(sp.Derivative):
            return sp.S.Zero
        return bound(self.b, slope, self.ups)


def _local(passes: Passes, slope: _Slopes, i: int) -> list[list[sp.Expr]]:
    """Link i's compliance in the axes of DH frame i."""
    joints = [link_joint(i, a) for a in AXES]
    springs = [[slope(at, by) for by in joints] for at in joints]
    return _congruent(springs, lambda twist: passes.spring(i, _joined(twist)))
