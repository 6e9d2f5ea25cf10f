"""Where the measuring device stands: six numbers that are always estimated from absolute data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.experiment.arm import Arm, turns_between
from symstiff.calibration.experiment.situation import View
from symstiff.errors import UserError

_NO_TURN = 1e-4
"""Angle [rad] below which a turn's Jacobian is that of none, to its square."""


def placed(view: View, arm: Arm) -> tuple[View, Array]:
    """The view in the device's axes, and what its rows read beyond the rigid robot of the file (M,).

    Deflections are read in base axes and come back as they are. For absolute data the device's placement is
    the rotation and shift that bring the arm's points closest to the measured ones (Kabsch).
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
    turn, shift = closest(arm.points[complete], table.values[complete, :3])
    view, excess = replace(view, turn=turn, shift=shift), np.zeros((len(table), 6))
    excess[:, :3] = table.values[:, :3] - view.points - arm.beyond[:, :3] @ turn.T
    if table.measured[:, 3:].any():
        excess[:, 3:] = _attitudes(view, turn) - arm.beyond[:, 3:] @ turn.T
    return view, np.array(excess[view.state, view.component])


def closest(points: Array, seen: Array) -> tuple[Array, Array]:
    """Rotation and shift with seen ≈ turn·point + shift, least squares."""
    if not len(points):
        return np.eye(3), np.zeros(3)
    a, b = points.mean(axis=0), seen.mean(axis=0)
    U, _, Vt = np.linalg.svd((points - a).T @ (seen - b))
    sign = np.sign(np.linalg.det(Vt.T @ U.T)) or 1.0
    turn = Vt.T @ np.diag([1.0, 1.0, sign]) @ U.T
    return turn, b - turn @ a


def _attitudes(view: View, turn: Array) -> Array:
    """Rotation vectors (N, 3) from the rigid robot's tool attitude to the measured one, device axes."""
    from scipy.spatial.transform import Rotation

    values = np.nan_to_num(view.table.values[:, 3:])
    return turns_between(turn @ view.found.T[:, :3, :3], Rotation.from_rotvec(values).as_matrix())


def turns_of(vectors: Array) -> Array:
    """(N, 3, 3) small turns by small changes of rotation vectors (N, 3): the left Jacobian of SO(3)."""
    angle = np.linalg.norm(vectors, axis=1)
    size = np.where(angle > _NO_TURN, angle, 1.0)
    far = angle > _NO_TURN
    first = np.where(far, (1.0 - np.cos(size)) / size**2, 0.5)
    second = np.where(far, (size - np.sin(size)) / size**3, 1.0 / 6.0)
    cross = np.cross(vectors[:, None, :], np.eye(3)).transpose(0, 2, 1)
    return np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross)


def placement_columns(view: View) -> Array:
    """(M, 6) small shifts and turns of the device about the arm of the file; none (M, 0) for deflections."""
    if view.table.kind != "absolute":
        return np.zeros((len(view.state), 0))
    points = view.points - view.points.mean(axis=0)
    twist = np.tile(np.eye(6), (len(points), 1, 1))
    twist[:, :3, 3:] = np.cross(np.eye(3), points[:, None]).transpose(0, 2, 1)
    return np.asarray(twist[view.state, view.component])


def best_placed(view: View, y: Array) -> Array:
    """(M,) what rows read beyond the rigid robot where that is placed as well as it can be."""
    columns = placement_columns(view)
    return np.asarray(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) if columns.size else y
