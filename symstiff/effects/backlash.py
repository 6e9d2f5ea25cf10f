"""A gap that the joint crosses where its total load changes sign: Δθ_j = gap/2·sign(τ_weight + τ).

The sign is smooth near zero. Deflection data show the difference to the unloaded state,
gap/2·(sign(τ_weight + τ) − sign(τ_weight)). Where the robot file has no masses the unloaded state is unknown:
then the gap is taken to be crossed by the load alone, or by the load and an arm of one of a few masses (a shape's
``mass`` or ``tapered_mass``) or a body beside the joint's axis (``beside_axis``); where the weight keeps the gap
closed nothing is seen. Masses in the robot file decide.
"""

from __future__ import annotations

from symstiff.effects.arm import (
    ARM_MOVES,
    ASSUMED,
    TOLD,
    assumed_arms,
    odds,
    of_total_load,
    untold_weight,
    weighed,
)
from symstiff.effects.base import Effect, Move, Realisation, Scales, Shape, Where
from symstiff.effects.common import BOTH, above_zero, angle_unit, joints, parameter, smooth_sign
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, actuated_joint

NAME = "backlash"
WIDTHS = (0.002, 0.01, 0.04, 0.1)
"""Half-widths of the step, as shares of the largest load: a law that needs more is a nonlinear stiffness."""
SHARP, WIDE = 1, 2
"""Which of them stand for all where the arm's mass is one of a few: of the experiment's load, and of the whole one."""


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    j = int(where["joint"])
    gap = parameter(NAME, where, "gap", angle_unit(robot, j), 0.0, 5e-3, 1e-4)
    width = above_zero(shape, "width", 5.0)
    factor = of_total_load(lambda x: smooth_sign(x, width) / 2, robot, j, shape)
    return Realisation((gap,), (Term(gap.name, actuated_joint(j), factor),))


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    joint = int(where["joint"])
    top = scales.of(actuated_joint(joint))
    found = tuple({"width": float(f"{f * top:.3g}"), **weighed(scales.kind)} for f in WIDTHS)
    sharp = ({**found[SHARP], **arm} for arm, _ in assumed_arms(robot, joint, scales, sharp=True))
    wide = (
        {"width": float(f"{WIDTHS[WIDE] * most:.3g}"), **arm}
        for arm, most in assumed_arms(robot, joint, scales)
    )
    return (*found, *sharp, *wide)


def _alike(robot: Robot, where: Where, shape: Shape) -> str:
    """Without masses two readings are left where the load alone is taken: it crosses the gap, or never does."""
    if any(key in shape for key in ASSUMED) or not untold_weight(robot, int(where["joint"])):
        return ""
    return (
        "the robot file tells no masses, so the gap was taken to be crossed by the load alone; where the arm's weight "
        "keeps it closed, it is another law of the gear: masses in the file would decide"
    )


EFFECT = Effect(
    identifier=NAME,
    title="Backlash of a joint",
    description="A gap in the gear: the joint jumps where the load on it, the links' weight included, "
    "turns over.",
    seen_in=BOTH,
    places=joints,
    realise=_realise,
    shapes=_shapes,
    confused_with=("nonlinear_stiffness", "hysteresis", "joint_offset"),
    separated_by="loads on both sides of the reversal of the joint's total torque; masses in the robot "
    "file say where "
    "that is",
    told={"width": "turning over within ± {} LOAD", "weights": "", **TOLD},
    assumed=ASSUMED,
    odds=odds,
    alike=_alike,
    weights=1.0,
    moves=lambda robot, shape: {"width": Move(2.0), **ARM_MOVES},
)
