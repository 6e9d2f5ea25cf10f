"""Physical ranges at the size of an experiment: those of the catalogue, wider for small arms and for large ones.

The catalogue's are those of industrial arms under the loads that they carry, and no range becomes narrower than that.
What gives way by 0.05 rad under 5 N·m may do so under less, what a sensor of 5 kN is off by may grow with the load, and
a length with the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.calibration.experiment.situation import View
from symstiff.effects.base import EffectParameter

LIGHT = 5.0
"""Largest load [N, N·m] below which a compliance may be larger than any of an industrial arm."""
HEAVY, LONG = 5e3, 4.0
"""Largest force [N] and reach [m] above which an arm is larger than the catalogue's."""


@dataclass(frozen=True)
class Extent:
    """The largest torque [N·m] and force [N] on any link, and the reach [m]; zero where nothing is known."""

    torque: float = 0.0
    force: float = 0.0
    reach: float = 0.0

    def factor(self, unit: str) -> float:
        """By how much a range in a unit is wider than the catalogue's."""
        factors = {
            "rad/(N*m)": _light(self.torque), "rad/N": _light(self.force), "m/N": _light(self.force),
            "N": self.force / HEAVY, "N*m": self.torque / (HEAVY * LONG), "m": self.reach / LONG,
        }  # fmt: skip
        return max(factors.get(unit, 1.0), 1.0)


CATALOGUE = Extent()
"""Where the experiment's size is not known."""


def extent_of(view: View) -> Extent:
    """The size of an experiment."""
    largest = np.abs(view.tau).max(axis=0, initial=0.0)
    torque, force = (
        max((float(x) for v, x in zip(view.joints, largest, strict=True) if v.kind == "link" and v.rotational is turns),
            default=0.0)
        for turns in (True, False)
    )  # fmt: skip
    return Extent(torque, force, view.robot.reach)


def at_size(parameters: Sequence[EffectParameter], extent: Extent) -> tuple[EffectParameter, ...]:
    """The parameters with the ranges of an experiment's size."""
    wider = ((p, extent.factor(p.unit)) for p in parameters)
    return tuple(replace(p, low=k * p.low, high=k * p.high) for p, k in wider)


def _light(load: float) -> float:
    return LIGHT / load if load > 0 else 1.0
