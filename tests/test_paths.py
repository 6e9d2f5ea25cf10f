"""What compensate reads and says: labelled paths, loads through zero, rows that it cannot correct."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import pytest
from command_line import OBLIQUE, Result, Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.effects.instance import EffectInstance
from symstiff.model import joints_only
from symstiff.robot import load
from tests.test_cli_notes import VALUES, arm, notes


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_trajectory_keeps_its_columns_units_and_order(run: Run) -> None:
    arm().save("model.toml")
    text = (
        "fx[N],q2[deg],pose,q1[rad],time[s],temperature[degC]\n100,30,a,0.5,0.10,\n-50,40,b,0.25,0.20,21.50\n"
    )
    Path("way.csv").write_text(text)
    notes(run, "compensate", "model.toml", "way.csv")
    before, after = (list(csv.reader(t.splitlines())) for t in (text, Path("m.toml").read_text()))
    assert after[0] == before[0]
    for old, new in zip(before[1:], after[1:], strict=True):
        assert [new[k] for k in (0, 2, 4, 5)] == [old[k] for k in (0, 2, 4, 5)]
        assert all(0 < abs(float(new[k]) - float(old[k])) < 0.2 for k in (1, 3))


def test_one_pose_under_several_loads_becomes_several_only_where_its_commands_part(run: Run) -> None:
    arm().with_values({"c1": 2e-5, "c2": 3e-5}).save("model.toml")
    rows = ("a,0,30,1", "a,0,30,2", "a,0,30,900", "b,0,40,900")
    Path("way.csv").write_text("pose,q1[deg],q2[deg],fy[N]\n" + "\n".join(rows) + "\n")
    said = notes(run, "compensate", "model.toml", "way.csv")
    assert "2 poses in 4 rows: predicted error" in said
    assert "pose a became a/1, a/2, …" in said
    labels = [row[0] for row in csv.reader(Path("m.toml").read_text().splitlines())]
    assert labels == ["pose", "a/1", "a/2", "a/3", "b"]
    from symstiff.calibration.tables.table import read_poses

    assert len(read_poses("m.toml")) == 4


def test_a_path_with_labels_may_come_to_a_point_again(run: Run) -> None:
    arm().save("model.toml")
    Path("way.csv").write_text("pose,q1[deg],q2[deg],fy[N]\nhome,10,40,50\naway,20,40,50\nhome,10,40,50\n")
    notes(run, "compensate", "model.toml", "way.csv")
    home, _, again = list(csv.reader(Path("m.toml").read_text().splitlines()))[1:]
    assert home == again


def test_a_load_through_zero_may_tell_the_way_it_goes_on_a_path_as_in_a_table(run: Run) -> None:
    """From -60 N to 60 N and back: going up it first falls in size and then grows, and the other way round."""
    arm().with_effect(EffectInstance("hysteresis", {"joint": 2})).with_values(
        {**VALUES, "hysteresis_2_width": 1e-3}
    ).save("model.toml")
    loads = (-60, -30, 30, 60, 30, -30, -60)
    written = []
    for name, branches in (
        ("way", ("up",) * 4 + ("down",) * 3),
        ("size", ("down", "down", "up", "up", "down", "up", "up")),
    ):
        label = ["a" if name == "way" else f"a{k}" for k in range(len(loads))]
        rows = [f"{p},10,40,{f},{b}\n" for p, f, b in zip(label, loads, branches, strict=True)]
        Path("way.csv").write_text("pose,q1[deg],q2[deg],fy[N],branch\n" + "".join(rows))
        notes(run, "compensate", "model.toml", "way.csv")
        written.append([row[1:3] for row in csv.reader(Path("m.toml").read_text().splitlines())])
    assert written[0] == written[1]
    assert written[0][1] != written[0][7]


def test_a_deflection_that_moves_the_loads_levers_leaves_more_than_the_model_tells(run: Run) -> None:
    """Of second order: its square over the reach, which a small one does not leave."""
    arm().with_values({"c1": 2e-5, "c2": 3e-5}).save("model.toml")
    for force, told in ((900, True), (9, False)):
        Path("way.csv").write_text(f"q1[deg],q2[deg],fy[N]\n0,30,{force}\n")
        said = notes(run, "compensate", "model.toml", "way.csv")
        assert " mm by the model" in said
        assert ("move the levers of the loads: of the order of " in said) == told


def test_rows_without_a_correction_and_commands_beyond_the_limits_are_named_by_their_lines(run: Run) -> None:
    """No small motion answers 50 kN, and at its limit joint 1 goes beyond it against a force that turns it back."""
    arm().with_values({"c1": 2e-5, "c2": 3e-5}).save("model.toml")
    rows = ("a,10,40,50", "b,20,40,50000", "c,180,40,50")
    Path("way.csv").write_text("pose,q1[deg],q2[deg],fy[N]\n" + "\n".join(rows) + "\n")
    said = notes(run, "compensate", "model.toml", "way.csv", "--json", "out.json")
    assert "1 of 3 rows (line 3) keep their command: a joint would have to move by more" in said
    assert "1 of 3 rows (line 4) have a command beyond the joint limits" in said
    told = json.loads(Path("out.json").read_text())
    assert (told["poses"], told["rows"], told["unsolved"]) == (3, 3, 1)
    assert told["kept"] == [{"line": 3, "pose": "b", "reason": "too_far"}]
    assert told["beyond_limits"] == [4]
    written = list(csv.DictReader(Path("m.toml").read_text().splitlines()))
    assert [float(row["q1[deg]"]) > 180 for row in written] == [False, False, True]


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="pipes have no path here")
def test_a_trajectory_may_come_through_a_pipe(run: Run) -> None:
    arm().save("model.toml")
    text = "q1[deg],q2[deg],fy[N]\n10,40,50\n"
    Path("way.csv").write_text(text)
    notes(run, "compensate", "model.toml", "way.csv")
    from_file = Path("m.toml").read_bytes()
    reading, writing = os.pipe()
    os.write(writing, text.encode())
    os.close(writing)
    notes(run, "compensate", "model.toml", f"/dev/fd/{reading}")
    os.close(reading)
    assert Path("m.toml").read_bytes() == from_file


@pytest.mark.parametrize("left", ["[values]\nc1 = 0.0\nc2 = 0.0\n", ""])
def test_a_model_without_values_compensates_nothing_and_is_refused(run: Run, left: str) -> None:
    arm().with_values({}).save("model.toml")
    zeros = "[values]\nc1 = 0.0\nc2 = 0.0\n"
    text = Path("model.toml").read_text()
    assert zeros in text
    Path("model.toml").write_text(text.replace(zeros, left))
    Path("way.csv").write_text("q1[deg],q2[deg],fx[N]\n0,30,10\n")
    assert_users_mistake(
        run("compensate", "model.toml", "way.csv", "-o", "m.csv"),
        "model.toml",
        "values",
        "identify",
        "--start",
    )
    assert not Path("m.csv").exists()


def test_a_row_without_what_the_model_follows_is_named(run: Run) -> None:
    slack = arm().with_effect(EffectInstance("hysteresis", {"joint": 2}, {"width": 20.0}))
    slack.with_values(dict(VALUES) | {n: 1e-4 for n in slack.parameters if n not in VALUES}).save(
        "model.toml"
    )
    row, command = "0,30,10", ("compensate", "model.toml", "way.csv", "-o", "m.csv")
    Path("way.csv").write_text(f"q1[deg],q2[deg],fx[N],branch,time[s]\n{row},up,1\n{row},down,\n\n{row},,3\n")
    assert_users_mistake(run(*command), "way.csv: line 5: column branch: missing value")
    Path("way.csv").write_text(f"q1[deg],q2[deg],fx[N],time[s]\n{row},1\n")
    assert_users_mistake(run(*command), "way.csv: the model needs the column branch: add it")
    Path("way.csv").write_text(f"q1[deg],q2[deg],fx[N],branch,time[s]\n{row},up,\n{row},down,1\n")
    assert run(*command).code == 0  # the time is nothing that it follows
    Path("way.csv").write_text(f"q1[deg],q2[deg],fx[N],branch\n{row},up\n0,30,0,\n")
    assert run(*command).code == 0  # an arm that carries nothing has no branch
    assert Path("m.csv").read_text().splitlines()[2].startswith("0,30,")


def test_a_trajectory_without_loads_is_remarked(run: Run) -> None:
    arm().save("model.toml")
    Path("way.csv").write_text("q1[deg],q2[deg]\n0,30\n")
    assert "no loads at the tool: nothing that the model compensates" in notes(
        run, "compensate", "model.toml", "way.csv"
    )


@pytest.mark.parametrize(("robot", "told"), [("ur10", True), ("planar2r", False)])
def test_that_the_own_weight_is_not_compensated_is_told(run: Run, robot: str, told: bool) -> None:
    """A robot whose masses are known sags by itself, and the model gives what loads at the tool add to that."""
    model = joints_only(load(robot), "wrench")
    model.with_values(dict.fromkeys(model.parameters, 1e-6)).save("model.toml")
    names = [f"q{k + 1}[deg]" for k in range(model.robot.dof)]
    Path("way.csv").write_text(",".join([*names, "fy[N]"]) + "\n" + "30," * len(names) + "10\n")
    assert ("own weight bends the arm as well" in notes(run, "compensate", "model.toml", "way.csv")) == told
