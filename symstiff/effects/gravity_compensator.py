"""A spring between two links that acts on a joint: the joint's stiffness depends on its angle.

Spring form: anchors at distances a and L from the axis, angle φ = α − q between them, s² = a² + L² +
2aL·cos φ, M = K_c·(1 − s₀/s)·aL·sin φ, joint stiffness K_j⁰ + ∂M/∂q (derived below, not copied). With k̂ =
(∂M/∂q)/max|∂M/∂q| and r the spring's largest stiffness over the joint's own, the joint's compliance c₀ becomes
c₀/(1 + r·k̂): it changes by c·k̂/(1 + r·k̂), where c = −r·c₀ is the slope of that change at k̂ = 0. Angle form (the
seed's C2 and J2): the joint's compliance is a polygon over the distinct angles of the data set. Moment form, in
positions of a robot whose file tells of the spring: the joint stands off by −d·M/max|M| whatever the load.

Where the robot file tells the anchors, their lengths are kept, and so is α unless the data speak up against it.
Lengths are the same in every convention, but α depends on where the file's q is zero and which way it counts, in which
a maker's drawing and a DH table often differ: a spring that was not looked for elsewhere would be missed. Over a part
of a turn neighbouring directions and even opposite ones look alike, so that the likeliest of many is no finding: the
file's is taken to be right by ``TRUST`` to one, and a spring that pulls from elsewhere is said to (``turned``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
import sympy as sp

from symstiff.effects.base import Effect, Move, Realisation, Scales, Shape, Where
from symstiff.effects.common import BOTH, exact, load_of, parameter
from symstiff.robot.schema import ANCHORS_MEET, Robot
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.terms import Term, actuated_joint, q

NAME = "gravity_compensator"
DIRECTIONS = tuple(math.radians(20 * k) for k in range(18))
TRUST = 3.0
"""Odds that a robot file with the anchors' lengths has the anchor's direction right too."""
GEOMETRIES = ((0.27, 0.66), (0.15, 0.5), (0.45, 0.8))  # L/a and s0/a
RATIOS = (0.0, -0.4, 0.4)
MOST_ANGLES = 8
_SOFTEST = 0.02
"""Least stiffness of the joint over its own."""


_SPRING = sp.symbols("a L s_0 alpha q", real=True)


@lru_cache(maxsize=1)
def spring_moment() -> sp.Expr:
    """M of the spring for unit rate, in the symbols a, L, s_0, alpha and q."""
    a, L, s0, alpha, angle = _SPRING
    phi = alpha - angle
    s = sp.sqrt(a**2 + L**2 + 2 * a * L * sp.cos(phi))
    return (1 - s0 / s) * a * L * sp.sin(phi)


@lru_cache(maxsize=1)
def spring_stiffness() -> sp.Expr:
    """∂M/∂q of the spring for unit rate."""
    return sp.diff(spring_moment(), _SPRING[-1])


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    j = int(where["joint"])
    angles = [
        shape[k] for k in sorted((k for k in shape if k.startswith("angle_")), key=lambda k: int(k[6:]))
    ]
    if angles:
        return _by_angle(robot, where, j, angles)
    if shape.get("moment"):
        meant = "deflection of the joint under the largest moment of the spring"
        d = parameter(NAME, where, "d", "rad", -2e-2, 2e-2, 1e-3, meant)
        return Realisation((d,), (Term(d.name, actuated_joint(j), _pull(robot, j, shape)),))
    c = parameter(NAME, where, "c", "rad/(N*m)", -1e-2, 1e-2, 1e-7)
    return Realisation((c,), (Term(c.name, actuated_joint(j), _spring(robot, j, shape)),))


def _spring(robot: Robot, j: int, shape: Shape) -> sp.Expr:
    """τ·k̂/(1 + r·k̂), put together without SymPy's simplifications, which take most of a diagnosis's time."""
    *lengths, alpha = _anchors(robot, shape)
    _check_spring(*lengths, float(shape.get("ratio", 0.0)))
    stiffness, ratio = _stiffness(*lengths), exact(shape.get("ratio", 0.0))
    with sp.evaluate(False):
        law = stiffness.xreplace({_SPRING[4]: q(j), _SPRING[3]: alpha})
        return load_of(j) * law / (1 + ratio * law) if ratio else load_of(j) * law


def _pull(robot: Robot, j: int, shape: Shape) -> sp.Expr:
    """−M/max|M|: the spring turns the joint against the rise of its length."""
    *lengths, alpha = _anchors(robot, shape)
    _check_spring(*lengths, 0.0)
    with sp.evaluate(False):
        return -_moment(*lengths).xreplace({_SPRING[4]: q(j), _SPRING[3]: alpha})


def _anchors(robot: Robot, shape: Shape) -> tuple[float, float, float, sp.Rational]:
    """a, L, s₀ and the anchor's direction: the shape's, or the file's."""
    known = _known(robot)
    a, L, s0, alpha = (
        float(shape.get(k, known.get(k, d)))
        for k, d in (("a", 0.7), ("L", 0.19), ("s0", 0.46), ("alpha", 0.0))
    )
    return a, L, s0, exact(f"{alpha + shape.get('turned', 0.0):.9g}")


@lru_cache(maxsize=256)
def _check_spring(a: float, L: float, s0: float, ratio: float) -> None:
    """Raise ValueError for a spring that has no length somewhere, or a joint that is not stiff there."""
    if not min(a, L) > 0 or s0 < 0:
        raise ValueError(f"a = {a:g}, L = {L:g}, s0 = {s0:g}: give distances above zero, s0 from 0 on")
    if abs(a - L) < ANCHORS_MEET * max(a, L):
        raise ValueError(f"a = {a:g} and L = {L:g}: the spring's anchors meet: give different distances")
    share = _over_a_turn(spring_stiffness(), a, L, s0) / _largest(a, L, s0)
    if np.min(1.0 + ratio * share) < _SOFTEST:
        raise ValueError(f"ratio = {ratio:g}: with such a spring the joint is not stiff at every angle")


@lru_cache(maxsize=256)
def _stiffness(a: float, L: float, s0: float) -> sp.Expr:
    """k̂(q): the spring's stiffness over its largest size."""
    return spring_stiffness().xreplace(_lengths(a, L, s0)) / exact(f"{_largest(a, L, s0):.9g}")


@lru_cache(maxsize=256)
def _moment(a: float, L: float, s0: float) -> sp.Expr:
    """The spring's moment over its largest size."""
    largest = np.abs(_over_a_turn(spring_moment(), a, L, s0)).max()
    return spring_moment().xreplace(_lengths(a, L, s0)) / exact(f"{largest:.9g}")


def _lengths(a: float, L: float, s0: float) -> dict[sp.Symbol, sp.Rational]:
    return {symbol: exact(value) for symbol, value in zip(_SPRING[:3], (a, L, s0), strict=True)}


@lru_cache(maxsize=256)
def _largest(a: float, L: float, s0: float) -> float:
    """Largest size of the spring's stiffness over a turn, for unit rate."""
    return float(np.abs(_over_a_turn(spring_stiffness(), a, L, s0)).max())


def _over_a_turn(law: sp.Expr, a: float, L: float, s0: float) -> np.ndarray:
    """A law of the spring at angles over a turn."""
    return np.asarray(_numeric(law)(a, L, s0, 0.0, np.linspace(-math.pi, math.pi, 721)))


@lru_cache(maxsize=2)
def _numeric(law: sp.Expr) -> Callable[..., np.ndarray]:
    return sp.lambdify(_SPRING, law, "numpy")  # type: ignore[no-any-return]


def _by_angle(robot: Robot, where: Where, j: int, angles: list[float]) -> Realisation:
    """One compliance a distinct angle, linear between them, constant outside."""
    found, terms = [], []
    if not all(a < b for a, b in pairwise(angles)):
        raise ValueError(
            f"angle_1 … angle_{len(angles)} = {angles}: give different angles in ascending order"
        )
    for k, hat in enumerate(_hats(q(j), [exact(v) for v in angles]), start=1):
        meant = f"compliance of the joint at q{j} = {angles[k - 1]:.6g} rad, linear between, constant outside"
        c = parameter(NAME, where, f"c{k}", "rad/(N*m)", 0.0, 1e-2, 1e-6, meant)
        found.append(c)
        terms.append(Term(c.name, actuated_joint(j), load_of(j) * hat))
    return Realisation(tuple(found), tuple(terms), replaces=_own_compliance(robot, j))


def _hats(x: sp.Expr, knots: list[sp.Rational]) -> list[sp.Expr]:
    """The polygon's basis, written with |x − knot|: each is 1 at its knot, 0 at the others."""
    if len(knots) == 1:
        return [sp.S.One]
    rises = [(sp.Abs(x - a) - sp.Abs(x - b)) / (2 * (b - a)) for a, b in pairwise(knots)]
    half = sp.Rational(1, 2)  # a rise goes from −½ before its two knots to ½ after them
    inner = [before - after for before, after in pairwise(rises)]
    return [half - rises[0], *inner, half + rises[-1]]


def _own_compliance(robot: Robot, j: int) -> tuple[str, ...]:
    """A model's names for the joint's compliance: its own, or that of the link before it about the axis."""
    return (f"c{j}", *(f"k{j - 1}_{k}{k}" for k in ElasticChain(robot).turns_with_joint(j - 1)))


def _known(robot: Robot) -> dict[str, float]:
    given = robot.gravity_compensator
    if given is None or given.L is None or given.ax is None or given.ay is None or given.s0 is None:
        return {}
    a, alpha = math.hypot(given.ax, given.ay), math.atan2(given.ay, given.ax)
    return {"a": float(f"{a:.9g}"), "L": given.L, "s0": given.s0, "alpha": float(f"{alpha:.9g}")}


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    known = _known(robot)
    springs: list[Shape]
    if known:
        turns = [{}, *({"turned": float(f"{math.remainder(d, math.tau):.6g}")} for d in DIRECTIONS[1:])]
        springs = [{**known, **turn} for turn in turns]
    else:
        springs = [
            {"a": 1.0, "L": L, "s0": s0, "alpha": float(f"{d:.6g}")}
            for L, s0 in GEOMETRIES
            for d in DIRECTIONS
        ]
    found: list[Shape] = [{**spring, "ratio": r} for spring in springs for r in RATIOS]
    if scales.kind == "absolute" and robot.gravity_compensator is not None:
        # turned elsewhere it would be the weight of the link behind the joint
        found += [{**spring, "moment": 1.0} for spring in springs if "turned" not in spring]
    j = int(where["joint"])
    angles = scales.angles[j - 1] if len(scales.angles) >= j else ()
    if 2 <= len(angles) <= MOST_ANGLES:
        found.append(_levels(angles))
    return tuple(found)


def _levels(angles: Sequence[float]) -> Shape:
    return {f"angle_{k}": float(f"{v:.9g}") for k, v in enumerate(angles, start=1)}


def _odds(robot: Robot, shape: Shape) -> float:
    """Of directions that are not the file's by ``TRUST``; the angle form has the share that it has without a file."""
    if "turned" in shape:
        return 1.0 / (TRUST * (len(DIRECTIONS) - 1))
    return (1.0 + 1.0 / TRUST) / len(DIRECTIONS) if "angle_1" in shape and _known(robot) else 1.0


def _alike(robot: Robot, where: Where, shape: Shape) -> str:
    """A table of angles holds any dependence; over a part of a turn a spring's law is hardly told from a ripple."""
    if robot.gravity_compensator is not None:
        return ""
    return (
        "the robot file tells of no compensator, and of all springs that pull alike one is told: its lengths are no "
        "measurements. What the data show is a stiffness that depends on the joint's angle; where the robot has no "
        "spring there, look for a gear or a bearing that does"
    )


def _moves(robot: Robot, shape: Shape) -> Mapping[str, Move]:
    """The spring's geometry is not moved where the robot file tells it."""
    share: dict[str, Move] = {"ratio": Move(0.4, added=True)}
    if _known(robot):
        return share
    return {**share, "L": Move(1.6), "s0": Move(1.3), "alpha": Move(DIRECTIONS[1], added=True, around=True)}


def _places(robot: Robot) -> tuple[Where, ...]:
    if robot.gravity_compensator is not None:
        return ({"joint": robot.gravity_compensator.joint},)
    turning = [k for k, j in enumerate(robot.joint, start=1) if not j.prismatic][:2]
    if len(turning) < 2 or turning[1] != turning[0] + 1:
        return ()
    upright = float(ElasticChain(robot).rows[turning[0] - 1].alpha) % math.pi < 1e-9
    return () if upright else ({"joint": turning[1]},)


EFFECT = Effect(
    identifier=NAME,
    title="Gravity compensator",
    description="A spring between two links turns the joint, and makes its stiffness depend on its angle.",
    seen_in=BOTH,
    places=_places,
    realise=_realise,
    shapes=_shapes,
    confused_with=("nonlinear_stiffness", "joint_compliance", "link_compliance", "link_weight"),
    separated_by="several load levels at one angle of the joint, and the same load at several angles",
    told={
        "a": "anchor {} m from the axis", "L": "lever {} m", "s0": "free length {} m", "alpha": "anchor at {} rad",
        "turned": "turned by {} rad from there",
        "ratio": "spring's share of the stiffness {}", "moment": "its moment, whatever the load",
    },
    assumed={
        "turned": "its spring pulls as if the anchor were turned by {} rad from where the robot file has it: the "
        "file's q may have its zero elsewhere, or count the other way. Else it is no spring: look for a gear or a "
        "bearing that gives way by the joint's angle"
    },
    odds=_odds,
    alike=_alike,
    moves=_moves,
    levels=_levels,
)  # fmt: skip
