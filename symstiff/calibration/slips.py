"""Slips of a whole table: would it fit far better otherwise?

Markers exchanged, a joint's sign or zero another one, loads or deflections told in the tool's axes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.decomposition import unit_columns
from symstiff.calibration.measurements import Measurements
from symstiff.calibration.rows import equations
from symstiff.model import StiffnessModel
from symstiff.symbolic.numeric import forward

_EXCHANGED, _READ = 0.5, 0.3
"""Part of the squares left as told up to which other names of points, and other readings of joints, are spoken of."""
_SAME = 1.02
"""What is left by readings that are not told apart, over the least."""
_FEWEST = 20
"""Degrees of freedom below which a few readings' noise is made small by chance."""
_MOST = 4
"""Points of which every order is tried; of more, two at a time change their names."""
_ROWS = 3000
"""Rows of which a slip of all of them is seen."""

Squares = tuple[float, int]
"""Sum of squares that is left of a table, and degrees of freedom."""


def slip(
    model: StiffnessModel,
    table: Measurements,
    left: Callable[[StiffnessModel, Measurements], Squares],
) -> tuple[str, str]:
    """What looks exchanged or read in another way, and what to correct then; empty where nothing does.

    ``left`` tells what the model leaves of a table; of long ones some rows are looked at.
    """
    rows = np.unique(np.linspace(0, len(table) - 1, min(len(table), _ROWS)).astype(int))
    some = table.select(rows)
    hint = marker_hint(some.points, lambda names: left(model, replace(some, points=names)))
    if hint:
        return hint, "column point"
    turns = [not joint.prismatic for joint in model.robot.joint]
    hint = joint_hint(some.q, turns, lambda q: left(model, replace(some, q=q)))
    return hint, "signs and zeros of the table's joints, or the robot file" if hint else ""


def turned_slip(model: StiffnessModel, table: Measurements) -> tuple[str, str]:
    """The same for loads and deflections that may be told in the tool's axes; the model is one in which links give way.

    Rows that are not measured whole stay as they are.
    """
    rows = np.unique(np.linspace(0, len(table) - 1, min(len(table), _ROWS)).astype(int))
    some = table.select(rows)
    R = forward(model.robot, some.q)[:, :3, :3]
    now, freedom = left_by(model, some)
    if freedom < _FEWEST or now == 0.0:
        return "", ""
    loads, rows_turned = (
        np.einsum("nij,nkj->nki", R, x.reshape(-1, 2, 3)).reshape(-1, 6) for x in (some.w, some.values)
    )
    values = np.where(np.isnan(rows_turned), some.values, rows_turned)
    readings = {
        "the loads": replace(some, w=loads),
        "the deflections": replace(some, values=values),
        "loads and deflections": replace(some, w=loads, values=values),
    }
    found = {what: left_by(model, read)[0] for what, read in readings.items()}
    best = min(found, key=lambda what: found[what])
    if found[best] > _READ * now:
        return "", ""
    share = 100.0 * float(np.sqrt(found[best] / now))
    hint = f"{best} look told in the tool's axes: turned to the base's they would leave {share:.0f} % of the residual"
    return hint, f"table: its {best.removeprefix('the ')} are read in the base's axes"


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
    """Which joint looks read the other way round or from another zero; empty if none does, or if too little is left.

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
    alike = " or ".join(f"{r} for q{r.joint}" for r, square in found.items() if square <= _SAME * found[best])
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

    def __str__(self) -> str:
        name = f"{'-' if self.sign < 0 else ''}q{self.joint}"
        return name if not self.quarters else f"{name} {('+ 90', '+ 180', '- 90')[self.quarters - 1]} deg"


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


def _readings(turns: Sequence[bool]) -> list[Reading]:
    """Other readings of one joint at a time, those that change least first."""
    return [
        Reading(j, sign, quarters)
        for sign, quarters in ((-1, 0), *((s, k) for s in (1, -1) for k in (1, 2, 3)))
        for j, turning in enumerate(turns, start=1)
        if turning or not quarters
    ]
