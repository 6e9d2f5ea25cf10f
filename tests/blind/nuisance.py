"""What no table tells: noise that differs by axis and distance, and how the robot misses its poses."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from symstiff.calibration.measurements import Measurements
from symstiff.calibration.simulation import Device, Noise, Truth, clean_response
from symstiff.robot import Robot

APPROACH = (0.0, 0.3, 0.3, 1.0, 3.0)
"""Error that the rows of a pose share, of every axis, in units of sigma."""
JOINTS = (0.0, 0.0, 0.0, 1.0, 3.0)
"""The same as of joints that stand elsewhere, root mean square at the tool."""
_STEP = 1e-5


def drawn(robot: Robot, table: Measurements, rng: np.random.Generator) -> Noise:
    """The noise of a case."""
    sigma = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
    x, y, z = (float(v) for v in sigma * np.exp(0.12 * rng.normal(size=3)))
    shared, joints = float(rng.choice(APPROACH)), float(rng.choice(JOINTS))
    angle = 0.0
    if joints:
        per_unit = np.sqrt(np.mean(np.sum(readings_of_joints(robot, table) ** 2, axis=2)))
        angle = joints * sigma / float(per_unit)  # mm over m/rad: mrad
    return Noise(
        (x, y, z), growth_ppm=float(rng.uniform(0, 80 * sigma)), approach_mm=(shared * sigma,) * 3,
        approach_mrad=angle, quantum_mm=0.001,
    )  # fmt: skip


def readings_of_joints(robot: Robot, table: Measurements) -> np.ndarray:
    """(rows, 3, n) change of a reading for each joint that stands elsewhere, by differences of rigid positions."""
    truth = Truth(robot, {}, ())
    placed = {"kind": "absolute", "points": table.points, "point": table.point}
    turn = np.eye(3) if table.kind == "absolute" else Rotation.from_euler("xyz", Device().rpy).as_matrix()
    columns = []
    for joint in range(robot.dof):
        ends = []
        for side in (1.0, -1.0):
            q = table.q.copy()
            q[:, joint] += side * _STEP
            ends.append(clean_response(truth, q, 0.0 * table.w, placed)[:, :3] @ turn.T)
        columns.append((ends[0] - ends[1]) / (2.0 * _STEP))
    return np.stack(columns, axis=2)


class Whitener:
    """Rows (rows, 3, …) in units of the noise, what the rows of a pose share included."""

    def __init__(self, robot: Robot, table: Measurements, noise: Noise, spread: np.ndarray) -> None:
        """``spread`` (rows, 3): each row's own standard deviation [m]."""
        self._spread = spread
        axes = np.broadcast_to(np.diag(1e-3 * np.array(noise.approach_mm)), (len(spread), 3, 3))
        shared = axes
        if noise.approach_mrad:
            shared = np.concatenate(
                [axes, 1e-3 * noise.approach_mrad * readings_of_joints(robot, table)], axis=2
            )
        shared = shared / spread[:, :, None]
        self._blocks = []
        for pose in np.unique(table.pose):
            rows = np.flatnonzero(table.pose == pose)
            U, s, _ = np.linalg.svd(shared[rows].reshape(3 * len(rows), -1), full_matrices=False)
            self._blocks.append((rows, U, 1.0 - 1.0 / np.sqrt(1.0 + s**2)))

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Whitened rows of the same shape."""
        z = rows / self._spread.reshape(-1, 3, *(1,) * (rows.ndim - 2))
        for hit, U, shrink in self._blocks:
            block = z[hit].reshape(3 * len(hit), -1)
            z[hit] = (block - U @ (shrink[:, None] * (U.T @ block))).reshape(z[hit].shape)
        return np.asarray(z)
