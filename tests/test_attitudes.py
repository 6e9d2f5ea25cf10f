"""Attitudes in absolute data: rotation vectors, whose components' sigma is not that of a turn of the tool."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from symstiff.calibration.experiment.arm import drawn
from symstiff.calibration.experiment.placement import placed, turns_of
from symstiff.calibration.experiment.situation import Laws, look
from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import Device, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import measurements
from symstiff.robot import from_table, load
from symstiff.robot.exact import parse_exact
from symstiff.robot.table import to_table


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-6, 0.0, 2e-6), (0.4, -1.1, 0.3), (1.8, 2.2, -1.0)])
def test_a_small_change_of_a_rotation_vector_is_the_turn_that_is_told(vector: tuple[float, ...]) -> None:
    v, step = np.array(vector), 1e-6
    ends = [Rotation.from_rotvec(v + side * step * np.eye(3)) for side in (1.0, -1.0)]
    columns = ((ends[0] * ends[1].inv()).as_rotvec() / (2 * step)).T
    assert turns_of(v[None])[0] == pytest.approx(columns, abs=1e-7)


@pytest.mark.slow
def test_truthful_sigmas_of_attitudes_leave_a_variance_of_one() -> None:
    robot, found = load("ur10"), []
    low, high = np.array([j.range for j in robot.joint]).T
    for seed in range(6):
        rng = np.random.default_rng(seed)
        q = np.repeat(rng.uniform(np.maximum(low, -2.5), np.minimum(high, 2.5), (40, 6)), 2, axis=0)
        force = 80.0 * rng.normal(size=(40, 3)) / np.sqrt(3)
        w = np.array([np.r_[f * level, 0, 0, 0] for f in force for level in (0.0, 1.0)])
        design = measurements(
            q, w, pose=np.repeat(np.arange(40), 2), kind="absolute", joint_units=["rad"] * 6
        )
        truth = Truth(
            robot,
            nominal_truth(robot),
            (),
            Noise((0.02,) * 3, (0.02,) * 3),
            kind="absolute",
            components="pose",
        )
        found.append(identify(robot, simulate(truth, design, seed)).fit.s0_squared)
    assert np.mean(found) == pytest.approx(1.0, abs=0.06)


def test_attitudes_are_those_of_the_tool_however_it_is_turned() -> None:
    """Read of the tool's frame by a chain of matrices of our own, without noise: the model leaves nothing of it."""
    robot = load("ur10")
    entry = to_table(robot)
    entry["tool"] = {"xyz": [0.02, -0.05, 0.3], "rpy": [0.3, "pi/6", -0.4]}
    robot = from_table(entry, "ur10")
    rng = np.random.default_rng(3)
    q = rng.uniform(-2.0, 2.0, (30, 6))
    T = [np.eye(4)] * 30
    for k, row in enumerate(entry["joint"]):
        a, alpha, d = (float(parse_exact(row.get(name, 0))) for name in ("a", "alpha", "d"))
        theta = q[:, k] + float(parse_exact(row.get("theta", 0)))
        T = [
            t @ moved("z", x) @ shifted(0, 0, d) @ shifted(a, 0, 0) @ moved("x", alpha)
            for t, x in zip(T, theta, strict=True)
        ]
    turn = Rotation.from_euler("xyz", [0.3, np.pi / 6, -0.4]).as_matrix()
    tool = shifted(0.02, -0.05, 0.3)
    tool[:3, :3] = turn
    device = shifted(1.0, 2.0, 3.0)
    device[:3, :3] = Rotation.from_euler("xyz", [0.1, 0.2, 1.5]).as_matrix()
    seen = np.array([np.linalg.inv(device) @ t @ tool for t in T])
    values = np.hstack([seen[:, :3, 3], Rotation.from_matrix(seen[:, :3, :3]).as_rotvec()])
    table = measurements(
        q, np.zeros((30, 6)), pose=np.arange(30), kind="absolute", values=values, joint_units=["rad"] * 6
    )
    _, excess = placed(look(robot, table), drawn(look(robot, table), Laws(look(robot, table), (), {})))
    assert np.abs(excess).max() < 1e-9
    virtual = simulate(
        Truth(
            robot,
            {},
            (),
            Noise((0.0,) * 3),
            device=Device((1.0, 2.0, 3.0), (0.1, 0.2, 1.5)),
            kind="absolute",
            components="pose",
        ),
        table,
        0,
    )
    assert np.abs(virtual.values - values).max() < 1e-9


def moved(axis: str, angle: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler(axis, angle).as_matrix()
    return matrix


def shifted(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = [x, y, z]
    return matrix
