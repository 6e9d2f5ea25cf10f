"""A measurement table as arrays: one row per pose, load case and measured point; SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from symstiff.arguments import reals, words
from symstiff.arrays import TINY, Array, Index, Mask, numbered
from symstiff.errors import UserError

if TYPE_CHECKING:
    import pandas as pd

Kind = Literal["deflection", "absolute", "none"]

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
CONTEXT = ("time", "temperature", "load_step", "branch", "repeat")
_ROWS = ("pose", "q", "w", "point", "values", "sigma", *CONTEXT, "file", "line")
_STILL = 1e-9
"""Range [rad, m] up to which a joint never moves."""
_FLAT = 1e-2
"""How far [m] points have to spread beside their longest line for a file to tell where the device stood."""


def course(values: Array) -> Array:
    """How far values (M,) have come from the least (0) to the largest (1); zeros where they are all alike."""
    return np.asarray((values - values.min()) / max(float(np.ptp(values)), TINY))


@dataclass(frozen=True)
class Measurements:
    """M rows of a measurement table, a poses table or a trajectory (kind "none": nothing measured).

    Arrays with M rows: ``pose`` and ``point`` index ``labels`` and ``points``; ``q`` (M, n) in rad or m
    (``joint_units``); ``w`` (M, 6) in N and N·m, at the tool centre point, base axes; ``values`` (M, 6) in
    m and rad, NaN for components that were not measured; ``sigma`` (M, 6), NaN where unknown; the context
    ``time`` [s], ``temperature`` [degC], ``load_step``, ``branch`` (+1 up, -1 down) and ``repeat``, NaN where
    unknown; ``file`` and ``line``, where a row came from (line 0: from no file).
    """

    labels: tuple[str, ...]
    pose: Index
    q: Array
    w: Array
    points: tuple[str, ...]
    point: Index
    kind: Kind
    values: Array
    sigma: Array
    time: Array
    temperature: Array
    load_step: Array
    branch: Array
    repeat: Array
    joint_units: tuple[str, ...]
    files: tuple[str, ...] = ()
    file: Index = None  # type: ignore[assignment]
    line: Index = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        rows = len(self.q)
        for name in ("file", "line"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros(rows, dtype=np.intp))
        for name in _ROWS:
            array = getattr(self, name)
            if len(array) != rows:
                raise ValueError(f"{name} has {len(array)} rows, q has {rows}")
            if array.flags.writeable or array.base is not None:  # a view's owner may change it
                array = array.copy()
                array.setflags(write=False)
                object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        from symstiff.calibration.tables.reading import measurements_line

        return f"Measurements({measurements_line(self)})"

    def _repr_html_(self) -> str:
        from symstiff.calibration.tables.reading import measurements_html

        return measurements_html(self)

    def __len__(self) -> int:
        return len(self.q)

    @property
    def approach(self) -> Index:
        """(M,) number of the approach that a row belongs to: the rows of one pose and visit share one."""
        return numbered(self.pose, self.visit)

    @property
    def visit(self) -> Index:
        """(M,) which of the visits to its pose a row is of: each repeat is one, and each station of the device."""
        repeat, station = np.nan_to_num(self.repeat, nan=-1.0), self.station
        several = numbered(self.pose, station).max(initial=0) > numbered(self.pose).max(initial=0)
        return numbered(repeat, station) if several else numbered(repeat)

    @property
    def clock(self) -> Array:
        """(M,) when each row was measured: by time where all tell it [s], else in the order of the rows."""
        return self.time if np.isfinite(self.time).all() else np.arange(len(self), dtype=float)

    @property
    def session(self) -> Array:
        """(M,) how far the session has gone, from 0 to 1."""
        return course(self.clock)

    @property
    def station(self) -> Index:
        """(M,) where the measuring device stood, from 0 on: another place for every file of absolute positions.

        A file that does not tell it, of points on a line or without all three coordinates, has the first one.
        """
        station = np.zeros(len(self), dtype=np.intp)
        for number, k in enumerate(self.telling):
            station[self.file == k] = number
        return station

    @property
    def telling(self) -> list[int]:
        """Numbers of files of absolute positions that tell where the device stood, where there are several files."""
        if self.kind != "absolute" or len(self.files) < 2:
            return []
        return [int(k) for k in np.unique(self.file) if _spread_out(self.values[self.file == k, :3])]

    @property
    def dof(self) -> int:
        """Number of joint columns n."""
        return int(self.q.shape[1])

    @property
    def still(self) -> Mask:
        """(n,): which joints never move."""
        return np.asarray(np.ptp(self.q, axis=0) < _STILL)

    @property
    def standing(self) -> dict[int, float]:
        """Joints that never move, by number from one on, with their values [rad, m]."""
        return {i: float(self.q[0, i - 1]) for i, stands in enumerate(self.still, start=1) if stands}

    @property
    def measured(self) -> Mask:
        """(M, 6): which components of which rows were measured."""
        return np.isfinite(self.values)

    def select(self, rows: Any) -> Measurements:
        """Return the rows that an index array or a mask selects; labels and points stay as they are."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _ROWS})

    def place(self, row: int) -> str:
        """Say where a row came from, for messages: ``data.csv: line 7``."""
        if not self.files or self.line[row] == 0:
            return f"row {row + 1}"
        return f"{self.files[self.file[row]]}: line {self.line[row]}"

    def places(self, rows: Sequence[int], most: int) -> str:
        """Say where several rows came from, and how many more there are: ``data.csv: lines 7, 9 and 2 more``."""
        said: dict[str, list[str]] = {}
        for row in rows[:most]:
            kind, _, number = self.place(int(row)).rpartition(" ")
            said.setdefault(kind, []).append(number)
        told = (f"{kind}{'s' * (len(numbers) > 1)} {', '.join(numbers)}" for kind, numbers in said.items())
        return "; ".join(told) + f" and {len(rows) - most} more" * (len(rows) > most)

    def frame(self) -> pd.DataFrame:
        """Return the rows as a pandas DataFrame, in the units of the CSV file (rad, mm, N)."""
        import pandas as pd

        from symstiff.calibration.tables.writing import columns

        return pd.DataFrame(columns(self))


def measurements(
    q: Any,
    w: Any = None,
    *,
    labels: Sequence[str] | None = None,
    pose: Any = None,
    points: Sequence[str] = ("tcp",),
    point: Any = None,
    kind: Kind = "none",
    values: Any = None,
    sigma: Any = None,
    time: Any = None,
    temperature: Any = None,
    load_step: Any = None,
    branch: Any = None,
    repeat: Any = None,
    joint_units: Sequence[str] | None = None,
) -> Measurements:
    """Build a table from arrays; what is left out is unknown, zero load, the tool centre point.

    ``q`` is (M, n); without ``pose`` equal rows of ``q`` are one pose, labelled p1, p2, … in order of
    appearance; ``joint_units`` are "rad" where not given. ``w`` (M, 6) in N and N·m acts at the tool centre point, base
    axes; ``values`` and ``sigma`` (M, 6) are in m and rad, NaN for what was not measured, of a ``kind`` "deflection" or
    "absolute". ``pose`` and ``point`` (M,) count ``labels`` and ``points`` from 0. Of the others (M,)
    ``time`` is in s, ``temperature`` in °C, ``branch`` 1 on the way up and -1 down, ``load_step`` and ``repeat`` are
    numbers; NaN where unknown. Raises UserError for other shapes, kinds and numbers.
    """
    q = np.atleast_2d(reals(q, "q", "(M, n)"))
    if q.ndim != 2:
        raise UserError(f"q: expected an array of shape (M, n), found {q.shape}")
    if not isinstance(kind, str) or kind not in get_args(Kind):
        raise UserError(f"kind: expected {', '.join(get_args(Kind))}, found {kind!r:.40}")
    rows, dof = q.shape
    if pose is None:
        seen: dict[bytes, int] = {}
        pose = [seen.setdefault(row.tobytes(), len(seen)) for row in q + 0.0]
    points = words(points, "points", "['p1', 'p2']")
    point = _counted(0 if point is None else point, rows, "point", len(points))
    pose = _counted(pose, rows, "pose")
    if labels is None:
        labels = [f"p{k + 1}" for k in range(int(pose.max(initial=-1)) + 1)]
    labels = words(labels, "labels", "['p1', 'p2']")
    _counted(pose, rows, "pose", len(labels))
    units = ("rad",) * dof if joint_units is None else words(joint_units, "joint_units", "['rad', 'm']")
    if len(units) != dof or not set(units) <= {"rad", "m"}:
        raise UserError(
            f"joint_units: expected rad or m for each of {dof} joints, found {', '.join(units):.40}"
        )
    branch = _rows(branch, "branch", (rows,), np.nan)
    if np.any(other := ~np.isnan(branch) & (np.abs(branch) != 1.0)):
        raise UserError(f"branch: expected 1 (up), -1 (down) or NaN, found {branch[other][0]:g}")
    return Measurements(
        labels=labels,
        pose=pose,
        q=q,
        w=_rows(w, "w", (rows, 6), 0.0),
        points=points,
        point=point,
        kind=kind,
        values=_rows(values, "values", (rows, 6), np.nan),
        sigma=_rows(sigma, "sigma", (rows, 6), np.nan),
        joint_units=units,
        time=_rows(time, "time", (rows,), np.nan),
        temperature=_rows(temperature, "temperature", (rows,), np.nan),
        load_step=_rows(load_step, "load_step", (rows,), np.nan),
        branch=branch,
        repeat=_rows(repeat, "repeat", (rows,), np.nan),
    )


def concatenate(tables: Sequence[Measurements]) -> Measurements:
    """Put tables one after the other; a pose label or point name means the same in all of them.

    Raises UserError where they measure different things or have different joints.
    """
    first = tables[0]
    for table in tables[1:]:
        for what, a, b in (
            ("kind of data", first.kind, table.kind),
            ("joints", ", ".join(first.joint_units), ", ".join(table.joint_units)),
        ):
            if a != b:
                raise UserError(
                    f"{table.place(0)}: {what} {b!r} where the tables before it have {a!r}: "
                    f"use one kind of table at a time"
                )
    merged: dict[str, Any] = {f.name: getattr(first, f.name) for f in fields(Measurements)}
    for names, index in (("labels", "pose"), ("points", "point"), ("files", "file")):
        order: dict[str, int] = {}
        parts = []
        for table in tables:
            lookup = np.array(
                [order.setdefault(name, len(order)) for name in getattr(table, names)] or [0], dtype=np.intp
            )
            parts.append(lookup[getattr(table, index)])
        merged[names], merged[index] = tuple(order), np.concatenate(parts)
    for name in _ROWS:
        if name not in ("pose", "point", "file"):
            merged[name] = np.concatenate([getattr(table, name) for table in tables])
    return Measurements(**merged)


def _spread_out(points: Array) -> bool:
    """Whether points (N, 3), as far as they are known, span a plane."""
    known = points[np.isfinite(points).all(axis=1)]
    if len(known) < 3:
        return False
    extents = np.linalg.svd(known - known.mean(axis=0), compute_uv=False) / np.sqrt(len(known))
    return bool(extents[1] > _FLAT)


def _rows(given: Any, name: str, shape: tuple[int, ...], default: float) -> Array:
    """A column (M,) or (M, 6) of numbers; one row stands for all. Raises UserError."""
    array = np.asarray(default) if given is None else reals(given, name, str(shape))
    try:
        return np.array(np.broadcast_to(array, shape))
    except ValueError:
        raise UserError(f"{name}: expected an array of shape {shape}, found {array.shape}") from None


def _counted(given: Any, rows: int, name: str, count: int | None = None) -> Index:
    """Places (M,) in a list of ``count`` names, from 0 on. Raises UserError."""
    numbers = _rows(given, name, (rows,), 0.0)
    found = np.where(np.isfinite(numbers), numbers, -1.0).astype(np.intp)
    if (found != numbers).any() or found.min(initial=0) < 0:
        raise UserError(f"{name}: expected whole numbers from 0 on, the places of its names in their list")
    if count is not None and found.max(initial=-1) >= count:
        raise UserError(
            f"{name}: {found.max()} is beyond the {count} names that are given: they count from 0"
        )
    return found
