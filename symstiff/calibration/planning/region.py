"""Where a pose may be: reach, keep-out boxes and half-spaces, for the tool and every moving DH frame."""

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
    """A box in base axes [m] that no frame's origin may enter."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([self.low, self.high])) or not all(
            a < b for a, b in zip(self.low, self.high, strict=True)
        ):
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
    """What the tool centre point and the origins of DH frames 1 to n must keep.

    ``reach`` bounds the distance of the tool centre point from the origin of frame 0 [m]. Links between two
    origins are not checked: choose boxes with the links' thickness in mind.
    """

    boxes: tuple[Box, ...] = ()
    half_spaces: tuple[HalfSpace, ...] = ()
    reach: tuple[float, float] | None = None

    def __post_init__(self) -> None:
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
    for box in region.boxes:
        faces = np.concatenate([np.array(box.low) - moving, moving - np.array(box.high)], axis=2)
        margins.append(faces.max(axis=2).min(axis=1))
    for side in region.half_spaces:
        normal = np.array(side.normal) / np.linalg.norm(side.normal)
        margins.append((moving @ normal - side.offset / np.linalg.norm(side.normal)).min(axis=1))
    if region.reach is not None:
        distance = np.linalg.norm(points[:, -1] - points[:, 0], axis=1)
        margins += [distance - region.reach[0], region.reach[1] - distance]
    return np.asarray(np.min(margins, axis=0))


def allowed(region: Region, robot: Geometry, q: np.ndarray) -> np.ndarray:
    """Return which configurations (N, n) keep the region, (N,) booleans."""
    return np.asarray(clearance(region, robot, q) >= -_TOUCH)


def planes_around(region: Region, robot: Geometry, q: np.ndarray) -> np.ndarray:
    """Return linear constraints that keep a configuration (n,) on its side, (n+1, boxes + half-spaces, 4).

    Entry (a, b, c, d) demands a·x + b·y + c·z ≥ d of one moving origin. A box is replaced by its face that
    separates best at ``q``: stricter than the box, smooth, and true at ``q``.
    """
    moving = origins(robot, np.atleast_2d(q))[0, 1:]
    planes = np.zeros((len(moving), len(region.boxes) + len(region.half_spaces), 4))
    for k, box in enumerate(region.boxes):
        faces = np.concatenate([np.array(box.low) - moving, moving - np.array(box.high)], axis=1)
        for point, face in enumerate(faces.argmax(axis=1)):
            axis, upper = face % 3, face >= 3
            planes[point, k, axis] = 1.0 if upper else -1.0
            planes[point, k, 3] = box.high[axis] if upper else -box.low[axis]
    for k, side in enumerate(region.half_spaces, start=len(region.boxes)):
        length = float(np.linalg.norm(side.normal))
        planes[:, k] = np.array([*side.normal, side.offset]) / length
    return planes


def constraint_values(region: Region, points: Sequence[Any], planes: Any) -> list[Any]:
    """Return expressions that must be ≥ 0, from the origins of frames 0 to n and the tool (symbols).

    ``planes`` is the flattened result of ``planes_around``; reach is constrained by its square.
    """
    values = []
    per_point = len(region.boxes) + len(region.half_spaces)
    for index, (x, y, z) in enumerate(points[1:]):
        for k in range(per_point):
            a, b, c, d = (planes[4 * (index * per_point + k) + e] for e in range(4))
            values.append(a * x + b * y + c * z - d)
    if region.reach is not None:
        squared = sum((t - o) * (t - o) for t, o in zip(points[-1], points[0], strict=True))
        values += [squared - region.reach[0] ** 2, region.reach[1] ** 2 - squared]
    return values
