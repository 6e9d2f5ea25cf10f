"""A link that bends, twists and stretches as a beam: Δθ = k·τ at its six virtual joints (seed eq. 13)."""

from __future__ import annotations

from symstiff.effects.base import Effect
from symstiff.effects.blocks import block, template_pairs
from symstiff.effects.common import BOTH, links

EFFECT = Effect(
    identifier="link_compliance",
    title="Compliance of a link",
    description="The link gives way like a beam along its axis: stretch, torsion, bending and shear "
    "both ways.",
    seen_in=BOTH,
    places=links,
    realise=block(template_pairs),
    confused_with=("joint_compliance", "base_compliance", "tool_compliance", "link_asymmetry"),
    separated_by="poses that turn the joints next to the link, and loads in several directions",
)
