"""Two joints of the wrist that share gears: the load on one turns the other, Δθ_j = c·τ_k and Δθ_k = c·τ_j."""

from __future__ import annotations

from itertools import combinations

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import BOTH, load_of, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, actuated_joint

NAME = "wrist_coupling"


def _places(robot: Robot) -> tuple[Where, ...]:
    last = range(max(1, robot.dof - 2), robot.dof + 1)
    turning = [j for j in last if not robot.joint[j - 1].prismatic]
    return tuple({"joints": [j, k]} for j, k in combinations(turning, 2))


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    j, k = (int(x) for x in where["joints"])
    c = parameter(NAME, where, "c", "rad/(N*m)", -1e-3, 1e-3, 1e-6)
    there = Term(c.name, actuated_joint(j), load_of(k)), Term(c.name, actuated_joint(k), load_of(j))
    return Realisation((c,), there)


EFFECT = Effect(
    identifier=NAME,
    title="Coupling of two wrist joints",
    description="Bevel or spur gears that two wrist joints share make each turn under the other's load.",
    seen_in=BOTH,
    places=_places,
    realise=_realise,
    confused_with=("joint_compliance", "link_compliance", "link_asymmetry"),
    separated_by="poses in which only one of the two joints is loaded",
)
