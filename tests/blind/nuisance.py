"""What no table tells: noise that differs by axis and distance, how the robot misses its poses, what its arm weighs."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from symstiff.calibration.simulation import Device, Noise, Truth, clean_response
from symstiff.calibration.simulation.chain import joint_index, posture
from symstiff.calibration.simulation.equilibrium import States, loads
from symstiff.calibration.simulation.experiment import prepare
from symstiff.calibration.tables.measurements import Measurements
from symstiff.robot import Robot

APPROACH = (0.0, 0.3, 0.3, 1.0, 3.0)
"""Error that the rows of a pose share, of every axis, in units of sigma."""
JOINTS = (0.0, 0.0, 0.0, 1.0, 3.0)
"""The same as of joints that stand elsewhere, root mean square at the tool."""
UNLOADED = (0.0, 0.35, 1.0)
"""The same as of each point's reading without load: one of several repeats, or as good as any other."""
MILD = 0.35
"""The largest of these where a robot repeats well."""
HEAVY = (2.0, 5.0)
"""What an arm weighs, over the force that it is made for."""
_STEP = 1e-5


def drawn(robot: Robot, table: Measurements, rng: np.random.Generator, mild: bool = False) -> Noise:
    """The noise of a case; ``mild`` where the robot repeats to a third of it."""
    sigma = float(np.exp(rng.uniform(np.log(0.01), np.log(0.1))))
    x, y, z = (float(v) for v in sigma * np.exp(0.12 * rng.normal(size=3)))
    approach, stands, unloaded = (
        [x for x in of if x <= MILD or not mild] for of in (APPROACH, JOINTS, UNLOADED)
    )
    shared, joints = float(rng.choice(approach)), float(rng.choice(stands))
    angle = 0.0
    if joints:
        per_unit = np.sqrt(np.mean(np.sum(readings_of_joints(robot, table) ** 2, axis=2)))
        angle = joints * sigma / float(per_unit)  # mm over m/rad: mrad
    before = float(rng.choice(unloaded)) if table.kind == "deflection" else 0.0
    return Noise(
        (x, y, z), growth_ppm=float(rng.uniform(0, 80 * sigma)), approach_mm=(shared * sigma,) * 3,
        approach_mrad=angle, unloaded_mm=(before * sigma,) * 3, quantum_mm=0.001,
    )  # fmt: skip


def settling(robot: Robot, table: Measurements, size: float, rng: np.random.Generator) -> tuple[float, ...]:
    """Errors [mrad, of slides mm] of one joint at every reading, root mean square at the tool of ``size`` [mm]."""
    joint = int(rng.integers(robot.dof))
    per_unit = float(np.sqrt(np.mean(readings_of_joints(robot, table)[:, :, joint] ** 2)))
    return tuple(size / max(per_unit, 1e-3) * (j == joint) for j in range(robot.dof))


def _cases(table: Measurements) -> np.ndarray:
    """(rows,) number of a reading within its pose."""
    first = np.searchsorted(table.pose, table.pose)
    return (np.arange(len(table)) - first) // len(table.points)


def weighing(robot: Robot, force: float, rng: np.random.Generator) -> Robot:
    """The robot with weights [kg] on its links that its file does not tell: near the frames, less towards the tool."""
    share = np.arange(robot.dof, 0, -1) * np.exp(0.5 * rng.normal(size=robot.dof))
    mass = float(rng.uniform(*HEAVY)) * force / 9.81 * share / share.sum()
    centre = 0.02 * robot.reach * rng.normal(size=(robot.dof, 3))
    heavy = [{"mass": float(m), "com": tuple(map(float, c))} for m, c in zip(mass, centre, strict=True)]
    joints = (
        j.model_copy(update={"link": j.link.model_copy(update=own)})
        for j, own in zip(robot.joint, heavy, strict=True)
    )
    return robot.model_copy(update={"joint": tuple(joints)})


def torques_of_weights(body: Robot, table: Measurements) -> np.ndarray:
    """(n,) largest load of the links' weights on each joint in the table's poses."""
    mechanism = prepare(Truth(body, {}, ())).mechanism
    none = np.zeros(len(table))
    states = States(table.q, 0.0 * table.w, none, none, none, none)
    rigid = posture(mechanism.chain, table.q, np.zeros((len(table), mechanism.chain.size)))
    found = np.abs(loads(mechanism, states, rigid)).max(axis=0)
    return np.asarray(found[[joint_index(j) for j in range(1, body.dof + 1)]])


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
        shared = [axes]
        if noise.approach_mrad:
            shared.append(1e-3 * noise.approach_mrad * readings_of_joints(robot, table))
        if any(noise.settling_mrad):
            moved = 1e-3 * readings_of_joints(robot, table) * np.array(noise.settling_mrad)
            case = _cases(table)
            shared += [moved * (case == k)[:, None, None] for k in np.unique(case)]
        if any(noise.unloaded_mm):
            own = np.diag(1e-3 * np.array(noise.unloaded_mm))
            shared += [own * (table.point == k)[:, None, None] for k in range(len(table.points))]
        shared = np.concatenate(shared, axis=2) / spread[:, :, None]
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
