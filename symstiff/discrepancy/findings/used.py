"""What of a table a diagnosis uses: poses that are not too many, what is told throughout, readings under load."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from symstiff.calibration.tables.checks import without_copies, without_zeros
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.numbers import milli

MOST_POSES, MOST_ROWS, LEAST_POSES = 200, 7200, 30
"""Poses, and readings of one component, that are used unless more poses are asked for: time and room grow with both.
Poses that are used however many readings they have."""


def used(table: Measurements, max_poses: int | None = None) -> tuple[Measurements, list[str]]:
    """The part of a table that is used, and a remark on everything that is not."""
    remarks = []
    for part in (
        without_zeros,
        without_copies,
        partial(thinned, max_poses=max_poses),
        known_throughout,
        under_load,
    ):
        table, said = part(table)
        remarks += said
    return table, remarks


def thinned(table: Measurements, max_poses: int | None) -> tuple[Measurements, list[str]]:
    """Poses spread evenly over the table where there are more than wanted."""
    poses = np.unique(table.pose)
    readings = int(np.sum(table.measured))
    most = min(MOST_POSES, max(LEAST_POSES, MOST_ROWS * len(poses) // max(readings, 1)))
    most = most if max_poses is None else max_poses
    if len(poses) <= most:
        return table, []
    kept = poses[np.linspace(0, len(poses) - 1, most).round().astype(int)]
    return table.select(np.isin(table.pose, kept)), [
        f"{most} of {len(poses)} poses are used, evenly spread (--max-poses takes more)"
    ]


def known_throughout(table: Measurements) -> tuple[Measurements, list[str]]:
    """The table without times and temperatures that some rows lack, and a remark on each."""
    remarks = []
    blank = np.full(len(table), np.nan)
    if _partial(table.time):
        table = replace(table, time=blank)
        remarks.append("the time is not told in every row: it is not used")
    if _partial(table.temperature):
        table = replace(table, temperature=blank)
        remarks.append("the temperature is not told in every row: it is not used")
    return table, remarks


def under_load(table: Measurements) -> tuple[Measurements, list[str]]:
    """The table without rows that have come back to no load, and a remark where there are any.

    What a load leaves behind there is friction's, with the sign of a load that is gone: no law of the load holds it.
    """
    back = (table.branch < 0) & ~np.any(table.w, axis=1)
    if table.kind != "deflection" or not back.any() or not np.any(table.w[~back]):
        return table, []
    left = float(np.sqrt(np.nanmean(table.values[back, :3] ** 2))) if table.measured[back, :3].any() else 0.0
    return table.select(np.flatnonzero(~back)), [
        f"{int(back.sum())} rows have come back to no load (they read {milli(left)} mm rms): what a load leaves behind "
        "is no law of the load, so these rows are left out"
    ]


def _partial(values: np.ndarray) -> bool:
    known = np.isfinite(values)
    return bool(known.any() and not known.all())
