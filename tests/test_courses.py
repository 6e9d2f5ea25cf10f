"""Sensors, markers and mounts that change with the session or its temperature, and loads that are not as told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import look
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.assemble import Assembly
from symstiff.discrepancy.problem import DeviceLaw
from symstiff.robot import load
from tests.test_assemble import assemble, complete, design, measured, readings, truth_of
from tests.test_posture import left

LEVELS = (0.25, 0.5, 1.0)


def experiment() -> Measurements:
    """Forces along one direction a pose, of three sizes."""
    table = design("ur10", "deflection", levels=LEVELS)
    w = table.w.copy()
    size = np.linalg.norm(w[:, :3], axis=1, keepdims=True)
    told = 40.0 * np.tile(np.repeat(LEVELS, 3), len(w) // 9)[:, None]
    return replace(table, w=np.hstack([w[:, :3] / size * told, 0.0 * w[:, 3:]]))


@pytest.fixture(scope="module")
def found() -> Assembly:
    return assemble(complete("ur10"), measured(truth_of("ur10"), experiment()), effects=())


def law(found: Assembly, place: str, title: str) -> DeviceLaw:
    (only,) = (x for x in found.problem.devices if (x.place, x.title) == (place, title))
    return only


def change(found: Assembly, share: np.ndarray) -> np.ndarray:
    """(M,) what loads larger by a share (N,) of themselves change in the simulator, for one per cent."""
    table = experiment()
    truth, view = truth_of("ur10"), found.situation.view
    more = replace(table, w=table.w * (1.0 + 0.01 * share[:, None]))
    return (readings(truth, more) - readings(truth, table))[view.state, view.component]


def test_a_load_that_is_another_one_in_all_poses_has_a_law(found: Assembly) -> None:
    """A weight whose stamp lies: one of three sizes."""
    size = np.linalg.norm(experiment().w[:, :3], axis=1)
    values = law(found, "load of 20 N", "load that differs").values
    assert left(values, change(found, np.isclose(size, 20.0).astype(float))) < 0.01
    assert {x.place for x in found.problem.devices if x.title == "load that differs"} >= {
        "load of 10 N", "load of 20 N", "load of 40 N",
    }  # fmt: skip


@pytest.mark.parametrize("what", ["time", "temperature"])
def test_a_force_sensor_whose_gain_drifts_has_a_law(found: Assembly, what: str) -> None:
    course = getattr(experiment(), what)
    course = (course - course.min()) / np.ptp(course)
    assert left(law(found, "force sensor", f"gain*{what}").values, change(found, course)) < 0.01


def test_a_marker_that_creeps_moves_in_the_tools_axes(found: Assembly) -> None:
    table, view = experiment(), found.situation.view
    creep = 1e-4 * np.array([1.0, -0.5, 2.0])
    session = (table.clock - table.clock.min()) / np.ptp(table.clock)
    tool = look(load("ur10"), table).found.R[:, -1]
    moved = ((table.point == 1) * session)[:, None] * (tool @ creep)
    values = law(found, "marker p2", "shift growing with the session in the tool's axes").values
    np.testing.assert_allclose(values @ creep, moved[view.state, view.component], atol=1e-12)


@pytest.mark.parametrize("what", ["session", "temperature"])
@pytest.mark.parametrize(("place", "end"), [("link 0", 0), ("link 6", 6)])
def test_a_floor_or_a_mount_that_softens_has_a_law_with_usual_sizes(
    found: Assembly, place: str, end: int, what: str
) -> None:
    """Of a shift along an axis by the force along it, as far as the session or its temperature has gone."""
    view = found.situation.view
    table = view.table
    course = table.clock if what == "session" else table.temperature
    course = ((course - course.min()) / np.ptp(course))[view.state]
    block = law(found, place, f"compliance that grows with the {what}")
    assert all(p.typical > 0 for p in block.parameters)
    shift = course * view.J[:, 7 * end] * view.tau[view.state, 7 * end]
    assert left(block.values, shift) < 1e-9
