"""Files of positions that do not tell where the measuring device stood."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.experiment.placement import closest
from symstiff.calibration.experiment.situation import look
from symstiff.calibration.tables.measurements import Measurements
from symstiff.errors import UserError
from symstiff.robot.schema import Robot

_FAR, _TIMES = 0.01, 5.0
"""How far points are where the device stood elsewhere: at least this share of the reach, and so many times as far as
those of the file by which it is placed."""


def check_stations(robot: Robot, table: Measurements) -> None:
    """Refuse a file that does not tell where the device stood, and was not measured from the first place.

    Raises UserError with the file.
    """
    if table.kind != "absolute":
        return
    telling = table.telling
    others = [k for k in np.unique(table.file) if k not in telling]
    whole = table.measured[:, :3].all(axis=1)
    if not telling or not others or not whole.any():
        return
    view = look(robot, table)
    points, seen = view.found.T[:, :3, 3] + view.offset, table.values[:, :3]
    first = whole & (table.file == telling[0])
    turn, shift = closest(points[first], seen[first])
    off = np.linalg.norm(seen - points @ turn.T - shift, axis=1)
    least = max(_FAR * robot.reach, _TIMES * float(np.sqrt(np.mean(off[first] ** 2))))
    for k in others:
        away = off[whole & (table.file == k)]
        if len(away) and np.sqrt(np.mean(away**2)) > least:
            raise UserError(
                f"{table.files[k]}: its points are on a line or hardly apart, and tell not where the measuring device "
                f"stood; they are {np.sqrt(np.mean(away**2)):.2g} m from where they would be as it stood for "
                f"{table.files[telling[0]]}: leave the file out, or measure more poses in that session"
            )
