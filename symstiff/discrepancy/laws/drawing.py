"""A robot whose geometry is not that of its file: where positions are not measured, its deflections tell."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.experiment.situation import Situation, View
from symstiff.discrepancy.problem import DeviceLaw, Parameter
from symstiff.effects.base import at_lever

DRAWING = "robot file's"
_X, _Z = 0, 2
_USUAL = {"m": 0.02, "rad": 0.02}
"""What a file's rows are off by, where they are."""
_ROUNDING = 1e-9
"""Change of the deflections by a radian or a metre, as a share of them, that is none."""


def drawing_laws(situation: Situation) -> Iterator[DeviceLaw]:
    """Every DH parameter and marker of the file as it may be wrong: what more of it changes of the deflections."""
    view = situation.view
    seen = np.einsum("nrv,nv->nr", at_lever(situation.J, situation.offset), situation.theta)
    largest = float(np.linalg.norm(situation.rows(seen)))
    for joint, name, unit, frame, axis in _dh_parameters(view):
        first = 7 * frame + (6 if axis == _Z else 0)  # a link's springs turn with its frame
        column = _changed(situation, _twist(view, frame, axis, turns=unit == "rad"), first)
        if np.linalg.norm(column) > _ROUNDING * largest:
            title = f"correction of {name} of joint {joint}"
            size = Parameter(title, unit, typical=_USUAL[unit])
            yield DeviceLaw(f"{DRAWING} joint {joint}", title, (size,), column[:, None])
    for name, block in _markers(view, seen[:, 3:]):
        title = f"correction of marker {name}"
        parameters = tuple(Parameter(f"{title}: {axis}", "m") for axis in "xyz")
        columns = np.column_stack([situation.rows(twist) for twist in block])
        if np.linalg.norm(columns) > _ROUNDING * largest:
            yield DeviceLaw(f"{DRAWING} marker {name}", title, parameters, columns)


def _markers(view: View, turn: Array) -> Iterator[tuple[str, list[Array]]]:
    """Markers, and what a metre along each of the tool's axes changes (N, 6) where the tool turns by (N, 3)."""
    for number in np.unique(view.table.point):
        own = (view.table.point == number)[:, None]
        shifts = (np.cross(turn, view.found.R[:, -1, :, k]) for k in range(3))
        if view.table.points[number] != "tcp":
            yield view.table.points[number], [own * np.hstack([x, np.zeros_like(x)]) for x in shifts]


def _dh_parameters(view: View) -> Iterator[tuple[int, str, str, int, int]]:
    """Joint, parameter, unit, and the frame along or about whose axis all that is behind it moves."""
    before = 1 if view.robot.convention == "modified" else 0
    for j in range(1, view.table.dof + 1):
        yield j, "theta", "rad", j - 1, _Z
        yield j, "d", "m", j - 1, _Z
        yield j, "a", "m", j - before, _X
        yield j, "alpha", "rad", j - before, _X


def _twist(view: View, frame: int, axis: int, turns: bool) -> Array:
    """(N, 6) of the tool centre point for a unit along or about an axis at a frame's origin."""
    along = view.found.R[:, frame, :, axis]
    if not turns:
        return np.hstack([along, np.zeros_like(along)])
    return np.hstack([np.cross(along, view.found.rho[:, frame]), along])


def _moved(J: Array, twist: Array, first: int) -> Array:
    """Change (N, 6, V) of columns J (N, 6, V) of a point when all from column ``first`` on moves by a twist (N, 6)."""
    shift, turn = twist[:, :3, None], twist[:, 3:, None]
    change = np.empty_like(J)
    change[:, :3, :first] = np.cross(J[:, 3:, :first], shift, axis=1)
    change[:, 3:, :first] = 0.0
    change[:, :3, first:] = np.cross(turn, J[:, :3, first:], axis=1)
    change[:, 3:, first:] = np.cross(turn, J[:, 3:, first:], axis=1)
    return change


def _changed(situation: Situation, twist: Array, first: int) -> Array:
    """(M,) what a twist of all from a virtual joint on adds to the deflections that the model predicts."""
    J = situation.J
    load = np.einsum("nrv,nr->nv", _moved(J, twist, first), situation.wrench)
    point = at_lever(J, situation.offset)
    of_point = at_lever(twist[:, :, None], situation.offset)[:, :, 0]
    seen = np.einsum("nrv,nv->nr", _moved(point, of_point, first), situation.theta)
    return situation.rows(seen + np.einsum("nrv,nv->nr", point, situation.slope(load)))
