"""Absolute positions of a robot whose links have weight: the model that is written holds for loads at the tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.current import settled
from symstiff.calibration.identify import identify
from symstiff.calibration.measurements import measurements
from symstiff.calibration.simulation import Truth, clean_response, nominal_truth
from symstiff.discrepancy.finding import Task
from symstiff.discrepancy.growth import fit
from symstiff.discrepancy.scan import column_space
from symstiff.discrepancy.workflow import run
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.robot import Robot, load

SIGMA = 2e-5


def heavy() -> Robot:
    robot = load("ur10")
    assert any(joint.link.mass for joint in robot.joint)
    return robot


def experiment(robot: Robot, seed: int, kind: str, noise: float) -> tuple[Truth, object]:
    rng = np.random.default_rng(seed)
    poses, levels = 30, (0.0, 0.5, 1.0)
    q = np.array([[rng.uniform(*j.range) for j in robot.joint] for _ in range(poses)])
    force = rng.normal(size=(poses, 6)) * [60, 60, 60, 0, 0, 0]
    w = np.concatenate([f * s for f in force for s in levels]).reshape(-1, 6)
    values = {n: v * float(np.exp(0.3 * rng.normal())) for n, v in nominal_truth(robot).items()}
    truth, q = Truth(robot, values, ()), np.repeat(q, 3, axis=0)
    read = clean_response(truth, q, w, {"kind": kind})
    read[:, :3] += noise * rng.normal(size=(len(q), 3))
    read[:, 3:] += 2 * noise * rng.normal(size=(len(q), 3))
    sigma = np.hstack([np.full((len(q), 3), SIGMA), np.full((len(q), 3), 2 * SIGMA)])
    table = measurements(
        q,
        w,
        values=read,
        sigma=sigma,
        pose=np.repeat(np.arange(poses), 3),
        kind=kind,
        joint_units=["rad"] * 6,
    )
    return truth, table


@pytest.mark.parametrize("way", ["diagnosis", "identification"])
def test_the_values_are_those_that_loads_at_the_tool_show(way: str) -> None:
    robot = heavy()
    truth, table = experiment(robot, 3, "absolute", SIGMA)
    start = StiffnessModel.of(reduce(robot, "force", "pose"))
    model = fit(start, table).model if way == "diagnosis" else identify(robot, table, start).model
    _, fresh = experiment(robot, 11, "deflection", 0.0)
    loads = replace(fresh, w=0.3 * fresh.w)
    wanted = clean_response(truth, loads.q, loads.w, {"kind": "deflection"})[:, :3]
    found = model.deflection(loads.q, loads.w)[:, :3]
    error = float(np.sqrt(np.mean((found - wanted) ** 2)))
    assert error < 0.05 * float(np.sqrt(np.mean(wanted**2)))


def test_absolute_data_of_a_heavy_arm_say_that_model_and_code_leave_its_weight_out() -> None:
    robot = heavy()
    for kind, told in (("absolute", 1), ("deflection", 0)):
        _, table = experiment(robot, 3, kind, SIGMA)
        start = StiffnessModel.of(reduce(robot, "force", "pose"))
        remarks = (identify(robot, table, start).remarks, run(Task(robot, table, start)).remarks)
        assert [sum("own weight bends the arm" in r for r in said) for said in remarks] == [told, told]


def test_no_column_is_the_rounding_of_others() -> None:
    """Such a column is a direction by chance: it takes a degree of freedom, another one at every call."""
    robot = heavy()
    _, table = experiment(robot, 3, "absolute", SIGMA)
    start = StiffnessModel.of(reduce(robot, "force", "pose"))
    one = column_space(settled(start, table).A)
    other = column_space(settled(start, replace(table, q=table.q + 1e-13)).A)
    assert one.shape == other.shape
    assert np.linalg.norm(one - other @ (other.T @ one), axis=0) == pytest.approx(0.0, abs=1e-6)
