"""Measurement and poses tables and trajectories: CSV in, ``Measurements`` out, every mistake with its line.

The stages of reading one file: text (UTF-8, not binary) → rows with line numbers → columns with units
(``Columns``) → numbers in SI → consistency of the rows (``checks``). The format is that of docs/formats.md:
one row per pose, load case and measured point, units in brackets in the header.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from symstiff.arguments import require, require_path
from symstiff.arrays import Array, Index
from symstiff.calibration.tables.checks import check_rows, check_sigmas, elsewhere
from symstiff.calibration.tables.columns import SHOWN, Columns, read_header
from symstiff.calibration.tables.measurements import (
    COMPONENTS,
    CONTEXT,
    Kind,
    Measurements,
    concatenate,
)
from symstiff.calibration.tables.units import KELVIN
from symstiff.calibration.tables.writing import columns as columns_of
from symstiff.calibration.tables.writing import write_table
from symstiff.errors import UserError, printable
from symstiff.symbolic.terms import WRENCH

__all__ = ["read_poses", "read_table", "write_table"]

_MAX_BYTES = 1_000_000_000
_SMALLEST_SIGMA = 1e-13  # m, rad
_NO_DIGITS = re.compile(r"_|[^\D0-9]")  # NumPy reads 1_000 and other scripts' digits, the format does not
Cells = tuple[list[int], list[list[str]]]
Paths = str | Path | Sequence[str | Path]


def read_table(paths: Paths) -> Measurements:
    """Read one or several measurement tables as one.

    A pose label means the same in all of them; where another file has it for other joint values, as of another
    campaign, it is told from the first by the file's name. Raises UserError with file and line for whatever the format
    does not allow; for tables without measured columns; for deflection data in which every wrench is zero.
    """
    return _read(paths, "measured")


def read_poses(paths: Paths) -> Measurements:
    """Read poses tables or trajectories: the columns of a measurement table, measured ones may be absent.

    Without a column ``pose`` every row is a configuration of its own, labelled by its number. Raises
    UserError with file and line.
    """
    return _read(paths, "poses")


def _read(paths: Paths, purpose: Literal["measured", "poses"]) -> Measurements:
    if isinstance(paths, str | PathLike):
        paths = [Path(paths)]
    require(paths, Sequence, "a table's path, or several", "name at least one CSV file")
    if not paths:
        raise UserError("no table given: name at least one CSV file")
    for k, path in enumerate(paths):
        require_path(path, "a table")
        if Path(path).resolve() in [Path(other).resolve() for other in paths[:k]]:
            raise UserError(f"{path} is given twice: name each table once")
    table = concatenate(_told_apart([read_file(Path(path), purpose) for path in paths]))
    check_rows(table)
    return table


def _told_apart(tables: Sequence[Measurements]) -> list[Measurements]:
    """Tables of which no label stands for other joint values than in one before: there its file's name is added."""
    known: dict[str, Array] = {}
    stems = [Path(table.files[0]).stem for table in tables]
    out = []
    for table, stem in zip(tables, stems, strict=True):
        file = stem if stems.count(stem) == 1 else table.files[0]
        _, first = np.unique(table.pose, return_index=True)
        own = dict(zip(table.labels, table.q[first], strict=True))
        labels = [f"{n} ({file})" if n in known and elsewhere(q, known[n]) else n for n, q in own.items()]
        out.append(replace(table, labels=tuple(labels)))
        known = dict(zip(labels, own.values(), strict=True)) | known
    return out


def check_limits(table: Measurements) -> None:
    """Refuse a table that holds a number which would not be read back. Raises UserError with column and row."""
    content = columns_of(table)
    header = read_header(list(content), "table", "poses" if table.kind == "none" else "measured")
    for column in header.named.values():
        title = header.headers[column.index]
        cells = content[title]
        if not isinstance(cells, np.ndarray):
            continue
        sizes = np.abs(cells * column.factor)
        low = _SMALLEST_SIGMA if title.startswith("sigma_") else 0.0
        fits = np.isnan(cells) | ((sizes >= low) & (sizes <= column.limit) & np.isfinite(sizes))
        if not fits.all():
            row = int(np.argmin(fits))
            raise UserError(
                f"row {row + 1}: {title} would be {cells[row]:g}, which no table holds: look at the sizes of "
                "effects, noise and [environment]"
            )
    check_sigmas(table)


def read_file(path: Path, purpose: Literal["measured", "poses"]) -> Measurements:
    """Read one CSV file; rows are checked one by one here, against each other in ``check_rows``."""
    return _table(*cells_of(path), str(path), purpose)


def read_trajectory(path: Path) -> tuple[Measurements, Cells]:
    """Read a trajectory with its cells as text, at once: a pipe can be read no second time. Raises UserError."""
    cells = cells_of(path)
    table = _table(*cells, str(path), "poses")
    check_rows(table, path=True)
    return table, cells


def _table(
    lines: list[int], rows: list[list[str]], origin: str, purpose: Literal["measured", "poses"]
) -> Measurements:
    first, lines, header, rows = lines[0], lines[1:], rows[0], rows[1:]
    columns = read_header(header, f"{origin}: line {first}", purpose)
    if not rows:
        raise UserError(f"{origin}: line {first}: a header and no rows: add at least one row of data")
    width = len(columns.headers)
    for line, row in zip(lines, rows, strict=True):
        if len(row) != width:
            raise UserError(
                f"{origin}: line {line}: {len(row)} cells where the header has {width}: "
                "one comma between cells, a point as decimal mark"
            )
    return _Reader(origin, np.array(lines, dtype=np.intp), columns, list(zip(*rows, strict=True))).table()


def cells_of(path: Path) -> Cells:
    """Return the line numbers and the cells of a file's rows, header first, as text."""
    return _cells(_text(path, str(path)), str(path))


def _text(path: Path, origin: str) -> str:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise UserError(f"{origin}: larger than {_MAX_BYTES} bytes: split the table into several files")
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{origin}: cannot read the table: {error.strerror}: check the path") from error
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise UserError(f"{origin}: line {line}: not a text file: save the table as CSV in UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise UserError(
            f"{origin}: line {line}: not text in UTF-8: save the table as CSV in UTF-8"
        ) from error


def _cells(text: str, origin: str) -> tuple[list[int], list[list[str]]]:
    """Split into rows of cells, with the line each row ends on; empty lines are skipped."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    lines, rows, read = [], [], 0
    try:
        for row in reader:
            read = reader.line_num
            if any(cell.strip() for cell in row):
                lines.append(reader.line_num)
                rows.append(row)
    except csv.Error as error:
        raise UserError(
            f"{origin}: line {read + 1}: not a row of a CSV table ({error}): check its quotes"
        ) from error
    if not rows:
        raise UserError(f"{origin}: line 1: empty file: a table has a header line and rows")
    return lines, rows


def _shown(cell: str) -> str:
    """A cell as a message repeats it."""
    return printable(cell.strip(), SHOWN)


class _Reader:
    """Turns the text columns of one file into arrays."""

    def __init__(
        self, origin: str, lines: np.ndarray, columns: Columns, cells: list[tuple[str, ...]]
    ) -> None:
        self.origin, self.lines, self.columns, self.cells = origin, lines, columns, cells

    def table(self) -> Measurements:
        rows, dof = len(self.lines), len(self.columns.joints)
        if "pose" in self.columns.named:
            labels, pose = self._names("pose")
        else:  # a trajectory: every row a pose of its own
            labels, pose = tuple(str(k + 1) for k in range(rows)), np.arange(rows)
        points, point = self._names("point") if "point" in self.columns.named else (("tcp",), pose * 0)
        q = np.empty((rows, dof))
        for k, name in enumerate(self.columns.joints):
            q[:, k] = self._numbers(name)
        w = np.zeros((rows, 6))
        for k, name in enumerate(WRENCH):
            if name in self.columns.named:
                w[:, k] = self._numbers(name)
        kind: Kind = self.columns.kind
        values, sigma = np.full((rows, 6), np.nan), np.full((rows, 6), np.nan)
        for k, component in enumerate(COMPONENTS):
            name = f"d{component}" if kind == "deflection" else component
            if kind != "none" and name in self.columns.named:
                values[:, k] = self._numbers(name)
            if f"sigma_{component}" in self.columns.named:
                sigma[:, k] = self._sigma(f"sigma_{component}")
        context = {name: self._context(name) for name in CONTEXT}
        return Measurements(
            labels=labels,
            pose=pose,
            q=q,
            w=w,
            points=points,
            point=point,
            kind=kind,
            values=values,
            sigma=sigma,
            joint_units=self.columns.joint_units,
            files=(self.origin,),
            file=np.zeros(rows, dtype=np.intp),
            line=self.lines,
            **context,
        )

    def _fail(self, row: int | np.intp, name: str, what: str) -> UserError:
        header = printable(self.columns.headers[self.columns.named[name].index], SHOWN)
        return UserError(f"{self.origin}: line {self.lines[row]}: column {header}: {what}")

    def _names(self, name: str) -> tuple[tuple[str, ...], np.ndarray]:
        order: dict[str, int] = {}
        empty = "tcp" if name == "point" else ""  # as where the column is absent
        index = np.array(
            [
                order.setdefault(cell.strip() or empty, len(order))
                for cell in self.cells[self.columns.named[name].index]
            ],
            dtype=np.intp,
        )
        if "" in order:
            row = int(np.argmax(index == order[""]))
            raise self._fail(row, name, f"missing value: give every row its {name}")
        odd = next((label for label in order if not label.isprintable()), None)
        if odd is not None:
            row = int(np.argmax(index == order[odd]))
            raise self._fail(row, name, f"{printable(odd, SHOWN)} holds a character that cannot be printed")
        return tuple(order), index

    def _numbers(self, name: str, rows: Index | None = None) -> Array:
        """Return a numeric column (or some rows of it) in SI; every cell must be a plausible number."""
        column = self.columns.named[name]
        cells: Sequence[str] = self.cells[column.index]
        if rows is None:
            rows = np.arange(len(cells))
        else:
            cells = [cells[row] for row in rows]
        try:
            if _NO_DIGITS.search("".join(cells)):
                raise ValueError
            raw = np.array(cells, dtype=float)
        except ValueError:
            raise self._bad_cell(name, cells, rows) from None
        if not np.isfinite(raw).all():
            k = int(np.argmin(np.isfinite(raw)))
            raise self._fail(
                rows[k], name, f"{_shown(cells[k])!r} is no finite number: correct or drop the row"
            )
        with np.errstate(over="ignore"):
            values = raw * column.factor
        too_large = np.abs(values) > column.limit
        if too_large.any():
            k = int(np.argmax(too_large))
            raise self._fail(rows[k], name, f"{_shown(cells[k])} {column.complaint}")
        return np.asarray(values)

    def _bad_cell(self, name: str, cells: Sequence[str], rows: Index) -> UserError:
        for row, cell in zip(rows, cells, strict=True):
            if not cell.strip():
                read = name.removeprefix("d") in COMPONENTS
                apart = (
                    "leave the row out, or move rows without that reading to a table without that column (several are "
                    "read together)"
                )
                remedy = apart if read else "fill it in, or drop the row or the column"
                return self._fail(row, name, f"missing value: {remedy}")
            try:
                float(_NO_DIGITS.sub("?", cell))
            except ValueError:
                return self._fail(
                    row, name, f"{_shown(cell)!r} is no number: use a point as decimal mark, no units"
                )
        return self._fail(0, name, "cannot be read as numbers")

    def _sigma(self, name: str) -> Array:
        values = self._numbers(name)
        if (values <= 0).any():
            row = int(np.argmax(values <= 0))
            raise self._fail(row, name, "a standard deviation is positive: correct it or drop the column")
        if (values < _SMALLEST_SIGMA).any():
            row = int(np.argmin(values))
            raise self._fail(row, name, "no device reads as finely as that: correct it or drop the column")
        return values

    def _context(self, name: str) -> Array:
        """Return a context column; an empty cell means that it is not known for that row."""
        if name not in self.columns.named:
            return np.full(len(self.lines), np.nan)
        column = self.columns.named[name]
        cells = [cell.strip() for cell in self.cells[column.index]]
        known = np.flatnonzero([bool(cell) for cell in cells])
        values = np.full(len(cells), np.nan)
        if name == "branch":
            signs = {"up": 1.0, "loading": 1.0, "down": -1.0, "unloading": -1.0}
            for row in known:
                if cells[row].lower() not in signs:
                    raise self._fail(row, name, f"{_shown(cells[row])!r} is no branch: write up or down")
                values[row] = signs[cells[row].lower()]
            return values
        values[known] = self._numbers(name, known)
        if column.unit == "K":
            values -= KELVIN
        if name == "temperature" and (values < -KELVIN).any():
            cold = int(np.argmax(values < -KELVIN))
            raise self._fail(
                cold,
                name,
                f"{_shown(cells[cold])} {column.unit} is below absolute zero: correct the value or the unit",
            )
        return values
