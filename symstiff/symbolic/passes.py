"""What programs are made of: their inputs, the passes of the recursion along the chain, and the laws where they act.

The tool centre point's lever passes from the tip to the base, loads from the base to the tip, deflections from the tip
to the base; O(n), no Jacobian.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import sympy as sp

from symstiff.symbolic.builder import Builder
from symstiff.symbolic.chain import IDENTITY, ZERO, ElasticChain, Vec, cross, dot, plus, turn_x, turn_z
from symstiff.symbolic.loads import Turns, in_base, lever, turns
from symstiff.symbolic.program import Vector
from symstiff.symbolic.terms import AXES, CONTEXT, Term, VirtualJoint, actuated_joint, link_joint, q, up, w

Twist = tuple[Vec, Vec]
STILL: Twist = (ZERO, ZERO)


def split_twist(six: Sequence[sp.Expr]) -> Twist:
    """Translation and rotation of six components."""
    return tuple(six[:3]), tuple(six[3:])


def q_vector(chain: ElasticChain) -> Vector:
    """Input ``q``: the joint variables."""
    return Vector("q", tuple(q(i) for i in range(1, chain.dof + 1)))


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
    """Input ``context``: time, temperature, branch and turn, those that the terms use."""
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
        b, (c, s) = self.b, self.turns[i - 1]
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
            c, s = self.turns[i - 1]
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
