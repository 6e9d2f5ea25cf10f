"""The task that all competitors solve: a robot's numbers, its parameters by link and axes, and random inputs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from symstiff.reduction import reduce
from symstiff.reduction.physical import Parameter
from symstiff.robot import Robot, load
from symstiff.robot.chain import Elementary, elementary_chain

CYCLIC = {"x": (0, 1, 2), "y": (1, 2, 0), "z": (2, 0, 1)}
INPUTS = 256  # their joint variables and wrenches stay in the first-level cache


def snapped(x: float) -> float:
    """A number; 0, 1 and −1 exactly where rounding missed them, so that every engine may drop them."""
    nearest = round(x)
    return float(nearest) if abs(x - nearest) < 1e-15 else float(x)


def turned(axis: int, angle: float) -> np.ndarray:
    """Rotation matrix (3, 3) about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = snapped(np.cos(angle))
    matrix[j, i] = snapped(np.sin(angle))
    matrix[i, j] = -matrix[j, i]
    return matrix


def placed(motions: tuple[Elementary, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and position (3,) of a product of elementary motions."""
    rotation, position = np.eye(3), np.zeros(3)
    for motion in motions:
        axis = "xyz".index(motion.kind[1])
        if motion.kind[0] == "t":
            position = position + rotation[:, axis] * float(motion.value)
        else:
            rotation = rotation @ turned(axis, float(motion.value))
    return rotation, position


@dataclass(frozen=True)
class Row:
    """One joint: constant part of its angle, lengths and twist of its DH row, in floating point."""

    prismatic: bool
    theta: float
    d: float
    a: float
    cos_alpha: float
    sin_alpha: float


@dataclass(frozen=True)
class Entry:
    """One parameter: the compliance of ``body`` between springs ``row`` and ``column`` (1…6), or of a joint (0, 0)."""

    body: int
    row: int
    column: int


@dataclass(frozen=True)
class Case:
    """A robot, its full parameter set after M3, and the numbers that every competitor starts from."""

    robot: Robot
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, name: str) -> Case:
        """All parameters after M3: 56 for the KR 270."""
        robot = load(name)
        return cls(robot, reduce(robot).full)

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.robot.dof

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """DH rows, standard convention."""
        return tuple(
            Row(
                row.prismatic,
                float(row.theta),
                float(row.d),
                float(row.a),
                snapped(np.cos(float(row.alpha))),
                snapped(np.sin(float(row.alpha))),
            )
            for row in elementary_chain(self.robot).rows
        )

    @cached_property
    def base(self) -> tuple[np.ndarray, np.ndarray]:
        """Frame 0 in world axes."""
        return placed(elementary_chain(self.robot).base)

    @cached_property
    def tool(self) -> tuple[np.ndarray, np.ndarray]:
        """Tool centre point in frame n."""
        return placed(elementary_chain(self.robot).tool)

    @cached_property
    def entries(self) -> tuple[Entry, ...]:
        """The parameters, read from their names."""
        found = []
        for p in self.parameters:
            link = re.fullmatch(r"k(\d+)_(\d)(\d)", p.name)
            found.append(Entry(*map(int, link.groups())) if link else Entry(int(p.name[1:]), 0, 0))
        return tuple(found)

    def elastic_axes(self, body: int) -> np.ndarray:
        """Elastic axes of a link as columns (3, 3), in its DH frame."""
        axis = self.robot.links[body].beam_axis
        if axis is None:
            raise ValueError(f"link {body} states no beam axis: choose a robot that does")
        if isinstance(axis, str):
            return np.eye(3)[:, CYCLIC[axis]]
        first = np.array([float(x) for x in axis])
        first = first / np.linalg.norm(first)
        second = np.cross([0.0, 0.0, 1.0], first)
        second = second / np.linalg.norm(second) if np.linalg.norm(second) else np.array([1.0, 0.0, 0.0])
        columns = np.column_stack([first, second, np.cross(first, second)])
        return np.array([[snapped(x) for x in row] for row in columns])

    @cached_property
    def inputs(self) -> np.ndarray:
        """Random joint variables within their limits and wrenches (INPUTS, n + 6)."""
        rng = np.random.default_rng(20)
        ranges = np.array([j.range for j in self.robot.joint])
        q = rng.uniform(ranges[:, 0], ranges[:, 1], (INPUTS, self.dof))
        w = rng.uniform(-1000.0, 1000.0, (INPUTS, 6)) * [1, 1, 1, 0.2, 0.2, 0.2]
        return np.hstack([q, w])

    @cached_property
    def values(self) -> np.ndarray:
        """Compliances of plausible size (P,)."""
        sizes = [
            (1e-9, 1e-7, 1e-6)[(e.row > 3 or not e.row) + (e.column > 3 or not e.row)] for e in self.entries
        ]
        return np.random.default_rng(21).uniform(0.5, 1.5, len(sizes)) * sizes
