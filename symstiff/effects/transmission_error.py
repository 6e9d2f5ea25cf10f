"""A gear that turns unevenly: Δθ_j = Σ a_n·sin(n·q_j) + b_n·cos(n·q_j), whatever the load."""

from __future__ import annotations

from math import inf

import sympy as sp

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import ABSOLUTE, exact, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, actuated_joint, q

NAME = "transmission_error"
HARMONICS = tuple(range(1, 33))


def _places(robot: Robot) -> tuple[Where, ...]:
    turning = [j for j, joint in enumerate(robot.joint, start=1) if not joint.prismatic]
    return tuple({"joint": j, "harmonics": [n]} for j in turning for n in HARMONICS)


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    j, parameters, terms = int(where["joint"]), [], []
    for n in _orders(where):
        order = exact(n) if float(n) % 1 else sp.Integer(int(n))
        label = str(order).replace("/", "o")
        for what, function in (("a", sp.sin), ("b", sp.cos)):
            meant = f"of {function.__name__}({order}*q{j})"
            p = parameter(NAME, where, f"{what}{label}", "rad", -5e-3, 5e-3, 1e-4, meant)
            parameters.append(p)
            terms.append(Term(p.name, actuated_joint(j), function(order * q(j))))
    return Realisation(tuple(parameters), tuple(terms))


def _orders(where: Where) -> list[float]:
    """The harmonics of a place. Raises ValueError for one that is not above zero, or stands there twice."""
    orders = where.get("harmonics", [1])
    several = isinstance(orders, (list, tuple)) and len(set(orders)) == len(orders) > 0
    if not several or not all(0 < float(n) < inf for n in orders):
        raise ValueError(
            f"harmonics = {orders!r}: give different numbers above zero in a list, 1 for once a turn"
        )
    return list(orders)


EFFECT = Effect(
    identifier=NAME,
    title="Transmission error of a joint",
    description="The joint runs ahead and behind its command periodically with its own angle.",
    seen_in=ABSOLUTE,
    places=_places,
    realise=_realise,
    confused_with=("joint_offset", "geometric_error"),
    separated_by="a wide range of the joint, sampled finely enough for the harmonic",
)
