"""Arms that are far from their drawing: equations about the drawn arm start from the one that the data show."""

from __future__ import annotations

import numpy as np
import pytest
from definition import pose as defined_pose
from definition import twist

from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import Truth, clean_response, nominal_truth
from symstiff.calibration.simulation.truth import Effect
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import Robot, load
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.numeric import kinematics

NOISE = 2e-5
FORCE = {"ur10": 60.0, "kuka_kr270": 1500.0}


def positions(name: str, effects: tuple[Effect, ...], seed: int = 1, poses: int = 40) -> Measurements:
    """Positions of an arm with compliant joints, each pose with and without a load."""
    robot, rng = load(name), np.random.default_rng(seed)
    q = np.repeat([[rng.uniform(*j.range) for j in robot.joint] for _ in range(poses)], 2, axis=0)
    w = np.kron(rng.normal(size=(poses, 6)) * [1, 1, 1, 0, 0, 0], [[0.0], [FORCE[name]]])
    read = clean_response(Truth(robot, gears(robot), effects), q, w, {"kind": "absolute"})
    read[:, :3] += NOISE * rng.normal(size=(len(q), 3))
    read[:, 3:] = np.nan
    sigma = np.where(np.isfinite(read), NOISE, np.nan)
    where = np.repeat(np.arange(poses), 2)
    units = ["rad"] * robot.dof
    return measurements(q, w, values=read, sigma=sigma, pose=where, kind="absolute", joint_units=units)


def gears(robot: Robot) -> dict[str, float]:
    """Compliances of the joints; rigid links."""
    return {n: v if n.startswith("c") else 0.0 for n, v in nominal_truth(robot).items()}


def offset(joint: int, angle: float) -> Effect:
    return Effect("joint_offset", {"joint": joint}, "constant", {"offset": angle})


@pytest.mark.parametrize("name", ["planar2r", "scara", "kuka_kr270"])
def test_a_chain_whose_virtual_joints_stand_off_is_the_product_of_its_matrices(name: str) -> None:
    robot, rng = load(name), np.random.default_rng(4)
    q = rng.uniform(-1, 1, (2, robot.dof))
    joints = ElasticChain(robot).virtual_joints
    theta = 0.03 * rng.normal(size=(2, len(joints)))
    found = kinematics(robot, q).moved(theta)
    place = [(v.kind, v.body, v.axis if v.kind == "link" else 0) for v in joints]
    step = 1e-20  # complex steps: no cancellation
    for row, angles, J, T in zip(q, theta, found.J_theta, found.T, strict=True):
        at = dict(zip(place, angles.tolist(), strict=True))
        there = np.array(defined_pose(robot, row.tolist(), at), dtype=complex).real
        assert pytest.approx(there, abs=1e-12) == T
        for k, key in enumerate(place):
            moved = np.array(
                defined_pose(robot, row.tolist(), at | {key: at[key] + step * 1j}), dtype=complex
            )
            assert J[:, k] == pytest.approx(twist(moved.imag / step, there), abs=1e-12)


def test_compliances_of_an_arm_that_nobody_calibrated() -> None:
    """Frames two millimetres and two milliradians off: linear equations about the drawing leave 0.03 mm."""
    robot, rng = load("ur10"), np.random.default_rng(9)
    effects = tuple(
        Effect("geometric_error", {"link": i}, "constant", {"shift": (2e-3 * rng.normal(size=6)).tolist()})
        for i in range(1, robot.dof + 1)
    )
    found = identify(robot, positions("ur10", effects, poses=60), "joints")
    assert found.training.after["positional"].rms < 1.1 * NOISE * np.sqrt(3)
    truth = gears(robot)
    for name in ("c1", "c2", "c3"):
        assert (
            abs(found.model.values[name] - truth[name]) < 4 * found.model.deviations[name] < 0.1 * truth[name]
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "offsets"),
    [("kuka_kr270", {2: 0.04}), ("kuka_kr270", {2: 0.02, 5: -0.015}), ("ur10", {3: 0.03})],
)
def test_joints_whose_zeros_are_degrees_off_are_named(name: str, offsets: dict[int, float]) -> None:
    table = positions(name, tuple(offset(j, angle) for j, angle in offsets.items()))
    found = diagnose(Task(load(name), table, "joints"))
    assert found.verdict == "named"
    assert {(e.effect, e.where["joint"]) for e in found.named} == {("joint_offset", j) for j in offsets}
    for j, angle in offsets.items():
        assert found.model.values[f"joint_offset_{j}_offset"] == pytest.approx(angle, abs=2e-5)
    assert found.rms.after < 1.2 * NOISE
