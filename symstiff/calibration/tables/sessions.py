"""Files that are sessions of their own: their clocks, where a table's rows come from several."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from symstiff.calibration.tables.measurements import Measurements


def by_session(table: Measurements) -> tuple[Measurements, list[str]]:
    """The table with a time that begins anew for every session, and a remark where there are several.

    A file that begins later after another's end than both took is another session: what warmed up in the first has
    cooled, and the device was set up anew. Time then counts as in the first session, from its first row on.
    """
    numbers = np.unique(table.file)
    if len(numbers) < 2 or not np.isfinite(table.time).all():
        return table, []
    spans = [(table.time[table.file == k].min(), table.time[table.file == k].max(), k) for k in numbers]
    spans.sort()
    time, back, later = np.array(table.time), 0.0, []
    for (begin, end, _), (begins, ends, k) in pairwise(spans):
        if begins - end > max(end - begin, ends - begins) > 0.0:
            back = begins - spans[0][0]
            later.append(Path(table.files[k]).name)
        time[table.file == k] -= back
    if not later:
        return table, []
    return replace(table, time=time), [
        f"{', '.join(later)}: a session of its own, later by more than the sessions took: its time counts from its "
        "first row, as that of the first session does"
    ]
