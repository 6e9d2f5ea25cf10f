"""Where commands write: checked before the work, never what they read, nothing where an option cannot be followed."""

from __future__ import annotations

import csv
import io
import json
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import pytest
from command_line import (  # noqa: F401
    IDENTIFY,
    OBLIQUE,
    POSES,
    TRUTH,
    Result,
    Run,
    assert_users_mistake,
    measured_arm,
    run_command_line,
)  # fmt: skip

import symstiff

REFUSED = [
    ((*IDENTIFY, "--plot", "missing/x.png"), "choose another place with --plot"),
    ((*IDENTIFY, "--plot", "x.foo"), ".png or .svg"),
    ((*IDENTIFY, "--json", "missing/x.json"), "choose another place with --json"),
    ((*IDENTIFY, "--json", "m.toml"), "name the same file"),
    ((*IDENTIFY, "--reconstruct", "r.json"), "--reconstruct needs --start complete"),
    (("identify", "planar2r", "data.csv", "-o", "missing/m", "--reconstruct", "r.json"), "cannot write missing/m"),
    (("identify", "planar2r", "data.csv", "-o", "data.csv"), "data.csv is read by this command"),
    ((*IDENTIFY, "--json", "data.csv"), "data.csv is read by this command"),
    ((*IDENTIFY, "--held-out", "-0.5"), "--held-out: -0.5 is no share"),
    ((*IDENTIFY, "--held-out", "nan"), "--held-out: nan is no share"),
    ((*IDENTIFY, "--per-level", "q²"), "--per-level 'q²': name a joint"),
    ((*IDENTIFY, "--seed", "-1"), "--seed"),
    (("plan", "planar2r", "--poses", "3", "--seed", "-1", "-o", "x.csv"), "--seed"),
    (("plan", "planar2r", "--poses", "3", "--levels", "q²=5", "-o", "x.csv"), "--levels 'q²=5'"),
    (("plan", "planar2r", "--poses", "3", "--plot", "x.pdf", "-o", "x.csv"), ".png or .svg"),
    (("plan", "planar2r", "--poses", "9", "--levels", "q1=5,q1=3", "-o", "x.csv"), "--levels: q1 is given twice"),
    (("plan", "planar2r", "--poses", "9", "--markers", "p1,p2,p1", "-o", "x.csv"), "--markers: p1 is named twice"),
    (("plan", "planar2r", "--poses", "9", "--test-poses", "poses.csv", "-o", "x.csv"), "without --criterion test"),
    (("plan", "planar2r", "--poses", "9", "--separate", "v.json", "--sigma", "0", "-o", "x.csv"), "--sigma 0: a"),
    (("plan", "planar2r", "--poses", "9", "--separate", "v.json", "--force", "nan", "-o", "x.csv"), "a load of nan N"),
    (("simulate", "truth.toml", "--poses", "poses.csv", "--noise", "1e-11", "-o", "x.csv"), "--noise 1e-11"),
    (("simulate", "truth.toml", "--poses", "poses.csv", "--seed", "-1", "-o", "x.csv"), "--seed"),
    (("simulate", "truth.toml", "--poses", "poses.csv", "-o", "poses.csv"), "poses.csv is read by this command"),
    (("reproduce", "--seed", "-1"), "--seed"),
    (("reproduce", "--plot", "missing/x.png"), "choose another place with --plot"),
    (("diagnose", "planar2r", "data.csv", "-o", "out", "--json", "missing/x"), "choose another place with --json"),
    (("diagnose", "planar2r", "data.csv", "-o", "."), "which this command writes"),
    (("generate", "planar2r", "-o", "."), "holds data.csv, which symstiff did not write"),
    (("generate", "planar2r", "-o", ""), "expected a folder, found no name"),
    (("generate", "planar2r", "-o", "out", "--json", "missing/x"), "choose another place with --json"),
    (("generate", "planar2r", "-o", "out", "--model", "m", "--fixed", "q1=0"), "--fixed has no effect with --model"),
    (("compensate", "truth.toml", "poses.csv", "-o", "poses.csv"), "poses.csv is read by this command"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "says"), REFUSED, ids=lambda a: " ".join(a))
def test_what_cannot_be_followed_is_refused_before_anything_is_written(
    run: Run, place: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], says: str
) -> None:
    def worked(*_: object, **__: object) -> None:
        raise AssertionError("the work began")

    for module in walk_packages(symstiff.__path__, "symstiff."):  # one loaded under the patch would keep it
        if not module.name.endswith("__main__"):
            import_module(module.name)
    for work in ("reduction.reduce", "codegen.generate.generate", "discrepancy.workflow.diagnose"):
        monkeypatch.setattr(f"symstiff.{work}", worked)
    before = {p: p.read_bytes() for p in place.iterdir()}
    assert_users_mistake(run(*arguments), says)
    assert {p: p.read_bytes() for p in place.iterdir()} == before


def test_what_a_region_and_a_fixed_joint_cannot_be_is_told_with_its_name(run: Run, tmp_path: Path) -> None:
    plan = ("plan", "planar2r", "--poses", "4", "-o", str(tmp_path / "x.csv"))
    assert_users_mistake(run(*plan, "--keep-out", "nan,0,0,1,1,1"), "give finite numbers")
    assert_users_mistake(run(*plan, "--floor", "5", "--candidates", "128"), "none of", "keeps the region")
    for value in ("x", "1e-400"):
        assert_users_mistake(run("inspect", "ur10", "--fixed", f"q2={value}"), "--fixed: q2")


def test_a_simulation_does_not_replace_the_robot_that_its_truth_names(run: Run, place: Path) -> None:
    arm = place / "arm" / "robot.toml"
    arm.parent.mkdir()
    arm.write_text(OBLIQUE)
    (arm.parent / "truth.toml").write_text(TRUTH.replace("planar2r", "robot.toml"))
    for target in (("-o", "arm/robot.toml"), ("-o", "x.csv", "--json", "arm/robot.toml")):
        done = run("simulate", "arm/truth.toml", "--poses", "poses.csv", *target)
        assert_users_mistake(
            done, f"arm/robot.toml is read by this command: choose another place with {target[-2]}"
        )
    assert arm.read_text() == OBLIQUE
    assert not (place / "x.csv").exists()


def test_deciding_poses_do_not_replace_the_data_beside_their_verdict(run: Run, place: Path) -> None:
    (place / "out").mkdir()
    (place / "out" / "verdict.json").write_text("{}")
    (place / "out" / "taken.csv").write_text(POSES)
    plan = ("plan", "planar2r", "--poses", "3", "--separate", "out/verdict.json", "-o", "out/taken.csv")
    assert_users_mistake(run(*plan), "out/taken.csv is read by this command")
    assert (place / "out" / "taken.csv").read_text() == POSES


SEPARATE = [
    ("--criterion", "A"), ("--test-poses", "t.csv"), ("--steps", "2"), ("--levels", "q1=2"), ("--fixed", "q1=0"),
    ("--no-refine",), ("--cluster", "tcp://host:1"), ("--plot", "x.png"), ("--candidates", "5"),
]  # fmt: skip


@pytest.mark.parametrize("option", SEPARATE, ids=lambda o: o[0])
def test_options_that_deciding_poses_do_not_follow_are_refused(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run("plan", "planar2r", "--poses", "3", "--separate", "verdict.json", "-o", "x.csv", *option)
    assert_users_mistake(done, f"{option[0]} has no effect with --separate")


@pytest.mark.parametrize(
    "option", [("--robust",), ("--physical",), ("--held-out", "0.3"), ("--reconstruct", "r")]
)
def test_options_for_deflections_are_refused_for_absolute_positions(
    run: Run, place: Path, option: tuple[str, ...]
) -> None:
    (place / "truth.toml").write_text(TRUTH + '[measure]\nkind = "absolute"\n')
    assert run("simulate", "truth.toml", "--poses", "poses.csv", "-o", "positions.csv").code == 0
    done = run("identify", "planar2r", "positions.csv", "-o", "m.toml", *option)
    assert_users_mistake(done, option[0], "absolute positions: leave it out")
    assert not (place / "m.toml").exists()


def test_rotations_alone_have_no_share_of_the_deflection(run: Run, place: Path) -> None:
    (place / "truth.toml").write_text(TRUTH + 'sigma_mrad = 0.01\n[measure]\ncomponents = "pose"\n')
    assert run("simulate", "truth.toml", "--poses", "poses.csv", "-o", "data.csv").code == 0
    rows = list(csv.reader(io.StringIO((place / "data.csv").read_text())))
    kept = [k for k, header in enumerate(rows[0]) if not header.endswith("[mm]")]
    text = "".join(",".join(row[k] for k in kept) + "\n" for row in rows)
    (place / "data.csv").write_text(text)
    done = run(*IDENTIFY)
    assert done.code == 0, done.err
    assert "rz [mrad]" in done.out
    assert "nan" not in done.out


def test_a_missing_joint_column_is_said_as_simulate_says_it(run: Run, place: Path) -> None:
    rows = list(csv.reader(io.StringIO((place / "data.csv").read_text())))
    short = [
        [cell for header, cell in zip(rows[0], row, strict=True) if not header.startswith("q2")]
        for row in rows
    ]
    (place / "short.csv").write_text("".join(",".join(row) + "\n" for row in short))
    for arguments in (("identify", "-o", "m.toml"), ("diagnose", "-o", "out")):
        done = run(arguments[0], "planar2r", "short.csv", *arguments[1:])
        assert_users_mistake(done, "short.csv: line 2: 1 joint columns, robot planar2r has 2 joints")


def test_mistakes_in_tables_name_file_and_line(run: Run, place: Path) -> None:
    (place / "bare.csv").write_text("pose,q1[deg],q2[deg]\na,0,10\n")
    done = run("simulate", "truth.toml", "--poses", "bare.csv", "-o", "x.csv")
    assert_users_mistake(done, "bare.csv: line 2: every wrench is zero")
    (place / "other.csv").write_text("q1[deg],q2[deg],q3[deg],fx[N]\n0,10,0,5\n")
    done = run(
        "plan", "planar2r", "--poses", "9", "--test-poses", "other.csv", "--criterion", "test", "-o", "x.csv"
    )
    assert_users_mistake(done, "other.csv: line 2: 3 joint columns")
    text = (place / "data.csv").read_text().splitlines()
    marked = [f"{line},{'point' if k == 0 else 'zz'}" for k, line in enumerate(text)]
    (place / "marked.csv").write_text("\n".join(marked) + "\n")
    done = run("identify", "planar2r", "marked.csv", "-o", "m.toml")
    assert_users_mistake(done, "marked.csv: line 2: robot planar2r has no marker 'zz'")


def test_text_of_users_is_no_markup(run: Run, place: Path) -> None:
    (place / "robot.toml").write_text(OBLIQUE.replace('"oblique"', '"oblique"\ntitle = "KR [/b] 270 :x:"'))
    assert "KR [/b] 270 :x:" in run("inspect", "robot.toml").out
    assert run(*IDENTIFY).code == 0
    (place / "way.csv").write_text(POSES.replace("a0", "[/x]"))
    done = run("compensate", "m.toml", "way.csv", "-o", "d[bold]y.csv")
    assert (done.code, "wrote d[bold]y.csv" in done.out) == (0, True)
    rows = (place / "data.csv").read_text().splitlines()
    again = rows[1].replace("a0", "[/x]").replace(",0.01,", "1,0.01,", 1)  # the last reading differs: no copy
    (place / "twice.csv").write_text("\n".join([*rows, again]) + "\n")
    done = run("identify", "planar2r", "twice.csv", "--start", "joints", "-o", "m.toml")
    assert (done.code, "[/x] = a0" in done.out) == (0, True)


def test_targets_and_simulate_have_json(run: Run, place: Path) -> None:
    assert {t["target"] for t in json.loads(run("targets", "--json", "-").out)} >= {"c", "casadi"}
    found = run("simulate", "truth.toml", "--poses", "poses.csv", "-o", "x.csv", "--json", "-")
    record = json.loads(found.out)
    assert (record["robot"], record["kind"], record["rows"], record["components"]) == (
        "planar2r", "deflection", 6, ["x", "y", "z"],
    )  # fmt: skip


def test_an_outlier_is_told_by_its_line_and_a_row_without_load_by_its_own(run: Run, place: Path) -> None:
    lines = (place / "data.csv").read_text().splitlines()
    head = lines[0].split(",")
    cells = lines[6].split(",")
    cells[head.index("dy[mm]")] = str(float(cells[head.index("dy[mm]")]) + 3.0)
    lines[6] = ",".join(cells)
    (place / "bad.csv").write_text("\n".join(lines) + "\n")
    done = run("identify", "planar2r", "bad.csv", "--start", "joints", "--robust", "-o", "m.toml")
    assert done.code == 0
    assert "outlier: bad.csv: line 7, y: residuals" in " ".join(done.out.split())


def test_test_poses_without_a_load_are_refused(run: Run, place: Path) -> None:
    (place / "test.csv").write_text("pose,q1[deg],q2[deg]\na,10,20\nb,30,-20\n")
    done = run(
        "plan", "scara", "--poses", "9", "--criterion", "test", "--test-poses", "test.csv", "-o", "x.csv"
    )
    assert_users_mistake(done, "test.csv: line 2: 2 joint columns")
    (place / "test.csv").write_text("pose,q1[deg],q2[deg],q3[m],q4[deg]\na,10,20,0.05,0\nb,30,-20,0.1,9\n")
    done = run(
        "plan", "scara", "--poses", "40", "--criterion", "test", "--test-poses", "test.csv", "-o", "x.csv"
    )
    assert_users_mistake(done, "the test poses carry no load")
    (place / "test.csv").write_text("pose,q1[deg],q2[deg],q3[m],q4[deg],fx[N]\na,10,20,0.05,0,9\n")
    plan = (
        "plan",
        "scara",
        "--poses",
        "40",
        "--criterion",
        "test",
        "--test-poses",
        "test.csv",
        "-o",
        "x.csv",
    )
    done = run(*plan, "--loads", "gravity")
    assert_users_mistake(
        done, "test poses: the model is reduced for gravity loads (fz), and these have fx too"
    )
    done = run(*plan, "--loads", "force", "--fixed", "q3=0.1")
    assert_users_mistake(
        done, "test poses: the model was reduced for q3 = 0.1 m, and these poses have other values"
    )


FALLING = "pose,q1[deg],q2[deg],fz[N],dx[mm],dy[mm],dz[mm]\n" + "".join(
    f"p{k},{40 * k},{25 * k - 60},-100,0.01,0.02,{-0.5 + 0.02 * k}\n" for k in range(3)
)


@pytest.mark.parametrize(
    ("command", "remedy"),
    [
        (("generate", "flat.toml", "--loads", "gravity", "-o", "out"), "--loads force or wrench"),
        (("plan", "flat.toml", "--loads", "gravity", "--poses", "3", "-o", "out"), "--loads force or wrench"),
        (("effects", "flat.toml", "--loads", "gravity"), "--loads force or wrench"),
        (("footprint", "flat.toml", "--loads", "gravity"), "--loads force or wrench"),
        (("identify", "flat.toml", "falling.csv", "-o", "out"), "another template in the robot file"),
        (("diagnose", "flat.toml", "falling.csv", "-o", "out"), "another template in the robot file"),
        (("identify", "planar2r", "falling.csv", "--start", "joints", "-o", "out"), "--start complete"),
        (("diagnose", "planar2r", "falling.csv", "--start", "joints", "-o", "out"), "--start complete"),
    ],
)
def test_a_robot_that_no_such_load_bends_is_refused_by_every_command(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], remedy: str
) -> None:
    monkeypatch.chdir(tmp_path)
    row = '[[joint]]\na = 0.4\nalpha = 0\nd = 0\n[joint.link]\nbeam_axis = "x"\ntemplate = "rigid"\n'
    base = 'format = 1\nname = "flat"\n[base.link]\nbeam_axis = "z"\ntemplate = "rigid"\n'
    (tmp_path / "flat.toml").write_text(base + row + row)
    (tmp_path / "falling.csv").write_text(FALLING)
    assert_users_mistake(run(*command), "the model has no parameter", remedy)
    assert not (tmp_path / "out").exists()


def test_a_tool_on_the_axis_has_a_rotation_alone_to_show(run: Run, tmp_path: Path) -> None:
    head = 'format = 1\nname = "spindle"\n[base.link]\ntemplate = "rigid"\n'
    row = '[[joint]]\na = 0\nalpha = 0\nd = 0.2\n[joint.link]\ntemplate = "rigid"\n'
    (tmp_path / "spindle.toml").write_text(head + row)
    for loads, remedy in (
        ("wrench", "use --measure pose"),
        ("force", "use --loads wrench and --measure pose"),
    ):
        done = run("effects", tmp_path / "spindle.toml", "--loads", loads, "--measure", "position")
        assert_users_mistake(done, f"under {loads} loads nothing that bends in spindle", remedy)
    assert run("effects", tmp_path / "spindle.toml", "--loads", "wrench", "--measure", "pose").code == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"where": 5}, {"parameters": 5}, {"parameters": {"backlash_2_gap": 5}}, {"set": [1]}, {"shape": 5},
        {"parameters": {"backlash_2_gap": {"value": "x"}}}, {"where": {"joint": 9}},
        {"effect": "bad_poses", "where": {}}, {"effect": "bad_poses", "where": {"rows": 5}},
    ],
)  # fmt: skip
def test_a_verdict_with_an_entry_that_is_none_is_refused_by_name(
    run: Run, tmp_path: Path, wrong: dict[str, object]
) -> None:
    entries = [{"effect": "backlash", "where": {"joint": j}, "set": j} for j in (1, 2)]
    verdict = tmp_path / "v.json"
    verdict.write_text(json.dumps({"robot": "planar2r", "effects": [entries[0], entries[1] | wrong]}))
    done = run("plan", "planar2r", "--poses", "3", "--separate", verdict, "-o", tmp_path / "x.csv")
    assert_users_mistake(done, "v.json")
    verdict.write_text(json.dumps({"robot": "planar2r", "effects": entries, "model": {"values": 5}}))
    done = run("plan", "planar2r", "--poses", "3", "--separate", verdict, "-o", tmp_path / "x.csv")
    assert_users_mistake(done, "v.json", "model")


@pytest.mark.parametrize(
    ("option", "value"), [("--candidates", "99999999999"), ("--steps", "100000000"), ("--floor", "nan")]
)
def test_a_plan_that_no_memory_holds_or_a_floor_that_is_nowhere_is_refused_by_its_option(
    run: Run, tmp_path: Path, option: str, value: str
) -> None:
    done = run("plan", "planar2r", "--poses", "8", option, value, "-o", tmp_path / "x.csv")
    assert_users_mistake(done, f"{option} {value}")
