"""What callers pass to make and evaluate a model: joints, wrenches, the moment that laws look at, points, ranges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from symstiff.arguments import reals, require
from symstiff.errors import UserError, printable
from symstiff.robot.frozen import FrozenDict
from symstiff.robot.schema import Robot
from symstiff.symbolic.algebras import context_columns
from symstiff.symbolic.program import Program
from symstiff.symbolic.terms import WRENCH

Context = Mapping[str, npt.ArrayLike]
"""Columns (N,) or numbers by name: ``time`` [s], ``temperature`` [°C], ``branch``, ``turn``."""
SIZES = {"branch": ("<=", 1.0), "turn": (">=", 1.0)}
"""What the size of a context's number is where laws know it: beyond, a loop would be wider than it was measured."""
_ROUNDED = 1e-9


def rows(name: str, given: npt.ArrayLike, width: int) -> np.ndarray:
    """An array (N, width); one row may come without its outer brackets. Raises UserError."""
    array = np.atleast_2d(reals(given, name, f"(N, {width})"))
    if array.ndim != 2 or array.shape[1] != width:
        raise UserError(f"{name}: expected an array of shape (N, {width}), found {np.shape(given)}")
    return array


def number_of_poses(arrays: Mapping[str, np.ndarray]) -> int:
    """How many poses arrays (N or 1, …) by name hold. Raises UserError where they differ."""
    counts = {len(a) for a in arrays.values()}
    if len(counts - {1}) > 1:
        found = " and ".join(f"{len(a)} in {name}" for name, a in arrays.items())
        raise UserError(f"{' and '.join(arrays)}: expected as many rows, or one, found {found}")
    return min(counts) if 0 in counts else max(counts)


def poses(q: npt.ArrayLike, w: npt.ArrayLike, dof: int) -> tuple[np.ndarray, np.ndarray]:
    """q (N, n) and W (N, 6) with as many rows. Raises UserError for other shapes and what is no finite number."""
    joints, wrenches = rows("q", q, dof), rows("w", w, 6)
    for name, array in (("q", joints), ("w", wrenches)):
        finite = np.isfinite(array).all(axis=1)
        if not finite.all():
            row = int(np.argmin(finite))
            raise UserError(f"{name}: row {row} holds what is no finite number: correct it")
    n = number_of_poses({"q": joints, "w": wrenches})
    return np.broadcast_to(joints, (n, dof)), np.broadcast_to(wrenches, (n, 6))


def moment(program: Program, context: Context | None, n: int) -> dict[str, np.ndarray]:
    """The columns of ``context`` (n, k) that a program needs; none where it needs none. Raises UserError."""
    for vector in program.inputs:
        if vector.name == "context":
            names = [s.name for s in vector.symbols]
            return {"context": np.stack([_column(context, n, name) for name in names], -1)}
    return {}


def _column(context: Context | None, n: int, name: str) -> np.ndarray:
    """A column (n,) that laws need. Raises UserError also for a size that they do not know, as generated code does."""
    column = context_columns(context, n, name)[name]
    compared, bound = SIZES.get(name, (">=", 0.0))
    beyond = np.abs(column) - bound if compared == "<=" else bound - np.abs(column)
    if (wrong := beyond > _ROUNDED).any():
        row = int(np.argmax(wrong))
        raise UserError(
            f"context: {name}: row {row} holds {column[row]:g}: its size is {compared} {bound:g} where the law was "
            "measured"
        )
    return column


def point(given: Sequence[float]) -> tuple[float, float, float]:
    """Three lengths [m]. Raises UserError."""
    found = reals(given, "file_tool", "(3,)")
    if found.shape != (3,) or not np.isfinite(found).all():
        raise UserError(f"file_tool: expected three lengths [m], found {given!r:.40}")
    x, y, z = found.tolist()
    return x, y, z


def ranges(seen: Mapping[str, tuple[float, float]], robot: Robot) -> FrozenDict[str, tuple[float, float]]:
    """Ranges by the names that a table has, read-only. Raises UserError."""
    require(seen, Mapping, "seen by name", "give a dictionary")
    names = (*(f"q{j}" for j in range(1, robot.dof + 1)), *WRENCH, "time", "temperature")
    found = {}
    for name, between in seen.items():
        if name not in names:
            known = f"{names[0]} to {names[robot.dof - 1]}, {', '.join(names[robot.dof :])}"
            raise UserError(f"seen: {printable(str(name), 40)}: no such name: there are {known}")
        ends = reals(between, f"seen: {name}", "(2,)").tolist()
        if np.shape(ends) != (2,) or not -np.inf < ends[0] <= ends[1] < np.inf:
            raise UserError(f"seen: {name}: expected the least and the greatest value, found {between!r:.40}")
        found[name] = (ends[0], ends[1])
    return FrozenDict(found)
