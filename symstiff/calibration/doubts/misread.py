"""Loads and deflections told in other axes than the base's, or with other signs: throughout, or from some pose on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from symstiff.arrays import TINY, Array
from symstiff.calibration.doubts.axes import WORTH_A_WORD, AxisHint
from symstiff.calibration.doubts.slips import some_poses
from symstiff.calibration.experiment.placement import closest
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.calibration.rows import equations
from symstiff.calibration.tables.measurements import COMPONENTS, Measurements
from symstiff.model import StiffnessModel
from symstiff.reduction.svd import svd
from symstiff.symbolic.numeric import forward
from symstiff.symbolic.terms import WRENCH

_THROUGHOUT, _PARTLY = 0.3, 0.15
"""Part of the squares left as told up to which another reading of all poses, and of those from one on, is spoken of."""
_LESS = 0.5
"""Part of what something else leaves that is clearly less."""
_SAME = 1.02
"""What is left by readings that are not told apart, over the least."""
_ROWS = 900
"""Rows that are looked at, about."""
_FEWEST, _EACH = 20, 2
"""Degrees of freedom, and poses before and from a change on, at least."""
_RIDGE, _ROUNDING = 1e-10, 1e-10
"""Square of a direction of unit columns that is nothing; singular value, against the largest, that is rounding."""
_TURNED, _ROUNDS = 0.1, 40
"""Angle [rad] from which a measured frame is no small one out, and rounds in which it is found."""
_DEFLECTIONS = tuple(f"d{c}" for c in COMPONENTS)
_AXES = "xyz"


@dataclass(frozen=True, eq=False)
class _Reading:
    """Another reading of a table: what is told in another way, how it is to be read, and the table so read."""

    what: str
    how: str
    table: Measurements


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations of every pose (P): A'A (P, n, n), A'y (P, n), y'y (P,)."""

    matrix: Array
    right: Array
    squares: Array

    def left(self) -> Array:
        """(P,) squares that the best values leave of each sum."""
        n = self.right.shape[1]
        size = np.maximum(np.trace(self.matrix, axis1=1, axis2=2) / n, TINY)
        held = self.matrix + _RIDGE * size[:, None, None] * np.eye(n)
        best = np.linalg.solve(held, self.right[:, :, None])[:, :, 0]
        return np.asarray(np.maximum(self.squares - np.einsum("pn,pn->p", self.right, best), 0.0))

    def from_each(self, other: _Normal) -> _Normal:
        """The sums of these equations before every pose and of others from it on."""

        def joined(own: Array, others: Array) -> Array:
            before = np.cumsum(own, axis=0) - own
            return before + np.cumsum(others[::-1], axis=0)[::-1]

        return _Normal(
            joined(self.matrix, other.matrix),
            joined(self.right, other.right),
            joined(self.squares, other.squares),
        )


def misread(model: StiffnessModel, table: Measurements, swapped: AxisHint | None) -> tuple[str, str]:
    """How loads or deflections look told, and what to correct then; empty where they look as they are to be.

    The model is one in which links give way, so that it explains deflections whichever way their axes are; of long
    tables some poses are looked at. ``swapped``: other axes of all deflections, which stand where nothing leaves less.
    """
    found = _other(model, table, np.inf if swapped is None else swapped.best)
    if found[0] or swapped is None:
        return found
    return str(swapped), "table, or the signs of its loads"


def _other(model: StiffnessModel, table: Measurements, otherwise: float) -> tuple[str, str]:
    """The other reading that leaves clearly less than this share of the squares, if there is one."""
    some = some_poses(table, _ROWS)
    e = equations(model, some)
    scale, order = unit_columns(e.A)[1], list(dict.fromkeys(some.pose.tolist()))
    told = _normal(model, some, order, scale)
    now = float(told.from_each(told).left()[0])
    share = now / max(float(e.y @ e.y), TINY)
    if len(e.y) - len(scale) < _FEWEST or share < WORTH_A_WORD:
        return "", ""
    found = []
    for reading in _readings(model, some):
        left = told.from_each(_normal(model, reading.table, order, scale)).left() / max(now, TINY)
        left[1:_EACH] = left[max(len(left) - _EACH + 1, 1) :] = np.inf
        found.append((reading, left))
    least = min(float(left.min()) for _, left in found)
    if share * least > _LESS * otherwise:
        return "", ""
    for reading, left in sorted(found, key=lambda f: f[1][0] > _SAME * least):
        k = 0 if left[0] <= _SAME * least else int(np.argmin(left))
        if left[k] <= (_PARTLY if k else _THROUGHOUT) and left[k] <= _SAME * least:
            return _words(reading, f" from pose {some.labels[order[k]]} on" if k else "", float(left[k]))
    return "", ""


def _words(reading: _Reading, since: str, part: float) -> tuple[str, str]:
    """The hint, and what to correct."""
    share = 100.0 * float(np.sqrt(part))
    hint = f"{reading.what} look told in another way{since}: {reading.how} would leave {share:.0f} % of the residual"
    return hint, f"table: its {reading.what.removeprefix('the ')} are read in the base's axes"


def _normal(model: StiffnessModel, table: Measurements, order: list[int], scale: Array) -> _Normal:
    """The normal equations of the poses in their order."""
    e = equations(model, table)
    A, pose = e.A / scale, table.pose[e.row]
    rows = [np.flatnonzero(pose == p) for p in order]
    return _Normal(
        np.stack([A[r].T @ A[r] for r in rows]),
        np.stack([A[r].T @ e.y[r] for r in rows]),
        np.array([float(e.y[r] @ e.y[r]) for r in rows]),
    )


def _readings(model: StiffnessModel, table: Measurements) -> Iterator[_Reading]:
    """Other readings, those that people write most first."""
    R = forward(model.robot, table.q)[:, :3, :3]
    loads, rows = _turned(R, table.w), _turned(R, table.values)
    how = "turning them from the tool's axes to the base's"
    yield _Reading("the loads", how, replace(table, w=loads))
    yield _Reading("the deflections", how, replace(table, values=rows))
    yield _Reading("loads and deflections", how, replace(table, w=loads, values=rows))
    for how, read in _changed(table.w, WRENCH):
        yield _Reading("the loads", how, replace(table, w=read))
    for how, read in _changed(table.values, _DEFLECTIONS):
        yield _Reading("the deflections", how, replace(table, values=read))
    turn = _turn(model, table)
    vector = np.zeros(3) if turn is None else Rotation.from_matrix(turn).as_rotvec()
    angle = float(np.linalg.norm(vector))
    if turn is not None and angle > _TURNED:
        axis = ", ".join(f"{x + 0.0:.2f}" for x in vector / angle)
        rows = _turned(turn[None].repeat(len(table), 0), table.values)
        how = f"turning them by {np.degrees(angle):.1f} deg about ({axis})"
        yield _Reading("the deflections", how, replace(table, values=rows))


def _turned(R: Array, rows: Array) -> Array:
    """Vectors (M, 6) turned by R (M, 3, 3); those that are not measured whole stay as they are."""
    turned = np.einsum("nij,nkj->nki", R, rows.reshape(-1, 2, 3)).reshape(-1, 6)
    return np.where(np.isnan(turned), rows, turned)


def _changed(rows: Array, names: tuple[str, ...]) -> Iterator[tuple[str, Array]]:
    """Vectors (M, 6) with a sign or all changed, two axes exchanged, or turned by a quarter."""
    there = np.any(np.nan_to_num(rows) != 0, axis=0)
    yield "all signs changed", -rows
    for k in np.flatnonzero(there):
        sign = np.ones(6)
        sign[k] = -1.0
        yield f"the other sign of {names[k]}", rows * sign
    for a, b in ((0, 1), (1, 2), (2, 0)):  # a quarter turn about the third axis leads from a to b
        order = np.arange(6)
        order[[a, b, a + 3, b + 3]] = [b, a, b + 3, a + 3]
        yield "{} and {} exchanged".format(*sorted((_AXES[a], _AXES[b]))), rows[:, order]
        for quarter, first in ((90, a), (-90, b)):
            sign = np.ones(6)
            sign[[first, first + 3]] = -1.0
            yield f"turning them by {quarter} deg about {_AXES[3 - a - b]}", rows[:, order] * sign


def _turn(model: StiffnessModel, table: Measurements) -> Array | None:
    """(3, 3) by which measured translations are to be turned so that the model fits them best; None where there are
    none.
    """
    some = table.select(np.all(table.measured[:, :3], axis=1))
    if not len(some):
        return None
    e = equations(model, some)
    Q, s, _ = svd(unit_columns(e.A[e.component < 3])[0])
    Q = Q[:, s > _ROUNDING * s[0]]
    measured, turn = some.values[:, :3], np.eye(3)
    for _ in range(_ROUNDS):
        fitted = (Q @ (Q.T @ (measured @ turn.T).ravel())).reshape(-1, 3)
        both = (
            np.vstack([rows, -rows]) for rows in (measured, fitted)
        )  # about the origin: nothing is shifted
        turn = closest(*both)[0]
    return turn
