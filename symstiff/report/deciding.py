"""What the poses of decide.csv reach, in words: one saying for the console, verdict.json and the report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from symstiff.arrays import Array
from symstiff.discrepancy.apart.deciding import Setup

DECIDES = 9.0
"""Separation from which explanations are told apart: three standard deviations."""


NOWHERE = "No pose tells them apart under these loads: others may, unless both are the same to the tool."
OTHERWISE = "repeated readings, more poses, other loads or another way to measure would"
"""What decides where the poses of decide.csv may not."""


def separation_text(separation: float) -> str:
    """A separation as one writes it: three digits, whole numbers from a thousand on."""
    return f"{separation:.3g}" if separation < 1000 else f"{separation:.0f}"


def reach(separation: float) -> str:
    """How far some poses tell explanations apart, and whether that will do."""
    verdict = (
        f" ({DECIDES:.0f} decides)"
        if separation >= DECIDES
        else f", which may not decide ({DECIDES:.0f} does)"
    )
    return f"a separation of {separation_text(separation)}{verdict}"


def reached(decide: Mapping[str, Any]) -> str:
    """The same of all poses of decide.csv; empty where there are none."""
    poses = decide["poses"]
    return reach(poses[-1]["separation"]) if poses else ""


def deciding(decide: Mapping[str, Any]) -> str:
    """What decide.csv holds, in a sentence."""
    told = reached(decide)
    if not told:
        return NOWHERE
    rest = "" if decides(decide) else f": {OTHERWISE}"
    what = "poses and loads" if load_axes(decide) else "poses"
    return f"decide.csv holds the {what} that tell them apart best; they reach {told}{rest}."


def load_axes(decide: Mapping[str, Any]) -> list[str]:
    """Axes of the poses' loads; none where the arm carries nothing."""
    loads = decide["loads"]
    return [a for a in (loads[0] if loads else {}) if any(w[a] for w in loads)]


def decides(decide: Mapping[str, Any]) -> bool:
    """Whether the poses of decide.csv tell the explanations apart."""
    poses = decide["poses"]
    return bool(poses) and poses[-1]["separation"] >= DECIDES


def assumed(setup: Setup, sigma: Array) -> str:
    """What the separation of planned poses takes for granted, in words."""
    force, moment = (float(np.abs(part).max()) for part in np.split(setup.loads, 2, axis=1))
    loads = f"{len(setup.loads)} loads of up to {force:g} N" + f" and {moment:g} N·m" * (moment > 0)
    read = ", ".join(setup.points)
    noise = f"σ {1e3 * sigma[0]:.2g} mm a coordinate"
    whole = f", {1e3 * sigma[3]:.2g} mrad a rotation" if max(setup.components) >= 3 else ""
    return f"assumed: {loads if force or moment else 'no load'}; measured: {read}, {noise}{whole}"
