"""A trajectory written again with other joint values: its columns, their order and units, and all other cells stay."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.tables.checks import same_configuration
from symstiff.calibration.tables.columns import read_header
from symstiff.calibration.tables.measurements import Measurements
from symstiff.calibration.tables.table import Cells
from symstiff.files import write_file


def rewrite_joints(cells: Cells, table: Measurements, q: Array, output: Path) -> tuple[str, ...]:
    """Write the cells of a file, which was read as ``table``, with joint values ``q`` (M, n) in rad and m.

    Returns the labels that got a number each, because their rows are no longer one configuration. Raises UserError
    where the file cannot be written.
    """
    lines, rows = cells
    columns = read_header(rows[0], f"{table.files[0]}: line {lines[0]}", "poses")
    body = [list(row) for row in rows[1:]]
    for k, name in enumerate(columns.joints):
        column = columns.named[name]
        for row, value in zip(body, (q[:, k] / column.factor).tolist(), strict=True):
            row[column.index] = f"{value + 0.0:.15g}"
    labels, split = _labels(table, q) if "pose" in columns.named else ([], ())
    for row, label in zip(body, labels, strict=False):
        row[columns.named["pose"].index] = label
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows([rows[0], *body])
    write_file(output, buffer.getvalue())
    return split


def _labels(table: Measurements, q: Array) -> tuple[list[str], tuple[str, ...]]:
    """Every row's label, numbered where its rows are several configurations that no table may give one label."""
    labels = [table.labels[k] for k in table.pose]
    apart = ~same_configuration(table.pose, len(table.labels), q)
    split = np.unique(table.pose[apart])
    taken = set(table.labels)
    for pose in split:
        numbered: dict[bytes, str] = {}
        for row in np.flatnonzero(table.pose == pose):
            label, number = table.labels[pose], len(numbered) + 1
            while q[row].tobytes() not in numbered and f"{label}/{number}" in taken:
                number += 1
            labels[row] = numbered.setdefault(q[row].tobytes(), f"{label}/{number}")
            taken.add(labels[row])
    return labels, tuple(table.labels[k] for k in split)
