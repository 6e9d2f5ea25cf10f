"""Targets and devices that stood elsewhere: always, or from some pose on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.tables.measurements import Measurements, concatenate
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.model import joints_only
from symstiff.report.words import sentence
from symstiff.robot import load
from symstiff.symbolic.numeric import forward
from tests.diagnosis_data import ROBOT, measured

SHIFT = np.array([8e-5, -4e-5, 0.0])


def shifted(table: Measurements, of_tool: bool, since: int = 0) -> Finding:
    turn = forward(load(ROBOT), table.q)[:, :3, :3] if of_tool else np.tile(np.eye(3), (len(table), 1, 1))
    values = table.values.copy()
    values[:, :3] += (table.pose >= since)[:, None] * np.einsum("nij,j->ni", turn, SHIFT)
    return diagnose(Task(load(ROBOT), replace(table, values=values)))


@pytest.mark.parametrize(("of_tool", "place"), [(True, "flange"), (False, "measuring device")])
def test_what_stood_elsewhere_without_a_load_is_accused_with_its_shift(of_tool: bool, place: str) -> None:
    """A tool that slips back when nothing pulls at it, a zero reading that is off: alike under every load."""
    found = shifted(measured(), of_tool)
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == place
    assert [value for _, value, _, _ in law.terms] == pytest.approx(SHIFT, abs=1.5e-5)
    assert "shift under any load" in sentence(found)


def test_what_sets_one_pose_apart_is_no_change_of_the_session() -> None:
    """A change after the first pose or before the last is a bad pose, and is looked for as one."""
    table = measured()
    laws = assemble(joints_only(load(ROBOT)), table, effects=()).problem.devices
    titles = [p.name for law in laws for p in law.parameters if "of the session on" in p.name]
    shares = {float(title.split(" % of the session")[0].rpartition(" ")[2]) for title in titles}
    poses = len(np.unique(table.pose))
    assert min(shares) > 100.0 * 1.5 / poses
    assert max(shares) < 100.0 * (poses - 1.5) / poses


@pytest.mark.parametrize(("zero", "words"), [(0.0, "since the session began"), (0.5, "none in its middle")])
def test_a_device_that_turns_slowly_is_accused_with_how_far(zero: float, words: str) -> None:
    """As its tripod settles, or the sun warms it: deflections are read in axes that turn."""
    table = measured(force=800.0, poses=16)
    session = np.linspace(0.0, 1.0, len(table)) - zero
    turn = np.array([0.0, 0.0, 0.03])
    values = table.values.copy()
    values[:, :3] += session[:, None] * np.cross(turn, values[:, :3])
    found = diagnose(Task(load(ROBOT), replace(table, values=values)))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "measuring device"
    assert law.terms[2][0].endswith(f"{words}: z")
    assert law.terms[2][1] == pytest.approx(turn[2], rel=0.15)
    assert words in sentence(found)


@pytest.mark.parametrize(("slowing", "how"), [(0.0, "steadily"), (4.0, "ever less in the session")])
def test_a_device_that_drifts_from_each_reading_without_load_is_accused(slowing: float, how: str) -> None:
    """As it warms up: what a deflection holds of it grows in a pose, and begins anew with the next."""
    table = measured(poses=16)
    step = np.arange(len(table)) // 3  # three markers are read at once
    session = step / step.max()
    since = (step % 5 + 1) / step.max() * np.exp(-slowing * session)
    values = table.values.copy()
    values[:, :3] += 20.0 * since[:, None] * SHIFT
    timed = replace(table, values=values, time=60.0 * step)
    found = diagnose(Task(load(ROBOT), timed))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "measuring device"
    assert law.terms[0][0] == f"shift since the reading without load, {how}: x"
    assert [value for _, value, _, _ in law.terms] == pytest.approx(20.0 * SHIFT, abs=4e-4)
    untimed = assemble(joints_only(load(ROBOT)), replace(table, values=values), effects=()).problem.devices
    assert not any("since the reading" in law.title for law in untimed)


def test_a_pose_that_is_visited_again_has_a_reading_without_load_of_its_own() -> None:
    table = measured(poses=16)
    again = table.select(table.pose == 0)
    count = len(table) + len(again)
    both = concatenate([replace(t, repeat=np.full(len(t), k)) for k, t in enumerate((table, again), 1)])
    both = replace(both, time=60.0 * (np.arange(count) // 3))
    devices = assemble(joints_only(load(ROBOT)), both, effects=()).problem.devices
    law = next(law for law in devices if law.title == "shift since the reading without load")
    size = np.abs(law.values).max(axis=1)
    assert 0.0 < size.max() < 1.5 * np.quantile(size, 0.9)


def test_a_device_that_goes_to_and_fro_is_accused_with_how_often() -> None:
    """As the floor under it warms and cools: no drift, and no error of a pose."""
    table = measured(poses=16)
    waves = np.sin(2.0 * np.pi * 1.5 * np.linspace(0.0, 1.0, len(table)))
    values = table.values.copy()
    values[:, :3] += waves[:, None] * SHIFT
    found = diagnose(Task(load(ROBOT), replace(table, values=values)))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "measuring device"
    names, sizes = zip(*((name, value) for name, value, _, _ in law.terms), strict=True)
    assert names[0] == "shift to and fro, 1.5 times in the session, sin: x"
    assert sizes[:3] == pytest.approx(SHIFT, abs=1.5e-5)
    assert "to and fro, 1.5 times in the session" in sentence(found)
