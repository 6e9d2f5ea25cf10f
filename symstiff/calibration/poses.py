"""Poses tables in which every pose is seen at several markers."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.measurements import Measurements, measurements


def with_markers(q: np.ndarray, w: np.ndarray, markers: tuple[str, ...]) -> Measurements:
    """A poses table with one row a pose and marker."""
    n, k = len(q), len(markers)
    return measurements(
        np.repeat(q, k, axis=0),
        np.repeat(w, k, axis=0),
        labels=[f"p{i + 1}" for i in range(n)],
        pose=np.repeat(np.arange(n), k),
        points=markers,
        point=np.tile(np.arange(k), n),
    )
