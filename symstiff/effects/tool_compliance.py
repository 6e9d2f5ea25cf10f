"""Flange, force sensor and tool mount: a full symmetric compliance block at the last link."""

from __future__ import annotations

from symstiff.effects.base import Effect
from symstiff.effects.blocks import all_pairs, block
from symstiff.effects.common import BOTH

EFFECT = Effect(
    identifier="tool_compliance",
    title="Compliance of the tool mount",
    description="Flange, sensor and tool give way: all 21 terms at the last link.",
    seen_in=BOTH,
    places=lambda robot: ({"link": robot.dof},),
    realise=block(all_pairs),
    confused_with=("link_compliance", "link_asymmetry", "joint_compliance"),
    separated_by="loads in several directions; its translations are inside the last link's columns and "
    "no data tell "
    "them apart",
)
