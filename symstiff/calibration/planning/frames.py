"""Where the frames of a robot stand, for keep-out regions, markers and plots: one recursion, two backends.

The same code runs on NumPy arrays (N configurations at once) and on CasADi symbols, because it uses nothing
but ``+ - *`` and the sine and cosine it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.robot import Robot, elementary_chain

Motions = tuple[tuple[str, float], ...]
_AXIS = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class Geometry:
    """A robot's chain in floating point: world to frame 0, the DH rows, frame n to the tool centre point.

    ``rows`` holds (prismatic, theta, d, a, alpha) in rad and m; ``limits`` bounds the joint variables.
    """

    name: str
    base: Motions
    rows: tuple[tuple[bool, float, float, float, float], ...]
    tool: Motions
    limits: tuple[tuple[float, float], ...]

    @property
    def dof(self) -> int:
        """Number of joints n."""
        return len(self.rows)


@dataclass(frozen=True)
class Frames:
    """Frames 0 to n and the tool centre point: ``rotations[k][row][column]`` and ``origins[k][axis]``.

    Each entry is a scalar of the backend: an array (N,) or a symbol. The last frame is the tool's.
    """

    rotations: tuple[Any, ...]
    origins: tuple[Any, ...]


def geometry(robot: Robot) -> Geometry:
    """Return the floating-point chain of a robot, whatever DH convention its file uses."""
    chain = elementary_chain(robot)
    return Geometry(
        name=robot.name,
        base=tuple((str(m.kind), float(m.value)) for m in chain.base),
        rows=tuple((r.prismatic, float(r.theta), float(r.d), float(r.a), float(r.alpha)) for r in chain.rows),
        tool=tuple((str(m.kind), float(m.value)) for m in chain.tool),
        limits=tuple((low, high) for low, high in robot.ranges.tolist()),
    )


def frames(
    robot: Geometry, q: Sequence[Any], cos: Callable[[Any], Any] = np.cos, sin: Callable[[Any], Any] = np.sin
) -> Frames:
    """Return every frame for joint variables ``q`` (n scalars of the backend: arrays (N,), or symbols)."""
    zero = 0.0 * q[0]
    rotation = [[zero + (1.0 if r == c else 0.0) for c in range(3)] for r in range(3)]
    origin = [zero, zero, zero]
    state = _move(rotation, origin, robot.base, cos, sin)
    reached = [state]
    for (prismatic, theta, d, a, alpha), joint in zip(robot.rows, q, strict=True):
        turn, lift = (theta, d + joint) if prismatic else (theta + joint, d)
        state = _move(*state, (("rz", turn), ("tz", lift), ("tx", a), ("rx", alpha)), cos, sin)
        reached.append(state)
    reached.append(_move(*state, robot.tool, cos, sin))
    return Frames(tuple(r for r, _ in reached), tuple(o for _, o in reached))


def origins(robot: Geometry, q: np.ndarray) -> np.ndarray:
    """Return the origins of frames 0 to n and the tool centre point, (N, n+2, 3) in base axes [m]."""
    found = frames(robot, list(np.asarray(q, dtype=float).T))
    return np.stack([np.stack(o, axis=-1) for o in found.origins], axis=1)


def flange_rotation(robot: Geometry, q: np.ndarray) -> np.ndarray:
    """Return the rotation of frame n, (N, 3, 3), from its axes to base axes."""
    rotation = frames(robot, list(np.asarray(q, dtype=float).T)).rotations[robot.dof]
    return np.stack([np.stack(row, axis=-1) for row in rotation], axis=1)


def _move(
    rotation: Any,
    origin: Any,
    motions: Sequence[tuple[str, Any]],
    cos: Callable[[Any], Any],
    sin: Callable[[Any], Any],
) -> tuple[Any, Any]:
    for kind, value in motions:
        axis = _AXIS[kind[1]]
        if isinstance(value, float) and value == 0.0:
            continue
        if kind[0] == "t":
            origin = [o + value * row[axis] for o, row in zip(origin, rotation, strict=True)]
        else:
            rotation = _turn(rotation, (axis + 1) % 3, (axis + 2) % 3, cos(value), sin(value))
    return rotation, origin


def _turn(rotation: Any, first: int, second: int, c: Any, s: Any) -> Any:
    turned = []
    for row in rotation:
        new = list(row)
        new[first] = c * row[first] + s * row[second]
        new[second] = c * row[second] - s * row[first]
        turned.append(new)
    return turned
