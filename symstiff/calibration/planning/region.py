"""Where a pose may be: reach, half-spaces, and keep-out boxes that the arm's straight links stay beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.calibration.planning.frames import Geometry, origins
from symstiff.errors import UserError

_TOUCH = 1e-9  # m; a point on a boundary is allowed


@dataclass(frozen=True)
class Box:
    """A box in base axes [m] that no line between the origins of neighbouring frames may enter."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([self.low, self.high])):
            raise UserError(f"keep-out box {self.low} to {self.high}: give finite numbers, in metres")
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise UserError(f"keep-out box {self.low} to {self.high}: give the lower corner first, in metres")


@dataclass(frozen=True)
class HalfSpace:
    """The allowed side of a plane in base axes: normal · p ≥ offset [m]."""

    normal: tuple[float, float, float]
    offset: float

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([*self.normal, self.offset])) or not any(self.normal):
            raise UserError(f"half-space with normal {self.normal}: a normal is a finite vector, not zero")


@dataclass(frozen=True)
class Region:
    """What the tool centre point, the origins of DH frames 1 to n and the lines between them must keep.

    ``reach`` bounds the distance of the tool centre point from the origin of frame 0 [m]. Links are lines here: choose
    boxes with their thickness in mind. ``margin`` is the share of its range that a joint that moves keeps from either
    limit.
    """

    boxes: tuple[Box, ...] = ()
    half_spaces: tuple[HalfSpace, ...] = ()
    reach: tuple[float, float] | None = None
    margin: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.margin < 0.5:
            raise UserError(f"margin {self.margin:g}: a share of a joint's range, from 0 to below a half")
        if self.reach is not None and not 0 <= self.reach[0] < self.reach[1]:
            raise UserError(f"reach {self.reach}: give the smallest and the largest distance, in metres")


def above_floor(height: float = 0.0) -> HalfSpace:
    """Return the half-space z ≥ height [m]."""
    return HalfSpace((0.0, 0.0, 1.0), height)


def clearance(region: Region, robot: Geometry, q: np.ndarray) -> np.ndarray:
    """Return how far every configuration keeps from the nearest boundary, (N,) [m]; negative: not allowed."""
    q = np.atleast_2d(np.asarray(q, dtype=float))
    points = origins(robot, q)
    moving = points[:, 1:]
    margins = [np.full(len(q), np.inf)]
    margins += [_separated(box, points)[1].max(axis=2).min(axis=1) for box in region.boxes]
    for side in region.half_spaces:
        normal = np.array(side.normal) / np.linalg.norm(side.normal)
        margins.append((moving @ normal - side.offset / np.linalg.norm(side.normal)).min(axis=1))
    if region.reach is not None:
        distance = np.linalg.norm(points[:, -1] - points[:, 0], axis=1)
        margins += [distance - region.reach[0], region.reach[1] - distance]
    return np.asarray(np.min(margins, axis=0))


def _separated(box: Box, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Planes that part each line between neighbouring points (N, P, 3) from a box.

    Unit normals (N, P-1, 6, 3), away from the box, and how far it is beyond the box along each (N, P-1, 6) [m].
    A line and a box that do not meet are parted along an axis of the box, or across one and the line.
    """
    low, high = np.array(box.low), np.array(box.high)
    ends = points - (low + high) / 2.0
    a, b = ends[:, :-1, None], ends[:, 1:, None]
    across = np.cross(np.eye(3), b - a)
    length = np.linalg.norm(across, axis=3, keepdims=True)
    along = np.broadcast_to(np.eye(3), across.shape)
    axes = np.concatenate(
        [along, np.where(length > _TOUCH, across / np.maximum(length, _TOUCH), along)], axis=2
    )
    first, last = np.sum(axes * a, axis=3), np.sum(axes * b, axis=3)
    side = np.where(first + last < 0, -1.0, 1.0)
    gaps = np.minimum(side * first, side * last) - np.abs(axes) @ ((high - low) / 2.0)
    return axes * side[..., None], gaps


def allowed(region: Region, robot: Geometry, q: np.ndarray) -> np.ndarray:
    """Return which configurations (N, n) keep the region, (N,) booleans."""
    return np.asarray(clearance(region, robot, q) >= -_TOUCH)


def planes_around(region: Region, robot: Geometry, q: np.ndarray) -> np.ndarray:
    """Return linear constraints that keep a configuration (n,) on its side, (n+1, 2·boxes + half-spaces, 4).

    Entry (a, b, c, d) demands a·x + b·y + c·z ≥ d of one moving origin. A box is replaced, for each of the two lines
    that meet there, by the plane that parts it from the line best at ``q``: stricter than the box, smooth, true there.
    """
    points = origins(robot, np.atleast_2d(q))
    lines = points.shape[1] - 1
    planes = np.zeros((lines, 2 * len(region.boxes) + len(region.half_spaces), 4))
    for k, box in enumerate(region.boxes):
        low, high = np.array(box.low), np.array(box.high)
        normals, gaps = (found[0] for found in _separated(box, points))
        for line, best in enumerate(gaps.argmax(axis=1)):
            normal = normals[line, best]
            plane = np.append(normal, normal @ (low + high) / 2.0 + np.abs(normal) @ (high - low) / 2.0)
            planes[line, 2 * k] = plane
            planes[max(line - 1, 0), 2 * k + 1] = plane
        planes[-1, 2 * k + 1] = planes[-1, 2 * k]  # one line ends at the tool
    for k, side in enumerate(region.half_spaces, start=2 * len(region.boxes)):
        length = float(np.linalg.norm(side.normal))
        planes[:, k] = np.array([*side.normal, side.offset]) / length
    return planes


def constraint_values(region: Region, points: Sequence[Any], planes: Any) -> list[Any]:
    """Return expressions that must be ≥ 0, from the origins of frames 0 to n and the tool (symbols).

    ``planes`` is the flattened result of ``planes_around``; reach is constrained by its square.
    """
    values = []
    per_point = 2 * len(region.boxes) + len(region.half_spaces)
    for index, (x, y, z) in enumerate(points[1:]):
        for k in range(per_point):
            a, b, c, d = (planes[4 * (index * per_point + k) + e] for e in range(4))
            values.append(a * x + b * y + c * z - d)
    if region.reach is not None:
        squared = sum((t - o) * (t - o) for t, o in zip(points[-1], points[0], strict=True))
        values += [squared - region.reach[0] ** 2, region.reach[1] ** 2 - squared]
    return values
