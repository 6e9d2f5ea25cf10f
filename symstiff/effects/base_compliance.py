"""The pedestal, its floor or a mobile platform: a full symmetric compliance block at link 0."""

from __future__ import annotations

from symstiff.effects.base import Effect
from symstiff.effects.blocks import all_pairs, block
from symstiff.effects.common import BOTH

EFFECT = Effect(
    identifier="base_compliance",
    title="Compliance of the base",
    description="What the robot stands on shifts and rocks under the load: all 21 terms at the pedestal.",
    seen_in=BOTH,
    places=lambda robot: ({"link": 0},),
    realise=block(all_pairs),
    confused_with=("joint_compliance", "link_compliance", "link_asymmetry"),
    separated_by="poses that turn joint 1",
)
