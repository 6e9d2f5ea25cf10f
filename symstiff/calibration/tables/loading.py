"""The load of a table: as a factor of the largest, whether it grows or falls, and where it turned.

Loading and unloading where a table tells which way the load travelled: the laws take ``branch`` as +1 while the load
grows and -1 while it falls. A load that is driven through zero, from -F to +F and back, first falls and then grows
although its branch is "up" throughout.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.arrays import Array, Index
from symstiff.calibration.tables.measurements import Measurements


def as_loading(table: Measurements) -> Measurements:
    """The table with its branches as loading (+1) and unloading (-1), pose by pose; usual tables come back as they are.

    A pose whose load passes through zero on the way up is taken to tell the way of travel. Applied twice it changes
    nothing more.
    """
    share = load_factor(table)
    branch = np.array(table.branch)
    for rows in _by_pose(table):
        way = _through_zero(share[rows], table.branch[rows], table.load_step[rows])
        if way:
            side = np.sign(share[rows]) * way
            branch[rows] *= np.where(side == 0, 1.0, side)
    return table if np.array_equal(branch, table.branch, equal_nan=True) else replace(table, branch=branch)


def at_rest(table: Measurements) -> Measurements:
    """The table with the branch 0, inside the loop, of rows that carry nothing and tell none."""
    free = np.isnan(table.branch) & ~np.any(table.w != 0, axis=1)
    return replace(table, branch=np.where(free, 0.0, table.branch)) if free.any() else table


def load_factor(table: Measurements) -> Array:
    """(N,) every wrench's component along the largest of its pose, as a share of it; N·m count as N."""
    share = np.zeros(len(table))
    for rows in _by_pose(table):
        loads = table.w[rows]
        largest = loads[np.argmax(np.linalg.norm(loads, axis=1))]
        square = float(largest @ largest)
        share[rows] = loads @ largest / square if square else 0.0
    return np.round(share, 9)


def turn_of(table: Measurements) -> Array:
    """(N,) the load where it last turned over the present one: 1 while it grows, NaN where the branch is not told.

    On the way down that is the largest load of the pose to the same side; of the table, where the pose tells of no way
    up. Without a load it is 1: nothing tells which way it points.
    """
    turn = np.where(np.isnan(table.branch), np.nan, 1.0)
    if not np.any(table.branch < 0):
        return turn
    share, size = load_factor(table), np.linalg.norm(table.w, axis=1)
    loaded, falls = share != 0, (share != 0) & (table.branch < 0)
    way = 2 * table.pose + (share > 0)
    top = np.zeros(way.max() + 1)
    np.maximum.at(top, way, np.abs(share))
    told = np.bincount(way, loaded & ~falls)[way] > 0
    own, other = falls & told, falls & ~told
    turn[own] = top[way[own]] / np.abs(share[own])
    turn[other] = size.max() / size[other]
    return turn


def _by_pose(table: Measurements) -> list[Index]:
    """The rows of every pose, in the table's order: sorted once, for tables of many poses."""
    order = np.argsort(table.pose, kind="stable")
    starts = np.flatnonzero(np.diff(table.pose[order])) + 1
    return np.split(order, starts) if len(order) else []


def _through_zero(share: Array, branch: Array, step: Array) -> float:
    """+1 or -1: which way the load goes on the branch up where it runs through zero; 0 where it does not.

    One load to each side tells no way where one falls between them (push and pull), or falls the same way after them.
    Loads on the branch up before the first one down may be those of an arm that had none yet.
    """
    told = np.flatnonzero(np.isfinite(branch) & (branch != 0.0))
    if np.isfinite(step[told]).all():
        told = told[np.argsort(step[told], kind="stable")]
    up, down = (np.flatnonzero(side * branch[told] > 0) for side in (1, -1))
    load = share[told]
    if not len(down) or not (np.any(load[up] > 0) and np.any(load[up] < 0)):
        return 0.0
    later = up[up > down[0]]
    if np.any(load[later] > 0) and np.any(load[later] < 0):
        up = later
    change = np.diff(load[up])
    way = 1.0 if np.all(change >= 0) else (-1.0 if np.all(change <= 0) else 0.0)
    if np.any((down > up[0]) & (down < up[-1])):
        return way if len(up) > 2 else 0.0
    return way if np.all(way * np.diff(load[down]) <= 0) else 0.0
