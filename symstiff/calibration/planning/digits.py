"""Planned poses in digits that somebody can enter at a controller, as far as the region allows."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.planning.candidates import Space
from symstiff.calibration.planning.region import allowed

_ANGLE, _LENGTH, _LOAD = 4, 6, 6
"""Decimals of angles in degrees and of lengths in metres; significant digits of a load's magnitude."""
_ROUNDING = 1e-6
"""Units of the last digit by which a limit may miss a round number."""


def in_few_digits(space: Space, q: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (N, n) and wrenches (N, 6) rounded to 0.0001°, 0.001 mm and six digits of the load.

    Fixed joints and given load cases stay as they are, and so does a pose that rounding would move out of the region;
    all do where poses share levels.
    """
    rounded = np.array(q)
    for j in space.free:
        unit = 10.0**-_LENGTH if space.robot.rows[j][0] else np.radians(10.0**-_ANGLE)
        low, high = space.limits[j]
        steps = np.clip(
            np.round(q[:, j] / unit), np.ceil(low / unit - _ROUNDING), np.floor(high / unit + _ROUNDING)
        )
        rounded[:, j] = np.clip(steps * unit, low, high)
    keep = allowed(space.region, space.robot, rounded)
    if space.levels and not np.all(keep):
        keep[:] = False  # poses of one level have one value
    return np.where(keep[:, None], rounded, q), w if space.load.cases else _loads(space, w)


def _loads(space: Space, w: np.ndarray) -> np.ndarray:
    """Wrenches with the components of free directions in as many digits as their magnitude has."""
    out = np.array(w)
    for k, magnitude in enumerate(space.load.magnitudes):
        part = slice(3 * k, 3 * k + 3)
        out[:, part] = np.round(w[:, part], _LOAD - 1 - int(np.floor(np.log10(magnitude))))
    return out
