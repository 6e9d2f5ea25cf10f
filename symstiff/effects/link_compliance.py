"""A link that bends, twists and stretches as a beam: Δθ = k·τ at its six virtual joints (seed eq. 13)."""

from __future__ import annotations

from symstiff.effects.base import Effect, Where
from symstiff.effects.blocks import block, template_pairs
from symstiff.effects.common import BOTH, links
from symstiff.robot.schema import Robot


def _unlikely(robot: Robot, where: Where, rigid: bool) -> str:
    """A pedestal is no beam where the robot file does not say so: what it stands on gives way any way."""
    if int(where["link"]) or robot.links[0].template != "rigid":
        return ""
    return "the robot file takes the pedestal for rigid: its full block is tested"


EFFECT = Effect(
    identifier="link_compliance",
    title="Compliance of a link",
    description="The link gives way like a beam along its axis: stretch, torsion, bending and shear "
    "both ways.",
    seen_in=BOTH,
    places=links,
    realise=block(template_pairs),
    unlikely=_unlikely,
    confused_with=("joint_compliance", "base_compliance", "tool_compliance", "link_asymmetry"),
    separated_by="poses that turn the joints next to the link, and loads in several directions",
)
