"""Tables for reading: a line, and a table of a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.display import html_table

if TYPE_CHECKING:
    from symstiff.calibration.tables.measurements import Measurements

_ROWS = 8
"""Rows of a long table that are shown."""


def measurements_line(table: Measurements) -> str:
    """``deflection: 45 rows, 15 poses, 6 joints, points p1 p2 p3``."""
    poses = len(set(table.pose.tolist()))
    points = f", points {' '.join(table.points)}" if table.points != ("tcp",) else ""
    kind = "poses and loads" if table.kind == "none" else table.kind
    return f"{kind}: {len(table)} rows, {poses} poses, {table.dof} joints{points}"


def measurements_html(table: Measurements) -> str:
    """The first rows as their file has them."""
    from symstiff.calibration.tables.writing import columns

    found = columns(table.select(slice(_ROWS)))
    shown = [
        [cell if isinstance(cell, str) else round(float(cell), 6) for cell in row]
        for row in zip(*found.values(), strict=True)
    ]
    more = len(table) - len(shown)
    return html_table(list(found), shown, measurements_line(table), [f"and {more} more"] if more else [])
