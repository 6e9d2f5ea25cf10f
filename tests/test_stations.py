"""Absolute positions of several files: the device stood elsewhere for each, as after a night."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from symstiff.calibration.doubts.point import find_point
from symstiff.calibration.doubts.stations import check_stations
from symstiff.calibration.experiment.arm import drawn
from symstiff.calibration.experiment.placement import placed, placement_columns
from symstiff.calibration.experiment.situation import Laws, look
from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.simulation.truth import Device
from symstiff.calibration.tables.checks import without_copies
from symstiff.calibration.tables.measurements import Measurements, concatenate, measurements
from symstiff.calibration.tables.sessions import by_session
from symstiff.calibration.tables.table import read_table, write_table
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.errors import UserError
from symstiff.model import joints_only
from symstiff.robot import load
from symstiff.robot.tool import tool_of, with_tool

ROBOT, POSES, FORCE, SIGMA = load("kuka_kr270"), 20, 2000.0, 0.02
PLACES = (Device((3.0, 1.0, 0.5), (0.0, 0.0, 2.0)), Device((2.0, -2.0, 0.4), (0.01, 0.0, 0.5)))
LASH = Effect("backlash", {"joint": 3}, "tanh", {"gap": 9e-4, "knee": 50.0})
JOINTS = {name: value for name, value in nominal_truth(ROBOT).items() if name.startswith("c")}


def design(seed: int, loads: tuple[float, ...] = (0.0, 0.4, 0.7, 1.0)) -> Measurements:
    """Random poses, one force each at some levels."""
    rng = np.random.default_rng(seed)
    limits = np.array([j.range for j in ROBOT.joint])
    q = rng.uniform(limits[:, 0], limits[:, 1], (POSES, ROBOT.dof))
    side = rng.normal(size=(POSES, 3))
    force = FORCE * side / np.linalg.norm(side, axis=1)[:, None]
    w = np.zeros((POSES * len(loads), 6))
    w[:, :3] = (force[:, None] * np.array(loads)[None, :, None]).reshape(-1, 3)
    pose = np.repeat(np.arange(POSES), len(loads))
    return measurements(np.repeat(q, len(loads), axis=0), w, pose=pose, kind="absolute")


def session(seed: int, device: Device, *effects: Effect, noise: float = SIGMA) -> Measurements:
    truth = Truth(ROBOT, JOINTS, effects, Noise((noise,) * 3), device=device)
    return simulate(truth, design(seed), seed)


def saved(folder: Path, *tables: Measurements) -> Measurements:
    """The tables, each written to a file of its own and read together."""
    paths = [folder / f"{month}.csv" for month in ("may", "june")[: len(tables)]]
    for path, table in zip(paths, tables, strict=True):
        write_table(table, path)
    return read_table(paths)


@cache
def sessions() -> tuple[Measurements, ...]:
    return tuple(session(seed, device, LASH) for seed, device in enumerate(PLACES, start=1))


def test_each_file_is_placed_as_it_is_alone(tmp_path: Path) -> None:
    def excess(table: Measurements) -> np.ndarray:
        view = look(ROBOT, table)
        return placed(view, drawn(view, Laws(view, (), {})))[1]

    both, alone = saved(tmp_path, *sessions()), [saved(tmp_path, table) for table in sessions()]
    assert excess(both) == pytest.approx(np.concatenate([excess(table) for table in alone]), abs=1e-12)
    assert np.abs(excess(both)).max() < 0.02


def test_the_place_of_a_station_is_as_free_as_the_first_one(tmp_path: Path) -> None:
    """What turns and shifts the readings of one file alone is in the columns, of the other file nothing is moved."""
    table = saved(tmp_path, *sessions())
    view = look(ROBOT, table)
    view, _ = placed(view, drawn(view, Laws(view, (), {})))
    columns, second = placement_columns(view), (table.station == 1)[view.state]
    assert columns.shape == (len(view.state), 12)
    assert np.linalg.matrix_rank(columns) == 12
    turn, points = np.array([1e-6, -2e-6, 3e-6]), view.points
    moved = (np.cross(turn, points) + np.array([1e-3, 0.0, 0.0]))[view.state, view.component] * second
    left = moved - columns @ np.linalg.lstsq(columns, moved, rcond=None)[0]
    assert np.abs(left).max() < 1e-15
    assert not columns[~second, 6:].any()


@pytest.mark.parametrize("part", ["a line", "two coordinates"])
def test_a_file_that_does_not_tell_where_the_device_stood_has_the_first_place(
    tmp_path: Path, part: str
) -> None:
    one, other = sessions()
    if part == "a line":  # one pose: three loads move its point by less than a millimetre
        other = other.select(np.flatnonzero(other.pose == 0))
    else:
        lost = np.arange(6) == 1
        other = replace(
            other, values=np.where(lost, np.nan, other.values), sigma=np.where(lost, np.nan, other.sigma)
        )
    table = saved(tmp_path, one, other)
    assert not table.station.any()
    assert set(saved(tmp_path, *sessions()).station) == {0, 1}


def test_a_pose_that_was_measured_from_two_places_was_approached_twice(tmp_path: Path) -> None:
    """The arm came back to it, and may have stopped elsewhere."""
    one, _ = sessions()
    other = session(1, PLACES[1], LASH)
    heavy, light = (np.flatnonzero((np.linalg.norm(t.w, axis=1) > 1200.0) == more)
                    for t, more in ((one, True), (other, False)))  # fmt: skip
    table = saved(tmp_path, one.select(heavy), other.select(light))
    assert len(table.labels) == POSES
    assert len(np.unique(table.approach)) == 2 * POSES
    assert set(saved(tmp_path, *sessions()).visit) == {0}


def test_deflections_have_no_station() -> None:
    table = replace(concatenate(sessions()), kind="deflection", files=("may.csv", "june.csv"))
    assert not table.station.any()


@pytest.mark.slow
def test_a_gap_is_named_from_two_places_of_the_device(tmp_path: Path) -> None:
    table = saved(tmp_path, *sessions())
    found = diagnose(Task(ROBOT, table, "joints"))
    assert found.verdict == "named"
    assert [(e.effect, e.where) for e in found.named] == [("backlash", {"joint": 3})]
    assert found.rms.after == pytest.approx(1e-3 * SIGMA, rel=0.15)
    assert found.named[0].parameters["backlash_3_gap"].value == pytest.approx(9e-4, rel=0.05)
    assert sum("where the measuring device stood is found" in r for r in found.remarks) == 1


def test_compliances_are_identified_from_two_places_of_the_device(tmp_path: Path) -> None:
    places = enumerate(PLACES, start=1)
    fitted = identify(ROBOT, saved(tmp_path, *(session(s, p) for s, p in places)), "joints")
    model = fitted.model
    for name, deviation in model.deviations.items():
        assert abs(model.values[name] - JOINTS[name]) < 4.0 * deviation
    assert {f"device_2_{axis}" for axis in range(1, 7)} <= set(fitted.fit.names)
    assert any("may.csv; " in r and "june.csv" in r for r in fitted.remarks)
    assert any("33 constants of geometry and placement were fitted along" in r and "weights" not in r
               for r in fitted.remarks)  # fmt: skip


PROBE = with_tool(ROBOT, tuple(a + b for a, b in zip(tool_of(ROBOT), (0.05, -0.02, 0.1), strict=True)))


def with_a_probe(*effects: Effect) -> list[Measurements]:
    """Unloaded sessions of a probe that the robot file does not tell of."""
    truths = (Truth(PROBE, JOINTS, effects, Noise((SIGMA,) * 3), device=device) for device in PLACES)
    return [simulate(truth, design(seed, (0.0,)), seed) for seed, truth in enumerate(truths, start=1)]


def test_a_probe_that_nobody_told_of_is_found_from_two_places_of_the_device(tmp_path: Path) -> None:
    model, told = find_point(joints_only(ROBOT), saved(tmp_path, *with_a_probe()), ROBOT)
    assert "from the tool centre point of the robot file" in told
    assert tool_of(model.robot) == pytest.approx(tool_of(PROBE), abs=1e-4)


def test_the_probes_place_is_no_error_of_the_last_link(tmp_path: Path) -> None:
    """It was found while a joint's offset was not known, and holds a part of that."""
    offset = Effect("joint_offset", {"joint": 3}, "constant", {"offset": 1.2e-3})
    found = diagnose(Task(ROBOT, saved(tmp_path, *with_a_probe(offset)), "joints"))
    assert found.verdict == "named"
    assert [(e.effect, e.where) for e in found.named] == [("joint_offset", {"joint": 3})]
    assert found.named[0].parameters["joint_offset_3_offset"].value == pytest.approx(1.2e-3, rel=0.03)


@pytest.mark.parametrize(
    "command", [lambda t: identify(ROBOT, t, "joints"), lambda t: diagnose(Task(ROBOT, t))]
)
def test_a_file_that_tells_no_place_of_its_own_and_was_measured_from_another_is_refused(
    tmp_path: Path, command: Any
) -> None:
    """It would be placed with the first file, meters off."""
    one, other = sessions()
    with pytest.raises(UserError, match=r"june\.csv: its points are on a line .* m from where they would be"):
        command(saved(tmp_path, one, other.select(np.flatnonzero(other.pose == 0))))


def test_a_small_file_from_the_same_place_belongs_to_the_first(tmp_path: Path) -> None:
    one, _ = sessions()
    rest, few = (np.flatnonzero((one.pose == 0) == own) for own in (False, True))
    table = saved(tmp_path, one.select(rest), one.select(few))
    check_stations(ROBOT, table)
    assert not table.station.any()


def test_a_pose_that_was_measured_from_two_places_needs_no_number_of_its_repeat(tmp_path: Path) -> None:
    again = session(1, PLACES[1], LASH)
    table = saved(tmp_path, sessions()[0], again)
    assert len(np.unique(table.approach)) == 2 * POSES
    kept, (told,) = without_copies(saved(tmp_path, sessions()[0], sessions()[0]))
    assert len(kept) == len(sessions()[0])
    assert "copies" in told


def timed(*begins: float, every: float = 60.0) -> Measurements:
    """Files that begin at some moments, of ten rows each."""
    time = np.concatenate([begin + every * np.arange(10) for begin in begins])
    table = measurements(np.zeros((len(time), 2)), kind="none", time=time)
    files = tuple(f"{k}.csv" for k in range(len(begins)))
    return replace(table, file=np.repeat(np.arange(len(begins)), 10), files=files)


@pytest.mark.parametrize(
    ("begins", "expected"),
    [
        ((0.0, 0.0), (0.0, 0.0)),  # clocks of their own
        ((0.0, 700.0), (0.0, 700.0)),  # the same session goes on
        ((5.0, 86400.0), (5.0, 5.0)),
        ((86400.0, 0.0), (0.0, 0.0)),  # the later file is named first
        ((0.0, 86400.0, 87100.0), (0.0, 0.0, 700.0)),  # the second session has two files
    ],
)
def test_the_time_of_another_session_begins_anew(
    begins: tuple[float, ...], expected: tuple[float, ...]
) -> None:
    table, remarks = by_session(timed(*begins))
    assert [float(table.time[table.file == k].min()) for k in range(len(begins))] == list(expected)
    assert len(remarks) == (begins != expected)


def test_files_without_a_time_stay_as_they_are() -> None:
    table = replace(timed(0.0, 86400.0), time=np.full(20, np.nan))
    assert by_session(table) == (table, [])
    assert by_session(timed(3.0))[1] == []
