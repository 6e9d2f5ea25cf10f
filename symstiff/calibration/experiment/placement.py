"""Where the measuring device stands: six numbers a station, which are always estimated from absolute data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.arrays import Array, Index
from symstiff.calibration.experiment.arm import Arm, turns_between
from symstiff.calibration.experiment.situation import View
from symstiff.calibration.tables.measurements import Measurements
from symstiff.errors import UserError

_NO_TURN = 1e-4
"""Angle [rad] below which a turn's Jacobian is that of none, to its square."""


def placed(view: View, arm: Arm) -> tuple[View, Array]:
    """The view in the device's axes, and what its rows read beyond the rigid robot of the file (M,).

    Deflections are read in base axes and come back as they are. For absolute data the device's placement is
    the rotation and shift that bring the arm's points closest to the measured ones (Kabsch), of each station.
    """
    table = view.table
    if table.kind != "absolute":
        return view, np.array(table.values[view.state, view.component])
    complete = table.measured[:, :3].all(axis=1)
    if complete.sum() < 3:
        raise UserError(
            f"absolute positions need x, y and z together in at least three rows, {int(complete.sum())} found: "
            "without them nobody knows where the measuring device stands"
        )
    turn, shift = stations(arm.points, table)
    view, excess = replace(view, turn=turn, shift=shift), np.zeros((len(table), 6))
    excess[:, :3] = table.values[:, :3] - view.points - view.in_device(arm.beyond[:, :3])
    if table.measured[:, 3:].any():
        excess[:, 3:] = _attitudes(view) - view.in_device(arm.beyond[:, 3:])
    return view, np.array(excess[view.state, view.component])


def stations(points: Array, table: Measurements) -> tuple[Array, Array]:
    """Rotations (N, 3, 3) and shifts (N, 3) that bring points (N, 3) closest to the measured ones, one a station."""
    station, complete = table.station, table.measured[:, :3].all(axis=1)
    found = [
        closest(points[own], table.values[own, :3])
        for own in (complete & (station == k) for k in range(station.max(initial=0) + 1))
    ]
    turns, shifts = (np.array(each) for each in zip(*found, strict=True))
    return turns[station], shifts[station]


def closest(points: Array, seen: Array) -> tuple[Array, Array]:
    """Rotation and shift with seen ≈ turn·point + shift, least squares."""
    if not len(points):
        return np.eye(3), np.zeros(3)
    a, b = points.mean(axis=0), seen.mean(axis=0)
    U, _, Vt = np.linalg.svd((points - a).T @ (seen - b))
    sign = np.sign(np.linalg.det(Vt.T @ U.T)) or 1.0
    turn = Vt.T @ np.diag([1.0, 1.0, sign]) @ U.T
    return turn, b - turn @ a


def _attitudes(view: View) -> Array:
    """Rotation vectors (N, 3) from the rigid robot's tool attitude to the measured one, device axes."""
    from scipy.spatial.transform import Rotation

    values = np.nan_to_num(view.table.values[:, 3:])
    return turns_between(view.turn @ view.found.T[:, :3, :3], Rotation.from_rotvec(values).as_matrix())


def turns_of(vectors: Array) -> Array:
    """(N, 3, 3) small turns by small changes of rotation vectors (N, 3): the left Jacobian of SO(3)."""
    angle = np.linalg.norm(vectors, axis=1)
    size = np.where(angle > _NO_TURN, angle, 1.0)
    far = angle > _NO_TURN
    first = np.where(far, (1.0 - np.cos(size)) / size**2, 0.5)
    second = np.where(far, (size - np.sin(size)) / size**3, 1.0 / 6.0)
    cross = np.cross(vectors[:, None, :], np.eye(3)).transpose(0, 2, 1)
    return np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross)


def placement_columns(view: View, probe: bool = False) -> Array:
    """(M, 6 a station) small shifts and turns of the device about the arm of the file; none for deflections.

    Three more of shifts on the last link where the ``probe`` was not told but found, as its place holds a part of every
    error that was not known then.
    """
    if view.table.kind != "absolute":
        return np.zeros((len(view.state), 0))
    moved = motions(view.points, view.table.station)
    if probe:
        axes = view.turn @ view.found.R[:, -1]
        moved = np.concatenate([moved, np.concatenate([axes, np.zeros_like(axes)], axis=1)], axis=2)
    return moved[view.state, view.component]


def motions(points: Array, station: Index) -> Array:
    """(N, 6, 6 a station) twists of points (N, 3) by small shifts and turns, of each station (N,) about its middle."""
    found = []
    for k in range(station.max(initial=0) + 1):
        there = station == k
        twist = np.tile(np.eye(6), (len(points), 1, 1))
        levers = points - points[there].mean(axis=0)
        twist[:, :3, 3:] = np.cross(np.eye(3), levers[:, None]).transpose(0, 2, 1)
        found.append(twist * there[:, None, None])
    return np.concatenate(found, axis=2)


def best_placed(view: View, y: Array) -> Array:
    """(M,) what rows read beyond the rigid robot where that is placed as well as it can be."""
    columns = placement_columns(view)
    return np.asarray(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) if columns.size else y
