"""Slips of a whole table: would it fit far better otherwise?

Markers exchanged, a joint's sign or zero another one, two joints exchanged. How loads and deflections are told is
asked in ``misread``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.calibration.rows import equations
from symstiff.calibration.tables.measurements import Measurements
from symstiff.model import StiffnessModel

_EXCHANGED, _READ = 0.5, 0.3
"""Part of the squares left as told up to which other names of points, and other readings of joints, are spoken of."""
_SAME = 1.02
"""What is left by readings that are not told apart, over the least."""
_FEWEST = 20
"""Degrees of freedom below which a few readings' noise is made small by chance."""
_MOST = 4
"""Points of which every order is tried; of more, two at a time change their names."""
_ROWS, _POSES, _AT_MOST = 300, 12, 3000
"""Rows of which a slip of all of them is seen, of so many poses at least; rows at most."""

Squares = tuple[float, int]
"""Sum of squares that is left of a table, and degrees of freedom."""


def slip(
    model: StiffnessModel,
    table: Measurements,
    left: Callable[[StiffnessModel, Measurements], Squares],
) -> tuple[str, str]:
    """What looks exchanged or read in another way, and what to correct then; empty where nothing does.

    ``left`` tells what the model leaves of a table; of long ones some poses are looked at.
    """
    some = some_poses(table, _ROWS)
    hint = marker_hint(some.points, lambda names: left(model, replace(some, points=names)))
    if hint:
        return hint, "column point"
    turns = [not joint.prismatic for joint in model.robot.joint]
    hint = joint_hint(some.q, turns, lambda q: left(model, replace(some, q=q)))
    return hint, "order, signs and zeros of the table's joints, or the robot file" if hint else ""


def some_poses(table: Measurements, rows: int) -> Measurements:
    """Poses of a long table, evenly spread, with all of their readings, about so many rows; of very many some."""
    poses = list(dict.fromkeys(table.pose.tolist()))
    count = max(min(_POSES, len(poses)), int(len(poses) * min(rows / max(len(table), 1), 1.0)))
    chosen = np.array(poses)[np.unique(np.linspace(0, len(poses) - 1, count).astype(int))]
    own = np.flatnonzero(np.isin(table.pose, chosen))
    return table.select(own[np.unique(np.linspace(0, len(own) - 1, min(len(own), _AT_MOST)).astype(int))])


def left_by(model: StiffnessModel, table: Measurements) -> Squares:
    """Squares that the model, fitted to deflections, leaves of them [m², rad²], and degrees of freedom."""
    e = equations(model, table)
    columns, _ = unit_columns(e.A)
    fitted, _, rank, _ = np.linalg.lstsq(columns, e.y, rcond=1e-10)
    rest = e.y - columns @ fitted
    return float(rest @ rest), len(e.y) - int(rank)


def marker_hint(points: Sequence[str], left: Callable[[tuple[str, ...]], Squares]) -> str:
    """Which points look exchanged; empty if none do, or if too little is left to tell.

    ``left`` tells what is left where the points have other names, in their order.
    """
    told = tuple(points)
    if len(told) < 2:
        return ""
    now, freedom = left(told)
    if freedom < _FEWEST or now == 0.0:
        return ""
    found = {names: left(names)[0] for names in _orders(told)}
    best = min(found, key=lambda names: found[names])
    if found[best] > _EXCHANGED * now:
        return ""
    read = ", ".join(f"{a} as {b}" for a, b in zip(told, best, strict=True) if a != b)
    share = 100.0 * float(np.sqrt(found[best] / now))
    return f"markers look exchanged: to read {read} would leave {share:.0f} % of the residual"


def joint_hint(q: Array, turns: Sequence[bool], left: Callable[[Array], Squares]) -> str:
    """Which joint looks read the other way round or from another zero, or exchanged with another one.

    Empty if none does, or if too little is left.

    q: (M, n) as told; turns: (n,) whether a joint turns: of one that slides the zero is not asked for;
    ``left`` tells what is left where the joints stand elsewhere (M, n).
    """
    now, freedom = left(q)
    if freedom < _FEWEST or now == 0.0:
        return ""
    found = {reading: left(reading.of(q))[0] for reading in _readings(turns)}
    best = min(found, key=lambda reading: found[reading], default=None)
    if best is None or found[best] > _READ * now:
        return ""
    share = 100.0 * float(np.sqrt(found[best] / now))
    alike = " or ".join(r.words for r, square in found.items() if square <= _SAME * found[best])
    return f"a joint looks read in another way: {alike} would leave {share:.0f} % of the residual"


@dataclass(frozen=True)
class Reading:
    """Another reading of a joint (counted from one): sign·q + quarters·90°."""

    joint: int
    sign: int
    quarters: int

    def of(self, q: Array) -> Array:
        """(M, n) joint variables so read."""
        out = np.array(q)
        out[:, self.joint - 1] = self.sign * q[:, self.joint - 1] + self.quarters * np.pi / 2
        return out

    @property
    def words(self) -> str:
        """What is read for which column."""
        name = f"{'-' if self.sign < 0 else ''}q{self.joint}"
        turned = f" {('+ 90', '+ 180', '- 90')[self.quarters - 1]} deg" if self.quarters else ""
        return f"{name}{turned} for q{self.joint}"


@dataclass(frozen=True)
class Exchange:
    """Two joints (counted from one) whose columns are exchanged."""

    one: int
    other: int

    def of(self, q: Array) -> Array:
        """(M, n) joint variables so read."""
        out = np.array(q)
        out[:, [self.one - 1, self.other - 1]] = q[:, [self.other - 1, self.one - 1]]
        return out

    @property
    def words(self) -> str:
        """What is read for which columns."""
        return f"q{self.one} for q{self.other} and q{self.other} for q{self.one}"


def _orders(told: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Other orders of some names."""
    if len(told) <= _MOST:
        return [names for names in permutations(told) if names != told]
    out = []
    for a in range(len(told)):
        for b in range(a):
            names = list(told)
            names[a], names[b] = told[b], told[a]
            out.append(tuple(names))
    return out


def _readings(turns: Sequence[bool]) -> list[Reading | Exchange]:
    """Other readings of one joint at a time, those that change least first, and two of a kind exchanged."""
    joints = range(1, len(turns) + 1)
    exchanged = [Exchange(a, b) for a, b in combinations(joints, 2) if turns[a - 1] == turns[b - 1]]
    return exchanged + [
        Reading(j, sign, quarters)
        for sign, quarters in ((-1, 0), *((s, k) for s in (1, -1) for k in (1, 2, 3)))
        for j, turning in enumerate(turns, start=1)
        if turning or not quarters
    ]
