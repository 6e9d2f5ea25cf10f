"""The command line: help, JSON contract, exit codes, generated folders."""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import OBLIQUE, Result, Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.robot import library

COMMANDS = (
    "robots",
    "inspect",
    "effects",
    "generate",
    "targets",
    "plan",
    "simulate",
    "identify",
    "diagnose",
    "compensate",
    "footprint",
    "reproduce",
)


# --- help and imports ------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS)
def test_every_commands_help_has_an_example(run: Run, command: str) -> None:
    result = run(command, "--help")
    assert result.code == 0
    assert f"Example: symstiff {command}" in re.sub(r"\x1b\[[0-9;]*m", "", result.out)


def test_help_lists_every_command_and_imports_nothing_heavy() -> None:
    code = (
        "import sys; from symstiff.cli import main; sys.argv = ['symstiff', '--help']\n"
        "try: main()\nexcept SystemExit as e: code = e.code\n"
        "heavy = {'sympy', 'casadi', 'pandas', 'matplotlib', 'scipy', 'numpy', 'pydantic'} & set(sys.modules)\n"
        "print('imported', code, sorted(heavy), file=sys.stderr)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert all(command in result.stdout for command in COMMANDS)
    assert result.stderr.strip().splitlines()[-1] == "imported 0 []"


def test_the_module_runs_and_says_its_version() -> None:
    from symstiff import __version__

    arguments = [sys.executable, "-m", "symstiff", "--version"]
    assert subprocess.run(arguments, capture_output=True, text=True, check=True).stdout.strip() == __version__


# --- what commands say -----------------------------------------------------------------------------------


def test_robots_lists_the_library_with_joints_reach_and_source(run: Run) -> None:
    result = run("robots", "--json", "-")
    rows = json.loads(result.out)
    assert tuple(row["robot"] for row in rows) == library()
    assert all(row["dof"] > 1 and 0.5 < row["reach"] < 4 and row["source"] for row in rows)
    assert all(name in run("robots").out for name in library())


def test_inspect_json_has_the_contracts_keys_and_the_seeds_numbers(run: Run, tmp_path: Path) -> None:
    target = tmp_path / "kr270.json"
    result = run("inspect", "kuka_kr270", "--loads", "gravity", "--measure", "pose", "--json", target)
    assert result.code == 0
    found = json.loads(target.read_text())
    assert found["robot"] == "kuka_kr270"
    assert (found["loads"], found["measure"], found["rank"]) == ("gravity", "pose", 26)
    counts = {"original": 258, "M1": 153, "M2": 62, "M3": 56, "M4": 46, "M5": 26}
    assert found["stages"] == [{"step": step, "parameters": n} for step, n in counts.items()]
    assert found["groups"]["G1"] == ["k0_35"]
    assert {k: len(v) for k, v in found["groups"].items()} == {"G1": 1, "G2": 10, "G3": 45}
    assert len(found["parameters"]) == 26
    assert found["couplings"]["k2_26"]["k0_33"] == "-5/4"
    assert found["couplings_symbolic"]["k2_26"]["k0_33"] == "-a_2"
    assert found["inexact_aggregations"] == []
    for row in found["couplings"].values():
        assert set(row) <= set(found["parameters"])
        assert all(re.fullmatch(r"-?\d+(/\d+)?", c) for c in row.values())
    for number in counts.values():
        assert str(number) in result.out


def test_inspect_keeps_standard_output_for_json_alone(run: Run) -> None:
    result = run("inspect", "planar2r", "--json", "-")
    assert json.loads(result.out)["robot"] == "planar2r"
    assert "planar" in result.err.lower()


def test_inspect_prints_what_it_knows_before_the_closed_forms_that_take_time(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(reduction: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("symstiff.reduction.closed_form.closed_form", stopped)
    result = run("inspect", "planar2r")
    assert result.code == 130
    assert "M5" in result.out
    assert "identifiable set (12)" in result.out
    assert "couplings" not in result.out


def test_inspect_shows_on_a_terminal_what_it_is_at() -> None:
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "symstiff", "inspect", "planar2r"]
    with subprocess.Popen(command, stdout=theirs, stderr=theirs, env=os.environ | {"TERM": "xterm"}) as done:
        os.close(theirs)
        seen = b""
        with contextlib.suppress(OSError):  # how a terminal ends on Linux
            while part := os.read(ours, 4096):
                seen += part
    os.close(ours)
    assert done.returncode == 0
    stages = [seen.index(s) for s in (b"M5", b"couplings in closed form", b"eliminated")]
    assert stages == sorted(stages)


def test_inspect_takes_fixed_joints_and_wishes(run: Run) -> None:
    free = json.loads(run("inspect", "planar2r", "--json", "-").out)
    fixed = json.loads(run("inspect", "planar2r", "--fixed", "q2=pi/2", "--json", "-").out)
    assert fixed["fixed"] == {"q2": "pi/2"}
    assert fixed["rank"] < free["rank"]
    gone = next(iter(free["couplings"]))
    wished = json.loads(run("inspect", "planar2r", "--prefer", gone, "--json", "-").out)
    assert gone in wished["parameters"]


def test_inspect_warns_where_a_joint_is_not_in_its_links_template(run: Run, tmp_path: Path) -> None:
    robot = tmp_path / "oblique.toml"
    robot.write_text(OBLIQUE)
    text = " ".join(run("inspect", robot).out.split())
    assert "warning: M3 gives c2 to link 1" in text
    assert 'template = "full" in the link of joint 1' in text
    assert json.loads(run("inspect", robot, "--json", "-").out)["inexact_aggregations"] == ["c2"]
    robot.write_text(
        OBLIQUE.replace("beam_axis = [0.5, 0, 0.2]", 'beam_axis = [0.5, 0, 0.2]\ntemplate = "full"')
    )
    assert "warning" not in run("inspect", robot).out


def test_inspect_warns_of_angles_that_look_rounded_and_of_compliances_without_a_term(
    run: Run, tmp_path: Path
) -> None:
    robot = tmp_path / "rounded.toml"
    exact = (
        'format = 1\nname = "r"\n[[joint]]\na = 1\nalpha = "-pi/2"\nd = 0\n'
        "[joint.link.compliance]\n22 = 1e-8\n44 = 1e-8\n[[joint]]\na = 1\nalpha = 0\nd = 0\n"
    )
    robot.write_text(exact)
    assert "warning" not in run("inspect", robot).out
    robot.write_text(exact.replace('"-pi/2"', "-1.5707963267948966"))
    assert "warning" not in run("inspect", robot).out
    robot.write_text(exact.replace('"-pi/2"', "-1.5708").replace("44 = 1e-8", "44 = 1e-8\n24 = 1e-9"))
    text = " ".join(run("inspect", robot).out.split())
    assert 'warning: alpha of joint 1: -1.5708 is not quite -pi/2: write "-pi/2" where that is meant' in text
    assert (
        "warning: joint[1].link.compliance: 24 left out of the model, since template 'beam' has no such"
        in text
    )


@pytest.mark.slow
def test_what_a_reduction_cannot_hold_is_told_wherever_a_model_is_planned_or_fitted(
    run: Run, tmp_path: Path
) -> None:
    robot, poses, data, model = (
        tmp_path / n for n in ("oblique.toml", "poses.csv", "data.csv", "model.toml")
    )
    robot.write_text(OBLIQUE.replace("d = 0.2", "d = 0.2\ntheta = 1.5708"))
    (tmp_path / "truth.toml").write_text('format = 1\nrobot = "oblique.toml"\n[noise]\nsigma_mm = 0.01\n')
    rounded = 'theta of joint 1: 1.5708 is not quite pi/2: write "pi/2" where that is meant'
    planned = run("plan", robot, "--poses", 8, "--loads", "force", "--force", 100, "--no-refine", "-o", poses)
    surveyed = run("effects", robot, "--loads", "gravity", "--measure", "position")
    for seen in (planned, surveyed):
        assert f"warning: {rounded}" in " ".join(seen.out.split())
    measured = run("simulate", tmp_path / "truth.toml", "--poses", poses, "-o", data)
    assert 'positions of tcp; rotations too need components = "pose"' in " ".join(measured.out.split())
    for given in (("identify", robot, data, "-o", model), ("diagnose", robot, data, "-o", tmp_path / "out")):
        told = " ".join(json.loads(run(*given, "--json", "-").out)["remarks"])
        assert rounded in told
        assert "M3 gives c2 to link 1, whose template has no terms" in told
    robot.write_text(OBLIQUE.replace('"pi/2"', "1.5708"))
    assert_users_mistake(
        run("identify", robot, data, "-o", model), 'write "pi/2" where that is meant', "not told apart: k0_33"
    )


# --- effects ---------------------------------------------------------------------------------------------


def test_effects_tells_of_every_effect_what_such_data_can_show(run: Run) -> None:
    found = run("effects", "planar2r", "--loads", "gravity", "--measure", "position", "--json", "-")
    result = json.loads(found.out)
    assert (result["robot"], result["loads"], result["data"]) == ("planar2r", "gravity", "deflection")
    told = {e["effect"]: {json.dumps(p["where"]): p for p in e["places"]} for e in result["effects"]}
    # the planar arm lies flat: a vertical force turns no joint, and bends its links out of the plane
    assert told["backlash"]['{"joint": 1}']["reason"] == "no such load moves it"
    assert told["geometric_error"]['{"link": 1}']["reason"] == "cannot be seen in deflection data"
    assert told["force_sensor_bias"]['{"load": "force_sensor"}']["told"] > 0
    assert "(1–32 a turn)" in found.err
    absolute = json.loads(run("effects", "planar2r", "--data", "absolute", "--json", "-").out)["effects"]
    assert next(e for e in absolute if e["effect"] == "joint_offset")["places"][1]["told"] == 1


@pytest.mark.slow
def test_effects_says_of_a_link_that_the_model_has_most_of_it(run: Run) -> None:
    groups = json.loads(
        run("inspect", "kuka_kr270", "--loads", "gravity", "--measure", "position", "--json", "-").out
    )
    found = run("effects", "kuka_kr270", "--loads", "gravity", "--measure", "position", "--json", "-")
    (effect,) = (e for e in json.loads(found.out)["effects"] if e["effect"] == "link_compliance")
    base = next(p for p in effect["places"] if p["where"] == {"link": 0})
    assert base["in_model"] == [n for n in groups["parameters"] if n.startswith("k0_")]
    assert base["parameters"] == [n for n in groups["groups"]["G2"] if n.startswith("k0_")]
    assert base["reason"] == "the model has the others, and no such load moves the rest"


def test_effects_says_which_kinds_of_data_there_are(run: Run) -> None:
    assert_users_mistake(run("effects", "planar2r", "--data", "both"), "deflection or absolute")


def test_the_examples_of_plan_simulate_and_identify_work_in_sequence() -> None:
    """What the plan takes to be measured is what simulate writes by default: positions of markers."""
    from symstiff.cli.app import app

    examples = {c.callback.__name__: c.epilog for c in app.registered_commands if c.callback and c.epilog}
    assert "--markers p1,p2,p3 -o poses.csv" in examples["plan"]
    assert "--poses poses.csv" in examples["simulate"]
    assert "-o data.csv" in examples["simulate"]
    assert "data.csv" in examples["identify"]


# --- generate --------------------------------------------------------------------------------------------


def test_generate_writes_a_folder_with_the_contracts_manifest(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    result = run("generate", "planar2r", "-o", folder, "--no-compile")
    assert result.code == 0, result.err
    names = {p.name for p in folder.iterdir()}
    needed = {"planar2r.h", "planar2r.c", "planar2r_selftest.c", "main.c", "CMakeLists.txt", "README.md"}
    assert needed | {"model.toml", "manifest.json"} <= names
    assert list(folder.rglob("*.casadi"))
    manifest = json.loads((folder / "manifest.json").read_text())
    keys = {"generator", "robot", "model_hash", "options", "parameters", "default_parameters", "operations"}
    assert keys | {"verified"} <= set(manifest)
    assert len(manifest["parameters"]) == len(manifest["default_parameters"])
    assert {"add", "mul", "trig"} <= set(manifest["operations"]["deflection"])
    assert manifest["verified"]["compiled"] is False
    assert manifest["verified"]["max_relative_error"] < 1e-10
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    again = run("generate", "planar2r", "-o", folder, "--no-compile")
    assert again.code == 0  # its own folder may be written again


EMIT = (
    "import sys\nfrom symstiff.cli import main\n"
    "sys.argv = ['symstiff', 'generate', sys.argv[1], '-o', sys.argv[2], '--no-compile', '--loads', 'gravity']\n"
    "try: main()\nexcept SystemExit: pass\n"
)


@pytest.mark.slow
def test_fresh_interpreters_under_different_hash_seeds_write_the_same_bytes(tmp_path: Path) -> None:
    folders = []
    for seed in ("0", "1", "4242"):
        folders.append(tmp_path / seed)
        subprocess.run(
            [sys.executable, "-c", EMIT, "scara", str(folders[-1])],
            env={**os.environ, "PYTHONHASHSEED": seed},
            check=True,
            capture_output=True,
        )
    contents = [
        {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        for folder in folders
    ]
    assert len(contents[0]) > 8
    assert contents[0] == contents[1] == contents[2]


def test_a_fault_of_ours_is_one_line_and_exit_code_1(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("two\nlines")

    monkeypatch.setattr("symstiff.cli.show.show_robots", broken)
    result = run("robots")
    assert result.code == 1
    assert len(result.err.strip().splitlines()) == 1
    assert "a fault of ours (ZeroDivisionError: two lines)" in result.err
