"""Terms of a link's compliance that a straight symmetric beam does not have: bolted joints, ribs, offsets."""

from __future__ import annotations

from symstiff.effects.base import Effect, Where
from symstiff.effects.blocks import block, other_pairs
from symstiff.effects.common import BOTH, links
from symstiff.robot.schema import Robot


def _unlikely(robot: Robot, where: Where, rigid: bool) -> str:
    """Couplings between axes of which none gives way are no compliance."""
    if robot.links[int(where["link"])].template == "rigid":
        return "the robot file takes this link for rigid: it has a compliance before it has an asymmetry"
    return "the model takes all links for rigid: compliances come before asymmetries" if rigid else ""


EFFECT = Effect(
    identifier="link_asymmetry",
    title="Asymmetry of a link",
    description="Entries of the link's 6 × 6 compliance outside the beam's template.",
    seen_in=BOTH,
    places=links,
    realise=block(other_pairs),
    unlikely=_unlikely,
    confused_with=("link_compliance", "base_compliance", "tool_compliance"),
    separated_by="loads in several directions on the link; at the pedestal and at the tool it is the "
    "same columns "
    "as their full blocks",
)
