"""Loads passed from the base to the tip: the wrench on every virtual joint in its own axes, without a Jacobian."""

from __future__ import annotations

from collections.abc import Sequence

import sympy as sp

from symstiff.symbolic.builder import Builder
from symstiff.symbolic.chain import ElasticChain, Vec, cross, dot, plus, turn_x, turn_z
from symstiff.symbolic.terms import VirtualJoint, actuated_joint, link_joint

Turns = tuple[tuple[sp.Expr, sp.Expr], ...]
"""Cosine and sine of every joint angle θ_i."""


def turns(chain: ElasticChain, b: Builder) -> Turns:
    """Bind the sine and cosine of every joint angle."""
    return tuple(b.cos_sin(chain.angle(i), f"_{i}") for i in range(1, chain.dof + 1))


def lever(chain: ElasticChain, b: Builder, t: Turns) -> Vec:
    """Frame 0's origin to the tool centre point, in the axes of frame 0; passed from the tip to the base."""
    r = chain.tool_offset()
    for i in range(chain.dof, 0, -1):
        c, s = t[i - 1]
        turned: Vec = b.vector(turn_x(r, *chain.alpha(b, i)))
        r = b.vector(turn_z(b.vector(plus(turned, chain.offset(i))), c, s))
    return r


def in_base(axes: Sequence[Vec], v: Sequence[sp.Expr]) -> Vec:
    """Components along the axes of frame 0 of a vector in world axes (axes: columns of R_0)."""
    return tuple(dot(a, v) for a in axes)


def passed_loads(
    chain: ElasticChain, b: Builder, t: Turns, r0: Vec, wrench: Sequence[sp.Expr]
) -> dict[VirtualJoint, sp.Expr]:
    """τ_v = J_vᵀ·W for every virtual joint by recursion over the links, base to tip."""
    axes = chain.base_axes(b)
    force: Vec = b.vector(in_base(axes, wrench[:3]))
    couple: Vec = b.vector(in_base(axes, wrench[3:]))
    moment: Vec = b.vector(plus(couple, b.vector(cross(r0, force))))
    loads = _link_loads(chain, b, 0, force, moment)
    for i in range(1, chain.dof + 1):
        loads[actuated_joint(i)] = force[2] if chain.rows[i - 1].prismatic else moment[2]
        c, s = t[i - 1]
        ca, sa = chain.alpha(b, i)
        force = b.vector(turn_z(force, c, -s))
        moment = b.vector(turn_z(moment, c, -s))
        arm = cross(force, chain.offset(i))  # −p × f
        moment = b.vector(plus(moment, arm))
        force = b.vector(turn_x(force, ca, -sa))
        moment = b.vector(turn_x(moment, ca, -sa))
        loads |= _link_loads(chain, b, i, force, moment)
    return loads


def _link_loads(
    chain: ElasticChain, b: Builder, i: int, force: Vec, moment: Vec
) -> dict[VirtualJoint, sp.Expr]:
    axes = chain.elastic_axes(b, i)
    forces = b.vector(dot(e, force) for e in axes)
    moments = b.vector(dot(e, moment) for e in axes)
    return {link_joint(i, k + 1): value for k, value in enumerate((*forces, *moments))}
