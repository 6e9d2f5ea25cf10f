"""Poses tables in which every pose is seen at several markers, and under a load that comes in steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from symstiff.calibration.tables.measurements import Measurements, measurements


def with_markers(
    q: np.ndarray, w: np.ndarray, markers: tuple[str, ...], joint_units: Sequence[str] | None = None
) -> Measurements:
    """A poses table with one row a pose and marker; joints in rad unless ``joint_units`` says m."""
    n, k = len(q), len(markers)
    return measurements(
        np.repeat(q, k, axis=0),
        np.repeat(w, k, axis=0),
        labels=[f"p{i + 1}" for i in range(n)],
        pose=np.repeat(np.arange(n), k),
        points=markers,
        point=np.tile(np.arange(k), n),
        joint_units=joint_units,
    )


def gain_of_steps(steps: int) -> float:
    """How many times the whole load's information on linear parameters all its steps hold, read independently."""
    return float(np.sum((np.arange(1, steps + 1) / steps) ** 2))


def in_steps(table: Measurements, steps: int) -> Measurements:
    """The table with every pose's load in equal steps up to the whole, numbered in ``load_step``."""
    rows = [np.flatnonzero(table.pose == p) for p in np.unique(table.pose)]
    order = np.concatenate([np.tile(own, steps) for own in rows])
    step = np.concatenate([np.repeat(np.arange(1, steps + 1), len(own)) for own in rows])
    found = table.select(order)
    return replace(found, w=found.w * (step / steps)[:, None], load_step=step.astype(float))
