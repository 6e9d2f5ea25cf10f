"""The elastic chain by its definition: a product of 4 × 4 matrices with virtual joints, differentiated.

Nothing of the package but the robot's data: each DH convention by its textbook formula, the six springs of
a link at the end of its rigid body, a spring in every joint. Works on numbers of any kind that ``alg`` has
sine and cosine of.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from symstiff.robot import Robot

Springs = dict[tuple[str, int, int], Any]  # ("link", body, axis 1…6) or ("joint", number, 0)
Build = Callable[[str, Any], np.ndarray]


def places(robot: Robot) -> list[tuple[str, int, int]]:
    """All virtual joints, base to tip."""
    found = [("link", 0, a) for a in range(1, 7)]
    for i in range(1, robot.dof + 1):
        found += [("joint", i, 0), *(("link", i, a) for a in range(1, 7))]
    return found


def motion(kind: str, value: Any, alg: Any = cmath) -> np.ndarray:
    """The 4 × 4 matrix of one elementary motion: tx … rz."""
    frame = np.eye(4, dtype=object)
    k = "xyz".index(kind[1])
    if kind[0] == "t":
        frame[k, 3] = value
        return frame
    c, s, (i, j) = alg.cos(value), alg.sin(value), ((k + 1) % 3, (k + 2) % 3)
    frame[i, i], frame[j, j], frame[i, j], frame[j, i] = c, c, -s, s
    return frame


def elastic_frame(axis: Any, number: Callable[[Any], Any], root: Callable[[Any], Any]) -> np.ndarray:
    """Columns e1, e2, e3 of a link's elastic frame in its DH frame."""
    if isinstance(axis, str):
        first = "xyz".index(axis)
        return np.array([[int(r == (first + c) % 3) for c in range(3)] for r in range(3)], dtype=object)
    b = np.array([number(v) for v in axis], dtype=object)
    e1 = b / root(b @ b)
    side = np.array([-e1[1], e1[0], 0], dtype=object)
    e2 = side / root(side @ side) if side[0] != 0 or side[1] != 0 else np.array([1, 0, 0], dtype=object)
    e3 = np.array([e1[k - 2] * e2[k - 1] - e1[k - 1] * e2[k - 2] for k in range(3)], dtype=object)
    return np.stack([e1, e2, e3], axis=1)


def factors(
    robot: Robot,
    q: Sequence[Any],
    springs: Springs,
    alg: Any = cmath,
    number: Callable[[Any], Any] = float,
    root: Callable[[Any], Any] = np.sqrt,
) -> Iterator[np.ndarray]:
    """The matrices whose product is the tool's pose in world axes."""

    def turn(kind: str, value: Any) -> np.ndarray:
        return motion(kind, value, alg)

    def placed(placement: Any) -> Iterator[np.ndarray]:
        (x, y, z), (roll, pitch, yaw) = ([number(v) for v in t] for t in (placement.xyz, placement.rpy))
        yield from (turn("tx", x), turn("ty", y), turn("tz", z))
        yield from (turn("rz", yaw), turn("ry", pitch), turn("rx", roll))

    def give(body: int) -> Iterator[np.ndarray]:
        mine = {axis: v for (kind, i, axis), v in springs.items() if kind == "link" and i == body}
        if mine:
            E = np.eye(4, dtype=object)
            E[:3, :3] = elastic_frame(robot.links[body].beam_axis or "x", number, root)
            kinds = ("tx", "ty", "tz", "rx", "ry", "rz")
            yield E
            yield from (turn(kinds[axis - 1], value) for axis, value in sorted(mine.items()))
            yield E.T

    def screw_z(i: int) -> Iterator[np.ndarray]:
        joint = robot.joint[i - 1]
        variable = q[i - 1] + springs.get(("joint", i, 0), 0)
        theta, d = number(joint.theta), number(joint.d)
        yield turn("rz", theta if joint.prismatic else theta + variable)
        yield turn("tz", d + variable if joint.prismatic else d)

    def screw_x(i: int) -> Iterator[np.ndarray]:
        yield from (turn("tx", number(robot.joint[i - 1].a)), turn("rx", number(robot.joint[i - 1].alpha)))

    modified, n = robot.convention == "modified", robot.dof
    yield from placed(robot.base)
    if modified:  # rotation and translation along the same axis commute
        yield from screw_x(1)
    yield from give(0)
    for i in range(1, n + 1):
        yield from screw_z(i)
        if not modified:
            yield from screw_x(i)
        elif i < n:
            yield from screw_x(i + 1)
        yield from give(i)
    yield from placed(robot.tool)


def pose(robot: Robot, q: Sequence[Any], springs: Springs | None = None, **numbers: Any) -> np.ndarray:
    """The tool's pose, 4 × 4."""
    product = np.eye(4, dtype=object)
    for factor in factors(robot, q, springs or {}, **numbers):
        product = product @ factor
    return product


def twist(change: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(6,) translation and rotation in world axes of a pose's derivative."""
    skew = change[:3, :3] @ at[:3, :3].T
    return np.array([*change[:3, 3], skew[2, 1], skew[0, 2], skew[1, 0]])


def poses(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(N, 4, 4) poses of the tool at joint variables (N, n)."""
    return _stacked(pose(robot, list(q.T.astype(complex)), alg=np), len(q)).real


def jacobians(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(N, 6, V) J_θ by complex steps: the pose's derivative along every virtual joint, to rounding."""
    step, variables, R = 1e-40, list(q.T.astype(complex)), poses(robot, q)[:, :3, :3]
    columns = []
    for place in places(robot):
        change = _stacked(pose(robot, variables, {place: step * 1j}, alg=np), len(q)).imag / step
        skew = change[:, :3, :3] @ R.transpose(0, 2, 1)
        turn = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
        columns.append(np.hstack([change[:, :3, 3], turn]))
    return np.stack(columns, axis=2)


def _stacked(matrix: np.ndarray, n: int) -> np.ndarray:
    """(n, 4, 4) from a 4 × 4 of numbers and arrays (n,)."""
    return np.array([[np.broadcast_to(x, n) for x in row] for row in matrix]).transpose(2, 0, 1)


def jacobian(robot: Robot, q: Sequence[float]) -> np.ndarray:
    """(6, V) J_θ at one configuration."""
    return np.asarray(jacobians(robot, np.atleast_2d(np.asarray(q, float)))[0])


def observation(robot: Robot, q: np.ndarray, w: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """(6·N, P) observation matrix of compliances by name, k_ab with its mirror, pose by pose."""
    where = {place: k for k, place in enumerate(places(robot))}
    J = jacobians(robot, q)
    tau, A = np.einsum("nrv,nr->nv", J, w), np.empty((len(q), 6, len(names)))
    for p, name in enumerate(names):
        if name[0] == "c":
            k = where["joint", int(name[1:]), 0]
            A[:, :, p] = J[:, :, k] * tau[:, [k]]
        else:
            body, ab = name[1:].split("_")
            r, c = (where["link", int(body), int(axis)] for axis in ab)
            A[:, :, p] = J[:, :, r] * tau[:, [c]] + (J[:, :, c] * tau[:, [r]] if r != c else 0.0)
    return A.reshape(6 * len(q), -1)


def samples(robot: Robot, n: int, seed: int, loads: str = "wrench") -> tuple[np.ndarray, np.ndarray]:
    """(n, dof) joint variables anywhere, (n, 6) wrenches of a class."""
    rng = np.random.default_rng(seed)
    w = rng.normal(size=(n, 6))
    w[:, {"wrench": 6, "force": 3, "gravity": 3}[loads] :] = 0.0
    if loads == "gravity":
        w[:, :2] = 0.0
    return rng.uniform(-3.0, 3.0, (n, robot.dof)), w
