"""Data that cannot tell two effects apart: the verdict says so, and what it asks for decides."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.calibration.tables.table import read_poses, write_table
from symstiff.cli import main

ELBOW = """
format = 1
name = "elbow"
convention = "standard"
source = "an arm of three joints, for tests"
[base]
xyz = [0, 0, 0.5]
[base.link]
template = "rigid"
[[joint]]
a = 0.2
alpha = "-pi/2"
d = 0
limits = [-3, 3]
[joint.link]
beam_axis = "x"
[[joint]]
a = 1
alpha = 0
d = 0
limits = [-2.5, 0.5]
[joint.link]
beam_axis = "x"
[[joint]]
a = 0.9
alpha = 0
d = 0
limits = [-2, 2]
[joint.link]
beam_axis = "x"
"""
TRUTH = """
format = 1
robot = "{robot}"
noise = {{ sigma_mm = 0.02 }}
[[effect]]
{effect}
"""


def command(*arguments: object) -> int:
    """Run the program as from a shell; the exit code."""
    with patch.object(sys, "argv", ["symstiff", *map(str, arguments)]):
        try:
            main()
        except SystemExit as stop:
            return int(stop.code or 0)
    return 0


def table(q: np.ndarray, loads: np.ndarray, branches: tuple[float, ...] = (float("nan"),)) -> Measurements:
    """Poses (n, dof), each under its load cases (n, k, 6), on the way up and down where asked for."""
    cases = [(p, w, b) for p in range(len(q)) for w in loads[p] for b in branches]
    return measurements(
        np.array([q[p] for p, _, _ in cases]),
        np.array([w for _, w, _ in cases]),
        pose=np.array([p for p, _, _ in cases]),
        branch=np.array([b for _, _, b in cases]),
    )


def stretched() -> Measurements:
    """The planar arm with its second joint at zero: both joints move the tool the same way, their loads are alike."""
    rng = np.random.default_rng(0)
    q = np.column_stack([rng.uniform(-2.5, 2.5, 10), np.zeros(10)])
    angle = rng.uniform(0, 2 * np.pi, 10)
    force = 80 * np.stack([np.cos(angle), np.sin(angle), np.full(10, 0.3), *np.zeros((3, 10))], axis=1)
    return table(q, np.array([0.25, 0.5, 0.75, 1.0])[:, None] * force[:, None], (1.0, -1.0))


def one_weight() -> Measurements:
    """The elbow over a narrow range of its second joint with one weight, up and down: its load follows its angle."""
    rng = np.random.default_rng(1)
    q = np.column_stack([rng.uniform(-2, 2, 12), np.linspace(-1.15, -0.65, 12), np.full(12, 0.8)])
    force = np.array([[0, 0, -300.0, 0, 0, 0], [0, 0, 300.0, 0, 0, 0]])
    return table(q, np.repeat(force[None], 12, axis=0))


class Story:
    """A robot, what is hidden in it, data that cannot tell it from something else, and who could be taken for it."""

    def __init__(
        self, robot: str, effect: str, design: Measurements, right: tuple[str, int], wrong: tuple[str, int]
    ) -> None:
        self.robot, self.effect, self.design, self.right = robot, effect, design, right
        self.sets = {right, wrong}


STORIES = {
    "hysteresis of one joint or the other": Story(
        "planar2r",
        'effect = "hysteresis"\nwhere = { joint = 2 }\nwidth = 1.5e-4\nknee = 2.0',
        stretched(),
        ("hysteresis", 2),
        ("hysteresis", 1),
    ),
    "gear or gravity compensator": Story(
        "elbow",
        'effect = "nonlinear_stiffness"\nwhere = { joint = 2 }\nshape = "polynomial"\nc3 = 5e-12',
        one_weight(),
        ("nonlinear_stiffness", 2),
        ("gravity_compensator", 2),
    ),
}


class Trip:
    """The folder of a round trip: measured, diagnosed, measured as asked for, diagnosed again."""

    def __init__(self, name: str, place: Path) -> None:
        self.place, self.story = place, STORIES[name]
        (place / "elbow.toml").write_text(ELBOW)
        self.robot = str(place / "elbow.toml") if self.story.robot == "elbow" else self.story.robot
        (place / "truth.toml").write_text(TRUTH.format(robot=self.robot, effect=self.story.effect))
        write_table(self.story.design, place / "poses.csv", "deg")
        self.measure("poses.csv", "old.csv", 3)
        assert command("diagnose", self.robot, place / "old.csv", "-o", place / "first") == 0

    def measure(self, poses: str, data: str, seed: int) -> None:
        """The virtual experiment at some poses."""
        arguments = ("simulate", self.place / "truth.toml", "--poses", self.place / poses, "--seed", seed)
        assert command(*arguments, "-o", self.place / data) == 0

    def verdict(self, folder: str) -> Any:
        """verdict.json of a diagnosis."""
        return json.loads((self.place / folder / "verdict.json").read_text())


@pytest.fixture(scope="module", params=list(STORIES))
def trip(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Trip:
    return Trip(request.param, tmp_path_factory.mktemp("trip"))


def test_confounded_data_give_the_admissible_set_with_the_truth_in_it(trip: Trip) -> None:
    verdict = trip.verdict("first")
    assert verdict["verdict"] == "ambiguous"
    assert {(e["effect"], e["where"].get("joint")) for e in verdict["effects"]} == trip.story.sets
    assert len({e["set"] for e in verdict["effects"]}) == len(trip.story.sets)
    assert 0.5 < sum(e["confidence"] for e in verdict["effects"]) <= 1 + 1e-12


def test_the_verdict_and_the_report_give_the_poses_and_loads_that_decide(trip: Trip) -> None:
    decide = trip.verdict("first")["decide"]
    poses = read_poses(trip.place / "first" / "decide.csv")
    assert [p["pose"] for p in decide["poses"]] == list(poses.labels)
    first = np.degrees(poses.q[0])
    np.testing.assert_allclose(list(decide["poses"][0]["q"].values()), first, atol=1e-9)
    asked = {tuple(np.round(list(w.values()), 6)) for w in decide["loads"]}
    assert {tuple(w) for w in np.round(poses.w, 6).tolist()} == asked
    assert decide["poses"][-1]["separation"] > 20
    page = (trip.place / "first" / "report.html").read_text()
    section = page[page.index('id="decide"') : page.index('id="gap"')]
    assert all(label in section for label in poses.labels)
    assert "q2 [°]" in section
    assert "fz [N]" in section


def test_plan_takes_the_verdict_and_simulate_takes_the_plan(trip: Trip) -> None:
    plan = ("plan", trip.robot, "--poses", 5, "--loads", "force", "--measure", "position", "--force", 200)
    output = ("-o", trip.place / "plan.csv", "--json", trip.place / "plan.json")
    assert command(*plan, "--separate", trip.place / "first" / "verdict.json", *output) == 0
    assert json.loads((trip.place / "plan.json").read_text())["separation"][-1] > 20
    trip.measure("plan.csv", "planned.csv", 5)
    planned, proposed = (
        {row["pose"] for row in csv.DictReader((trip.place / name).read_text().splitlines())}
        for name in ("planned.csv", "first/decide.csv")
    )
    assert planned == {f"decide{len(proposed) + k}" for k in range(1, 6)}  # both may be measured


@pytest.mark.slow
def test_old_and_new_data_together_give_the_right_name(trip: Trip) -> None:
    trip.measure("first/decide.csv", "new.csv", 4)
    data = (trip.place / "old.csv", trip.place / "new.csv")
    assert command("diagnose", trip.robot, *data, "-o", trip.place / "second") == 0
    verdict = trip.verdict("second")
    assert verdict["verdict"] == "named"
    assert [(e["effect"], e["where"]["joint"]) for e in verdict["effects"]] == [trip.story.right]
    assert "decide" not in verdict
    assert not (trip.place / "second" / "decide.csv").exists()
