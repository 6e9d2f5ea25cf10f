"""The Cartesian compliance of a model as a Program, by the same recursion as its deflections."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial

import sympy as sp

from symstiff.symbolic.builder import Builder
from symstiff.symbolic.chain import ElasticChain, frames, jacobian_columns
from symstiff.symbolic.passes import (
    Laws,
    Passes,
    Twist,
    bound,
    context_vector,
    p_vector,
    q_vector,
    split_twist,
)
from symstiff.symbolic.program import Program
from symstiff.symbolic.terms import AXES, Term, VirtualJoint, actuated_joint, link_joint, tau, w

_NO_SLOPE = (sp.nan, sp.zoo, sp.oo, -sp.oo, sp.AccumBounds, sp.Derivative)
"""What a derivative holds where there is none."""


def compliance_program(chain: ElasticChain, terms: Sequence[Term], parameters: Sequence[str]) -> Program:
    """Cartesian compliance K_C⁻¹ = J_θ·k·J_θᵀ at small load (seed eq. 2), 6 × 6 row-major ``C``, by recursion.

    It is symmetric where any two virtual joints give way to each other's loads alike, as springs do.
    """
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
    matrix = _congruent(matrix, lambda twist: split_twist(b.vector(passes.at_tool(twist))))
    crossed = _crossed(chain, b, laws, slope)
    b.output("C", (6, 6), [matrix[min(i, j)][max(i, j)] + crossed[i, j] for i in range(6) for j in range(6)])
    return b.build()


def _crossed(chain: ElasticChain, b: Builder, laws: Laws, slope: _Slopes) -> sp.Matrix:
    """Σ J_at·∂Δθ_at/∂W over laws that follow the wrench, or another virtual joint's load, where ``_local`` has none."""
    slopes = {
        (at, by): slope(at, by)
        for at in chain.virtual_joints
        for by in chain.virtual_joints
        if laws.at(at).has(tau(by))
        and ((at.kind, at.body) != (by.kind, by.body) or slope(at, by) != slope(by, at))
    }
    pressed = {
        (at, c): slope.along(at, w(c)) for at in chain.virtual_joints for c in AXES if laws.at(at).has(w(c))
    }
    total = sp.zeros(6, 6)
    if any(value != 0 for value in (*slopes.values(), *pressed.values())):
        columns = jacobian_columns(chain, b, frames(chain, b))
        for (at, by), value in slopes.items():
            total += value * sp.Matrix(columns[at]) * sp.Matrix(columns[by]).T
        for (at, c), value in pressed.items():
            total[:, c - 1] += value * sp.Matrix(columns[at])
    return total.applyfunc(lambda x: bound(b, x, {}))


def _congruent(matrix: list[list[sp.Expr]], move: Callable[[Twist], Twist]) -> list[list[sp.Expr]]:
    """T·X·Tᵀ for the linear map T of twists: columns first, then rows."""
    half = [_joined(move(split_twist([matrix[r][c] for r in range(6)]))) for c in range(6)]  # (T X)ᵀ
    rows = [_joined(move(split_twist([half[c][r] for c in range(6)]))) for r in range(6)]
    return [[rows[min(i, j)][max(i, j)] for j in range(6)] for i in range(6)]


def _joined(twist: Twist) -> list[sp.Expr]:
    return [*twist[0], *twist[1]]


def _added(b: Builder, x: list[list[sp.Expr]], y: list[list[sp.Expr]]) -> list[list[sp.Expr]]:
    total = [[x[i][j] + y[i][j] if i <= j else sp.S.Zero for j in range(6)] for i in range(6)]
    return [[b.let(total[min(i, j)][max(i, j)]) for j in range(6)] for i in range(6)]


def _unloaded(law: sp.Expr, load: sp.Symbol, parameters: Collection[str]) -> sp.Expr:
    """How a law follows a load where there is none; steps, as of ``sign``, are flat on either side."""
    slope = sp.diff(law, load)
    if slope.has(sp.DiracDelta):
        slope = slope.replace(sp.DiracDelta, lambda *_: sp.S.Zero)
    loads = {s for s in slope.free_symbols if s.name.startswith(("tau_", "w_")) and s.name not in parameters}
    return slope.subs(dict.fromkeys(loads, 0))


@dataclass(frozen=True)
class _Slopes:
    """How the laws give way at small load; ``ups`` are what they may know of the vertical."""

    b: Builder
    laws: Laws
    ups: dict[sp.Symbol, sp.Expr]

    def __call__(self, at: VirtualJoint, by: VirtualJoint) -> sp.Expr:
        """∂Δθ_at/∂τ_by without load; a law that is not smooth there adds none."""
        return self.along(at, tau(by))

    def along(self, at: VirtualJoint, load: sp.Symbol) -> sp.Expr:
        """How virtual joint ``at`` follows a load on a virtual joint, or a component of the wrench."""
        parameters = {term.parameter for term in self.laws.terms}
        slope = _unloaded(self.laws.at(at), load, parameters)
        if slope.has(*_NO_SLOPE):
            each = (Laws((term,)).at(at) for term in self.laws.by_joint[at])
            alone = [_unloaded(law, load, parameters) for law in each]
            slope = sp.Add(*[part for part in alone if not part.has(*_NO_SLOPE)])
        return bound(self.b, slope, self.ups)

    def mutual(self, at: VirtualJoint, by: VirtualJoint) -> sp.Expr:
        """∂Δθ_at/∂τ_by where it is ∂Δθ_by/∂τ_at, else none."""
        slope = self(at, by)
        return slope if at == by or slope == self(by, at) else sp.S.Zero


def _local(passes: Passes, slope: _Slopes, i: int) -> list[list[sp.Expr]]:
    """Link i's compliance in the axes of DH frame i: what its springs have from each other alike."""
    joints = [link_joint(i, a) for a in AXES]
    springs = [[slope.mutual(at, by) for by in joints] for at in joints]
    return _congruent(springs, lambda twist: passes.spring(i, _joined(twist)))
