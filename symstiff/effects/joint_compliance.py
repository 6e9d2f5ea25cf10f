"""An actuated joint that gives way in proportion to its load: Δθ_j = c·τ_j."""

from __future__ import annotations

from symstiff.effects.base import Effect, EffectParameter, Realisation, Shape, Where
from symstiff.effects.common import BOTH, compliance_unit, joints
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import joint_terms


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    j = int(where["joint"])
    c = EffectParameter(f"c{j}", compliance_unit(robot, j), 0.0, 1e-2, 1e-6)
    return Realisation((c,), joint_terms(j, c.name))


EFFECT = Effect(
    identifier="joint_compliance",
    title="Compliance of a joint",
    description="The gear and drive of a joint give way in proportion to the load on it.",
    seen_in=BOTH,
    places=joints,
    realise=_realise,
    confused_with=("link_compliance", "base_compliance", "nonlinear_stiffness", "gravity_compensator"),
    separated_by="load levels and joint angles over a wide range; the rotation of the link before the "
    "joint about "
    "the joint's axis is the same column and cannot be told apart",
)
