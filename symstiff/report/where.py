"""Where the residual sits: by axis, marker, load, time and range of every joint, before and after."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from symstiff.arrays import Array, Mask
from symstiff.calibration.tables.measurements import COMPONENTS, Measurements
from symstiff.discrepancy.findings.finding import Finding
from symstiff.report.tables import standardised
from symstiff.robot.schema import Robot

_SIZES = 6
"""Sizes of loads that are told each by itself; of more there are thirds."""
_THIRDS = ("first", "middle", "last")
_ALIKE = 1e-3
"""Difference of sizes of loads, as a share of the largest, that is none."""


@dataclass(frozen=True)
class Part:
    """Some readings: what they are, how many, root mean square of their residual over the noise before and after."""

    name: str
    readings: int
    before: float
    after: float


def parts(finding: Finding) -> list[Part]:
    """The parts of a table in which there are readings; parts that hold all of them are left out."""
    first, last = (standardised(finding, s.residual) ** 2 for s in (finding.steps[0], finding.steps[-1]))
    read = np.isfinite(first)
    out = []
    for name, rows in _groups(finding.table, finding.task.robot):
        own = read & rows
        if own.any() and own.sum() != read.sum():
            sizes = (float(np.sqrt(np.mean(z[own]))) for z in (first, last))
            out.append(Part(name, int(own.sum()), *sizes))
    return out


def _groups(table: Measurements, robot: Robot) -> Iterator[tuple[str, Mask]]:
    """Names and readings (N, 6) of the parts."""
    for k, axis in enumerate(COMPONENTS):
        yield f"axis {axis}", np.broadcast_to(np.arange(6) == k, (len(table), 6))
    for name, rows in (*_markers(table), *_loads(table), *_times(table), *_ranges(table, robot)):
        yield name, np.broadcast_to(rows[:, None], (len(table), 6))


def _markers(table: Measurements) -> Iterator[tuple[str, Mask]]:
    for k, name in enumerate(table.points):
        yield f"marker {name}", table.point == k


def _loads(table: Measurements) -> Iterator[tuple[str, Mask]]:
    forces = table.w[:, :3].any()
    size = np.linalg.norm(table.w[:, :3] if forces else table.w[:, 3:], axis=1)
    unit, largest = "N" if forces else "N·m", float(size.max(initial=0.0))
    if largest == 0.0:
        return
    level = np.round(size / largest / _ALIKE)
    levels = np.unique(level)
    if len(levels) <= _SIZES:
        for one in levels:
            yield f"loads of {float(np.median(size[level == one])):.4g} {unit}", level == one
        return
    for which, rows, low, high in _thirds(size):
        yield f"loads, {which} third ({low:.4g} to {high:.4g} {unit})", rows


def _times(table: Measurements) -> Iterator[tuple[str, Mask]]:
    if not np.all(np.isfinite(table.time)) or not np.ptp(table.time) > 0:
        return
    for which, rows, low, high in _thirds(table.time - table.time.min()):
        yield f"time, {which} third ({low:.4g} to {high:.4g} s)", rows


def _thirds(values: Array) -> Iterator[tuple[str, Mask, float, float]]:
    """Which, rows (N,), and limits of the thirds of the rows by their values."""
    ends = np.quantile(values, (1 / 3, 2 / 3))
    place = np.searchsorted(ends, values, side="left")
    for k, which in enumerate(_THIRDS):
        rows = place == k
        if rows.any():
            yield which, rows, float(values[rows].min()), float(values[rows].max())


def _ranges(table: Measurements, robot: Robot) -> Iterator[tuple[str, Mask]]:
    """Lower and upper half of the way of every joint that moves."""
    for j in range(table.dof):
        q = table.q[:, j]
        middle = float(q.max() + q.min()) / 2
        told = f"{middle:.3g}".replace("-", "−") + (" m" if robot.joint[j].prismatic else " rad")
        if np.ptp(q) > 0:
            yield f"q{j + 1} below {told}", q < middle
            yield f"q{j + 1} from {told} on", q >= middle
