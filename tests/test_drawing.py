"""Deflections of a robot that is not the one of its file: columns against the simulator, verdicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import Laws, Situation, look
from symstiff.calibration.simulation import Truth, clean_response, nominal_truth
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.laws.drawing import drawing_laws
from symstiff.discrepancy.workflow import diagnose
from symstiff.reduction.physical import original, terms_of
from symstiff.robot import from_table, load
from symstiff.robot.schema import Robot
from symstiff.robot.table import to_table
from symstiff.symbolic.terms import Term
from tests.test_assemble import design, truth_of
from tests.test_sensors import read

STEP = 1e-3


LOADS = {"kuka_kr270": 300.0, "ur10": 40.0, "scara": 30.0, "franka_panda": 20.0}


def changed(name: str, joint: int, parameter: str, by: float) -> Robot:
    """The robot of the library with one DH parameter more."""
    table = to_table(load(name))
    row = table["joint"][joint - 1]
    row[parameter] = repr(float(getattr(load(name).joint[joint - 1], parameter)) + by)
    return from_table(table)


def true_laws(name: str) -> tuple[tuple[Term, ...], dict[str, float]]:
    """Every compliance of the robot, and what the simulator gives them."""
    values = nominal_truth(load(name))
    return terms_of(tuple(p for p in original(load(name)).parameters if p.name in values)), values


def poses(name: str) -> Measurements:
    """Random poses under random wrenches, with markers that stand beside the tool."""
    robot, rng = load(name), np.random.default_rng(4)
    limits = np.array([j.range for j in robot.joint])
    q = rng.uniform(limits[:, 0], limits[:, 1], (20, robot.dof))
    w = rng.normal(size=(20, 6)) * [1, 1, 1, 0.2, 0.2, 0.2] * LOADS[name]
    points = ("tcp", *(m.name for m in robot.marker))
    units = ["m" if j.prismatic else "rad" for j in robot.joint]
    point = np.arange(20) % len(points)
    table = measurements(q, w, points=points, point=point, kind="deflection", joint_units=units)
    return replace(table, values=np.zeros((20, 6)))


@pytest.mark.parametrize(
    ("name", "joint", "parameter"),
    [
        ("ur10", 1, "theta"), ("ur10", 3, "d"), ("ur10", 4, "alpha"), ("kuka_kr270", 2, "theta"),
        ("kuka_kr270", 3, "a"), ("scara", 2, "a"), ("scara", 3, "alpha"), ("franka_panda", 4, "a"),
        ("franka_panda", 5, "alpha"), ("franka_panda", 6, "theta"), ("franka_panda", 7, "d"),
    ],
)  # fmt: skip
def test_a_wrong_row_of_the_file_is_what_it_does_in_the_simulator(
    name: str, joint: int, parameter: str
) -> None:
    table, (terms, values) = poses(name), true_laws(name)
    view = look(load(name), table)
    laws = {x.title: x for x in drawing_laws(Situation(view, Laws(view, terms, values)))}
    law = laws[f"correction of {parameter} of joint {joint}"]
    more, less = (
        clean_response(
            Truth(changed(name, joint, parameter, by), values),
            table.q,
            table.w,
            {"points": table.points, "point": table.point},
        )
        for by in (STEP, -STEP)
    )
    change = (more - less)[view.state, view.component] / (2 * STEP)
    assert np.linalg.norm(law.values[:, 0] - change) < 0.02 * np.linalg.norm(change)


def test_a_marker_elsewhere_is_what_it_does_in_the_simulator() -> None:
    table, (terms, values) = poses("ur10"), true_laws("ur10")
    view = look(load("ur10"), table)
    name, at, by = view.table.points[1], view.table.point[view.state] == 1, [3e-3, -1e-3, 2e-3]
    laws = {x.title: x for x in drawing_laws(Situation(view, Laws(view, terms, values)))}
    law = laws[f"correction of marker {name}"]
    moved = to_table(load("ur10"))
    moved["marker"][0]["xyz"] = [
        float(x) + d for x, d in zip(load("ur10").marker_position(name), by, strict=True)
    ]
    context = {"points": table.points, "point": table.point}
    before, after = (
        clean_response(Truth(r, values), table.q, table.w, context) for r in (load("ur10"), from_table(moved))
    )
    change = (after - before)[view.state, view.component]
    assert not law.values[~at].any()
    assert np.linalg.norm(law.values @ by - change) < 0.02 * np.linalg.norm(change)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "joint", "parameter", "by"), [("ur10", 3, "theta", 0.05), ("kuka_kr270", 3, "alpha", 0.1)]
)
def test_a_wrong_row_is_no_effect_of_the_catalogue(name: str, joint: int, parameter: str, by: float) -> None:
    table = design(name, "deflection", poses=30)
    made = read(table, replace(truth_of(name), robot=changed(name, joint, parameter, by)), 7)
    found = diagnose(Task(load(name), made))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == f"robot file's joint {joint}"
    assert law.terms[0][0] == f"correction of {parameter} of joint {joint}"
    assert law.terms[0][1] == pytest.approx(by, abs=0.2 * by + 3 * law.terms[0][2])
    assert any(
        f"a correction of {parameter} of joint {joint} explains more than anything else" in text
        for text in found.remarks
    )
