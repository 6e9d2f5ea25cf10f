"""Joints that settle at another place at every reading: what is left scatters along what they move."""

from __future__ import annotations

import numpy as np

from symstiff.arrays import TINY, Array, Index, numbered
from symstiff.calibration.experiment.situation import View
from symstiff.symbolic.terms import actuated_joint

_SURE, _NOTABLE = 6.0, 1.6
"""Standard deviations above one, and times the variance of all directions, from which a joint is said to scatter."""
_FEWEST = 40
"""Readings, less one a pose, that it takes."""


def unsettled(view: View, residual: Array, spread: Array) -> tuple[int, float] | None:
    """The joint along which readings of one pose scatter most, and how many times the standard deviation of all
    directions; None if none does.

    residual: (M,) what is left, spread: (6,) its standard deviation by component; a law that is still missing scatters
    as well.
    """
    table = view.table
    reading = _readings(view)
    series = numbered(table.pose[view.state], table.point[view.state], view.component)
    z = _within(residual / spread[view.component], series)
    freedom = len(np.unique(reading)) - len(np.unique(table.pose))
    rows = len(z) - len(np.unique(series))
    if freedom < _FEWEST:
        return None
    overall = float(z @ z) / rows
    found: dict[int, float] = {}
    for j in range(1, view.robot.dof + 1):
        moved = view.J[:, view.index[actuated_joint(j)]] / spread[view.component]
        length = np.bincount(reading, moved**2)
        along = np.bincount(reading, moved * z) / np.sqrt(np.maximum(length, TINY))
        found[j] = float(along @ along) / freedom / max(overall, TINY)
    joint = max(found, key=lambda j: found[j])
    if found[joint] < max(_NOTABLE, 1.0 + _SURE * np.sqrt(2.0 / freedom)):
        return None
    return joint, float(np.sqrt(found[joint]))


def _readings(view: View) -> Index:
    """(M,) number of the reading that a row belongs to: the points of one load of one pose."""
    table, rows = view.table, view.state
    told = (np.nan_to_num(x, nan=-2.0)[rows] for x in (table.load_step, table.branch, table.repeat))
    return numbered(table.pose[rows], *table.w[rows].T, *told)


def _within(z: Array, series: Index) -> Array:
    """Values (M,) less the mean of their series."""
    return np.asarray(z - (np.bincount(series, z) / np.bincount(series))[series])
