"""The elastic robot as a mechanism: where its virtual joints stand once they have moved, many states at once.

Finite motions throughout. Order of the V = 7n+6 virtual joints, base to tip: the six of link 0, joint 1, the
six of link 1, joint 2, …; a link's six are three translations along its elastic axes, then three turns, each
about the axis that the turns before it have left it with. Nothing here is shared with the linear model of
the package.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.arrays import Array, Mask
from symstiff.robot import Robot

_CYCLES = {"x": (0, 1, 2), "y": (1, 2, 0), "z": (2, 0, 1)}


@dataclass(frozen=True)
class Chain:
    """Numbers of a robot: standard DH rows, elastic axes (columns, in DH frame i), points in frame n."""

    robot: Robot
    base: Array  # (4, 4)
    theta: Array
    d: Array
    a: Array
    alpha: Array
    prismatic: Mask
    elastic: Array  # (n+1, 3, 3)
    tool: Array  # (3,) tool centre point in frame n
    attitude: Array  # (3, 3) the tool's, in frame n

    @property
    def dof(self) -> int:
        """Number of joints n."""
        return len(self.d)

    @property
    def size(self) -> int:
        """Number of virtual joints V."""
        return 7 * self.dof + 6

    @property
    def translational(self) -> Mask:
        """(V,): whether the virtual joint's coordinate is a length."""
        kinds = np.zeros(self.size, dtype=bool)
        for link in range(self.dof + 1):
            kinds[7 * link : 7 * link + 3] = True
        for joint in range(1, self.dof + 1):
            kinds[7 * joint - 1] = self.prismatic[joint - 1]
        return kinds

    def point(self, name: str) -> Array:
        """Return a marker's position in frame n [m]."""
        return np.array([float(x) for x in self.robot.marker_position(name)])


def joint_index(joint: int) -> int:
    """Index of the virtual joint in actuated joint 1…n."""
    return 7 * joint - 1


def link_slice(link: int) -> slice:
    """Indices of the six virtual joints of link 0…n."""
    return slice(7 * link, 7 * link + 6)


def chain_of(robot: Robot) -> Chain:
    """Read a robot's numbers; a modified DH table is regrouped into standard rows first."""
    base = _placement(robot.base)
    rows = np.array([[float(j.theta), float(j.d), float(j.a), float(j.alpha)] for j in robot.joint])
    if robot.convention == "modified":
        # Row i of a modified table turns and shifts along x before its joint: that part ends link i-1.
        first = np.eye(4)
        first[:3, :3] = _turn(0, rows[0, 3])
        first[0, 3] = rows[0, 2]
        base = base @ first
        rows[:, 2:] = np.vstack([rows[1:, 2:], [[0.0, 0.0]]])
    named = [link.beam_axis or nearest for link, nearest in zip(robot.links, _beams(rows), strict=True)]
    return Chain(
        robot=robot,
        base=base,
        theta=rows[:, 0],
        d=rows[:, 1],
        a=rows[:, 2],
        alpha=rows[:, 3],
        prismatic=np.array([j.prismatic for j in robot.joint]),
        elastic=np.array([_elastic_axes(axis) for axis in named]),
        tool=_placement(robot.tool)[:3, 3],
        attitude=_placement(robot.tool)[:3, :3],
    )


def _placement(placement: Any) -> Array:
    roll, pitch, yaw = (float(x) for x in placement.rpy)
    matrix = np.eye(4)
    matrix[:3, :3] = _turn(2, yaw) @ _turn(1, pitch) @ _turn(0, roll)
    matrix[:3, 3] = [float(x) for x in placement.xyz]
    return matrix


def _turn(axis: int, angle: float) -> Array:
    u, v = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[u, u] = matrix[v, v] = np.cos(angle)
    matrix[v, u] = np.sin(angle)
    matrix[u, v] = -matrix[v, u]
    return matrix


def _beams(rows: Array) -> list[str]:
    """The axis of DH frame i that is nearest to the way from frame i−1 to it; x for the pedestal and for no way."""
    names = ["x"]
    for _, d, a, alpha in rows:
        way = np.abs(_turn(0, alpha).T @ [a, 0.0, d])
        names.append("xyz"[int(np.argmax(way > (1.0 - 1e-9) * way.max()))])
    return names


def _elastic_axes(beam_axis: Any) -> Array:
    """Columns: the beam's axis and the two across it, in the DH frame."""
    if isinstance(beam_axis, str):
        return np.eye(3)[:, list(_CYCLES[beam_axis])]
    along = np.array([float(x) for x in beam_axis])
    along /= np.linalg.norm(along)
    across = np.array([-along[1], along[0], 0.0])  # frame z × along
    across = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(across) < 1e-9 else across / np.linalg.norm(across)
    return np.column_stack([along, across, np.cross(along, across)])


@dataclass(frozen=True)
class Posture:
    """N deflected states of a chain, world axes.

    ``axis``, ``origin`` (N, V, 3) of every virtual joint where it stands now; ``before`` and ``after``:
    rotation (N, n+1, 3, 3) and origin (N, n+1, 3) of DH frame i ahead of and behind link i's virtual springs.
    """

    axis: Array
    origin: Array
    before: tuple[Array, Array]
    after: tuple[Array, Array]

    def at(self, points: Array) -> Array:
        """World positions (N, 3) of points (N, 3) or (3,) given in frame n."""
        rotation, position = self.after
        return np.asarray(
            position[:, -1]
            + np.einsum("nij,nj->ni", rotation[:, -1], np.broadcast_to(points, (len(position), 3)))
        )


def posture(chain: Chain, q: Array, theta: Array) -> Posture:
    """Place every virtual joint for joint variables ``q`` (N, n) and virtual coordinates ``theta`` (N, V)."""
    rows, links = len(q), chain.dof + 1
    axis, origin = np.empty((rows, chain.size, 3)), np.empty((rows, chain.size, 3))
    before = np.empty((rows, links, 3, 3)), np.empty((rows, links, 3))
    after = np.empty((rows, links, 3, 3)), np.empty((rows, links, 3))
    rotation = np.array(np.broadcast_to(chain.base[:3, :3], (rows, 3, 3)))
    position = np.array(np.broadcast_to(chain.base[:3, 3], (rows, 3)))
    for link in range(links):
        if link:
            v = joint_index(link)
            axis[:, v], origin[:, v] = rotation[:, :, 2], position
            rotation, position = _dh(chain, link - 1, rotation, position, q[:, link - 1] + theta[:, v])
        before[0][:, link], before[1][:, link] = rotation, position
        rotation, position = _springs(chain, link, rotation, position, theta, axis, origin)
        after[0][:, link], after[1][:, link] = rotation, position
    return Posture(axis, origin, before, after)


def _dh(chain: Chain, row: int, rotation: Array, position: Array, variable: Array) -> tuple[Array, Array]:
    angle = np.full(len(variable), chain.theta[row])
    length = np.full(len(variable), chain.d[row])
    if chain.prismatic[row]:
        length = length + variable
    else:
        angle = angle + variable
    rotation = _turned(rotation, 2, angle)
    position = position + length[:, None] * rotation[:, :, 2] + chain.a[row] * rotation[:, :, 0]
    return rotation @ _turn(0, float(chain.alpha[row])), position


def _springs(
    chain: Chain, link: int, rotation: Array, position: Array, theta: Array, axis: Array, origin: Array
) -> tuple[Array, Array]:
    first = 7 * link
    frame = rotation @ chain.elastic[link]
    for k in range(3):
        axis[:, first + k], origin[:, first + k] = frame[:, :, k], position
    position = position + np.einsum("nij,nj->ni", frame, theta[:, first : first + 3])
    for k in range(3):
        axis[:, first + 3 + k], origin[:, first + 3 + k] = frame[:, :, k], position
        frame = _turned(frame, k, theta[:, first + 3 + k])
    return frame @ chain.elastic[link].T, position


def _turned(rotation: Array, axis: int, angle: Array) -> Array:
    """Turn frames (N, 3, 3) about their own axis."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    result = rotation.copy()
    result[:, :, u] = c * rotation[:, :, u] + s * rotation[:, :, v]
    result[:, :, v] = c * rotation[:, :, v] - s * rotation[:, :, u]
    return result
