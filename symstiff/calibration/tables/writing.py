"""Writing tables: the same CSV format that is read, put in place only when it is complete."""

from __future__ import annotations

import csv
import io
from math import degrees
from pathlib import Path
from typing import Literal

import numpy as np

from symstiff.arguments import A_TABLE, require
from symstiff.arrays import Array
from symstiff.calibration.tables.measurements import COMPONENTS, Measurements
from symstiff.errors import UserError
from symstiff.files import write_file

Column = list[str] | Array

LOADS = ("fx[N]", "fy[N]", "fz[N]", "mx[N*m]", "my[N*m]", "mz[N*m]")
_CONTEXT = (("load_step", "load_step"), ("repeat", "repeat"))
_PLAIN = (("time", "time[s]"), ("temperature", "temperature[degC]"))


def write_table(table: Measurements, path: str | Path, angle: Literal["rad", "deg"] = "rad") -> None:
    """Write a table that ``read_table`` or ``read_poses`` reads back; ``angle`` is the unit of q.

    Raises UserError where the file cannot be written, or where a component is measured, or its sigma told, in
    some rows only.
    """
    require(table, Measurements, *A_TABLE)
    content = columns(table, angle)
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(content)
    writer.writerows(zip(*(_texts(column) for column in content.values()), strict=True))
    write_file(path, buffer.getvalue())


def columns(table: Measurements, angle: Literal["rad", "deg"] = "rad") -> dict[str, Column]:
    """Return the columns by header, in the file's units; columns of which nothing is known are left out."""
    if angle not in ("rad", "deg"):
        raise UserError(f"angle {str(angle)[:40]!r}: write joint variables in rad or deg")
    result: dict[str, Column] = {"pose": [table.labels[k] for k in table.pose]}
    for k, unit in enumerate(table.joint_units):
        in_degrees = unit == "rad" and angle == "deg"
        result[f"q{k + 1}[{'deg' if in_degrees else unit}]"] = table.q[:, k] * (
            degrees(1) if in_degrees else 1
        )
    for k, header in enumerate(LOADS):
        if table.w[:, k].any():
            result[header] = table.w[:, k]
    if table.points != ("tcp",):
        result["point"] = [table.points[k] for k in table.point]
    prefix = "d" if table.kind == "deflection" else ""
    for k, component in enumerate(COMPONENTS):
        unit, scale = ("rad", 1.0) if k >= 3 else ("mm", 1e3)
        known = table.measured[:, k]
        if table.kind != "none" and known.any():
            if not known.all():
                raise UserError(
                    f"{table.place(int(np.argmin(known)))}: {prefix}{component} is measured in other rows "
                    "only: write tables with different components separately"
                )
            result[f"{prefix}{component}[{unit}]"] = table.values[:, k] * scale
    for k, component in enumerate(COMPONENTS):
        unit, scale = ("rad", 1.0) if k >= 3 else ("mm", 1e3)
        told = np.isfinite(table.sigma[:, k])
        if told.any():
            if not told.all():
                raise UserError(
                    f"{table.place(int(np.argmin(told)))}: sigma_{component} is told in other rows only: write "
                    "tables with and without it separately"
                )
            result[f"sigma_{component}[{unit}]"] = table.sigma[:, k] * scale
    for name, header in (*_PLAIN, *_CONTEXT):
        if np.isfinite(getattr(table, name)).any():
            result[header] = getattr(table, name)
    if np.isfinite(table.branch).any():
        result["branch"] = ["" if np.isnan(b) else ("up" if b > 0 else "down") for b in table.branch]
    return result


def _texts(column: Column) -> list[str]:
    """Format cells: numbers with 15 digits, kept to rounding when read back; unknown ones empty."""
    if isinstance(column, np.ndarray):
        return ["" if value != value else f"{value + 0.0:.15g}" for value in column.tolist()]
    return column
