"""The kernel's words: virtual joints, the loads on them, and the terms by which they give way.

The model of a robot is a tuple of terms; everything that moves the tool centre point is one sum,
Δt = Σ_v J_v(q)·Δθ_v with Δθ_v = Σ_terms π·g(τ, q, …). The seed's model has only terms g = τ (seed eq. 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import sympy as sp

AXES = (1, 2, 3, 4, 5, 6)
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
"""Names of a wrench's components."""


@dataclass(frozen=True, order=True)
class VirtualJoint:
    """A place where a robot gives way.

    kind: ``link`` (body 0…n, axis 1…6 of its elastic frame, translations first), ``joint`` (body 1…n, axis 0),
    ``measure`` (axis 1…6, added to the predicted deflection at the tool centre point, base axes),
    ``load`` (axis 1…6, added to the wrench), ``body`` (axis 1…6, a wrench on link ``body`` at DH
    frame ``body``, behind its springs, in that frame's axes: weights).
    """

    kind: str
    body: int
    axis: int

    @property
    def name(self) -> str:
        """A readable identifier, e.g. ``link2_6`` or ``joint3``."""
        return f"{self.kind}{self.body}" if self.kind == "joint" else f"{self.kind}{self.body}_{self.axis}"

    @property
    def rotational(self) -> bool:
        """Whether the virtual joint's coordinate is an angle (a joint's kind depends on the robot)."""
        return self.axis > 3


def link_joint(body: int, axis: int) -> VirtualJoint:
    """Virtual spring ``axis`` (1…6) of link ``body``."""
    return VirtualJoint("link", body, axis)


def actuated_joint(body: int) -> VirtualJoint:
    """The virtual spring in actuated joint ``body``."""
    return VirtualJoint("joint", body, 0)


@cache
def tau(joint: VirtualJoint) -> sp.Symbol:
    """Load J_vᵀ·W on a virtual joint [N or N·m]."""
    return sp.Symbol(f"tau_{joint.name}", real=True)


@cache
def q(joint: int) -> sp.Symbol:
    """Variable of actuated joint ``joint``, counted from 1 [rad or m]."""
    return sp.Symbol(f"q_{joint}", real=True)


@cache
def w(component: int) -> sp.Symbol:
    """Component 1…6 of the wrench at the tool centre point, base axes [N, N·m]."""
    return sp.Symbol(f"w_{component}", real=True)


@cache
def deflection(component: int) -> sp.Symbol:
    """Component 1…6 of the predicted deflection, for terms of the measuring device [m, rad]."""
    return sp.Symbol(f"dt_{component}", real=True)


@cache
def up(body: int, axis: int) -> sp.Symbol:
    """Component 1…3 of the world's upward direction in the axes of DH frame ``body``."""
    return sp.Symbol(f"up_{body}_{axis}", real=True)


TIME = sp.Symbol("time", real=True)
TEMPERATURE = sp.Symbol("temperature", real=True)
BRANCH = sp.Symbol("branch", real=True)
TURN = sp.Symbol("turn", real=True)
"""The load where it last turned over the present one: 1 while it grows."""
CONTEXT = (TIME, TEMPERATURE, BRANCH, TURN)


@dataclass(frozen=True)
class Term:
    """One summand of a law: Δθ_at += parameter · factor, factor in tau, q, w, up and context symbols.

    Values of a shape stand in the factor as numbers.
    """

    parameter: str
    at: VirtualJoint
    factor: sp.Expr

    def __post_init__(self) -> None:
        if not isinstance(self.factor, sp.Basic):
            object.__setattr__(self, "factor", sp.sympify(self.factor, strict=True))


def link_terms(body: int, row: int, column: int, parameter: str, *, symmetric: bool) -> tuple[Term, ...]:
    """Terms of the link compliance k_{row,column}: J_row·(J_columnᵀ·W), and its mirror (seed eq. 5, 12)."""
    here = Term(parameter, link_joint(body, row), tau(link_joint(body, column)))
    if row == column or not symmetric:
        return (here,)
    return here, Term(parameter, link_joint(body, column), tau(link_joint(body, row)))


def joint_terms(joint: int, parameter: str) -> tuple[Term, ...]:
    """Terms of the compliance c of an actuated joint."""
    return (Term(parameter, actuated_joint(joint), tau(actuated_joint(joint))),)
