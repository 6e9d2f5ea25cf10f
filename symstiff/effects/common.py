"""What the catalogue's files share: places, names, exact numbers, smooth signs, the links' own weight."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any

import sympy as sp

from symstiff.effects.base import EffectParameter, Shape, Where, place_name
from symstiff.robot.schema import Robot
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.program import Builder
from symstiff.symbolic.terms import AXES, VirtualJoint, actuated_joint, link_joint, tau

GRAVITY = sp.Rational(980665, 100000)  # m/s²
BOTH = frozenset({"deflection", "absolute"})
DEFLECTION = frozenset({"deflection"})
ABSOLUTE = frozenset({"absolute"})
XYZ = "xyz"
NEAR_ZERO = sp.Rational(1, 1000)
"""Share of a load below which a law with an infinite slope at zero is made smooth: it is differentiated."""


def joints(robot: Robot) -> tuple[Where, ...]:
    """Every actuated joint."""
    return tuple({"joint": j} for j in range(1, robot.dof + 1))


def links(robot: Robot) -> tuple[Where, ...]:
    """Every link, the pedestal included."""
    return tuple({"link": i} for i in range(robot.dof + 1))


def angle_unit(robot: Robot, joint: int) -> str:
    """Unit of a joint's deflection."""
    return "m" if robot.joint[joint - 1].prismatic else "rad"


def compliance_unit(robot: Robot, joint: int) -> str:
    """Unit of a joint's compliance."""
    return "m/N" if robot.joint[joint - 1].prismatic else "rad/(N*m)"


def parameter(
    effect: str, where: Where, what: str, unit: str, low: float, high: float, typical: float
) -> EffectParameter:
    """A parameter named ``<effect>_<where>_<what>``."""
    return EffectParameter(f"{effect}_{place_name(where)}_{what}", unit, low, high, typical)


def exact(value: Any) -> sp.Rational:
    """The decimal number that a float shows, as a fraction."""
    return sp.Rational(repr(float(value)))


def smooth_sign(x: sp.Expr, width: sp.Expr) -> sp.Expr:
    """±1 away from zero, linear within ``width``: tanh(x/width)."""
    return sp.tanh(x / width, evaluate=False)


def size(x: sp.Expr) -> sp.Expr:
    """|x|, left as it stands: SymPy's questions about a weight's sign take seconds."""
    return sp.Abs(x, evaluate=False)


def load_of(joint: int) -> sp.Symbol:
    """τ of an actuated joint."""
    return tau(actuated_joint(joint))


def of_total_load(law: Callable[[sp.Expr], sp.Expr], robot: Robot, joint: int, shape: Shape) -> sp.Expr:
    """A law of a joint's total load as what a deflection shows of it: law(τ_weight + τ) − law(τ_weight).

    With ``weights = 0`` in the shape, or where the robot has no masses, the load stands alone.
    """
    load = load_of(joint)
    own = weight_load(robot, joint) if shape.get("weights", 1.0) else sp.S.Zero
    return law(load) if own == 0 else law(own + load) - law(own)


def weighed(kind: str) -> dict[str, float]:
    """The shape entry for a kind of data: in absolute data τ holds the links' weight already."""
    return {"weights": 0.0} if kind == "absolute" else {}


def couple(values: Iterable[sp.Expr], other: Iterable[sp.Expr]) -> tuple[sp.Expr, sp.Expr, sp.Expr]:
    """Vector product of two triples."""
    (a, b, c), (x, y, z) = values, other
    return b * z - c * y, c * x - a * z, a * y - b * x


def link_axes(link: int) -> tuple[VirtualJoint, ...]:
    """The six virtual joints of a link."""
    return tuple(link_joint(link, a) for a in AXES)


@lru_cache(maxsize=64)
def wrench_at(robot: Robot, body: int) -> tuple[sp.Expr, ...]:
    """The load's force (3) and moment (3) about the origin of a body's DH frame, in that frame's axes."""
    b = Builder("axes", ())
    axes = ElasticChain(robot).elastic_axes(b, body)
    exact_of = {c.symbol: c.exact for c in b.constants}
    along = [[sp.sympify(x).xreplace(exact_of) for x in axis] for axis in axes]
    return tuple(
        sp.Add(*[along[k][r] * tau(link_joint(body, k + 1 + h)) for k in range(3)])
        for h in (0, 3)
        for r in range(3)
    )


@lru_cache(maxsize=256)
def weight_load(robot: Robot, joint: int) -> sp.Expr:
    """Load of the robot file's masses on an actuated joint, −∂U/∂q_j, an expression in q [N or N·m]."""
    chain = ElasticChain(robot)
    heavy = {i: link for i, link in enumerate(robot.links) if link.mass}
    if not any(i >= joint for i in heavy):
        return sp.S.Zero
    from symstiff.symbolic.terms import q

    energy, height, upward = sp.S.Zero, sp.S.Zero, _upward(chain)
    for i in range(1, chain.dof + 1):
        turned = _about_z(upward, chain.angle(i))
        height += sum(x * u for x, u in zip(chain.offset(i), turned, strict=True))
        alpha = chain.rows[i - 1].alpha.sympy()
        upward = _about_x(turned, alpha)
        if i in heavy:
            com = [exact(x) for x in heavy[i].com]
            own = height + sum(x * u for x, u in zip(com, upward, strict=True))
            energy += exact(heavy[i].mass) * GRAVITY * own
    return -sp.diff(energy, q(joint))


Triple = tuple[sp.Expr, sp.Expr, sp.Expr]


def _upward(chain: ElasticChain) -> Triple:
    """The world's upward direction in the axes of frame 0."""
    axes: Triple = (sp.S.Zero, sp.S.Zero, sp.S.One)
    for motion in chain.base:
        if motion.kind[0] == "r":
            angle = motion.value.sympy()
            axes = (
                _about_x(axes, angle) if motion.kind == "rx"
                else _about_z(axes, angle) if motion.kind == "rz"
                else _about_y(axes, angle)
            )  # fmt: skip
    return axes


def _about_z(v: Triple, angle: sp.Expr) -> Triple:
    """Components of v in axes turned about z: Rzᵀ·v."""
    c, s = sp.cos(angle), sp.sin(angle)
    return c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]


def _about_x(v: Triple, angle: sp.Expr) -> Triple:
    c, s = sp.cos(angle), sp.sin(angle)
    return v[0], c * v[1] + s * v[2], c * v[2] - s * v[1]


def _about_y(v: Triple, angle: sp.Expr) -> Triple:
    c, s = sp.cos(angle), sp.sin(angle)
    return c * v[0] - s * v[2], v[1], c * v[2] + s * v[0]
