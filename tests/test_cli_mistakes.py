"""The command line and mistakes: one line with place, cause and remedy, exit code 2, nothing half-written."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import (
    IDENTIFY,
    OBLIQUE,
    POSES,
    TRUTH,
    Run,
    assert_users_mistake,
    run_command_line,  # noqa: F401
)

GOOD = OBLIQUE.strip()
SPOILT = {
    "malformed": (GOOD.replace("a = 0.5", "a = ="), "not valid TOML"),
    "unknown_key": (GOOD.replace("a = 0.4", "aa = 0.4"), "unknown key"),
    "degrees": (GOOD.replace('"pi/2"', "90"), "looks like degrees"),
    "code": (GOOD.replace('"pi/2"', "\"__import__('os')\""), "cannot read"),
    "bad_name": (GOOD.replace('"oblique"', '"2-links"'), "is no identifier"),
    "no_joints": (GOOD[: GOOD.index("[[joint]]")] + "joint = []", "at least one"),
    "missing_row": (GOOD.replace("a = 0.4\n", ""), "joint[2].a: missing"),
    "not_finite": (GOOD.replace("d = 0.2", "d = inf"), "finite"),
    "binary": ("\udcff\udcfe", "not a text file"),
    "200_joints": (GOOD + '\n[[joint]]\na = 0.1\nalpha = "pi/2"\nd = 0' * 198, "at most 64"),
}


@pytest.mark.parametrize("case", SPOILT)
@pytest.mark.parametrize("command", ["inspect", "generate"])
def test_a_spoilt_robot_file_is_one_line_and_nothing_is_written(
    run: Run, tmp_path: Path, case: str, command: str
) -> None:
    text, words = SPOILT[case]
    robot = tmp_path / "robot.toml"
    robot.write_bytes(text.encode("utf-8", "surrogateescape"))
    target = ("-o", tmp_path / "out") if command == "generate" else ("--json", tmp_path / "out.json")
    assert_users_mistake(run(command, robot, *target), "robot.toml", words)
    assert [p.name for p in tmp_path.iterdir()] == ["robot.toml"]


BAD_OPTIONS = [
    (("inspect", "nowhere.toml"), ("nowhere.toml", "no such robot file")),
    (("inspect", "."), ("is a directory",)),
    (("identify", "planar2r", "d.csv", "-o", "-"), ("-o -: only --json writes to the screen",)),
    (("diagnose", "planar2r", "d.csv", "-o", ""), ("'--output': expected a folder, found no name",)),
    (("inspect", "planar2r", "--loads", "weight"), ("--loads: unknown 'weight'", "wrench, force, gravity")),
    (("plan", "planar2r", "--poses", "5", "--force", "1e12", "-o", "p.csv"), ("1e+12 N", "up to 1e+07")),
    (
        ("plan", "planar2r", "--poses", "5", "--loads", "force", "--moment", "3", "-o", "p.csv"),
        ("--moment has no effect with --loads force", "--loads wrench"),
    ),
    (("inspect", "planar2r", "--measure", "angle"), ("--measure: unknown", "pose, position")),
    (("inspect", "planar2r", "--fixed", "q9=0"), ("cannot fix q9",)),
    (("inspect", "planar2r", "--fixed", "q1"), ("--fixed",)),
    (("inspect", "planar2r", "--fixed", "q1=__import__('os')"), ("cannot read",)),
    (("inspect", "planar2r", "--fixed", "q1=nan"), ("finite",)),
    (("inspect", "planar2r", "--fixed", "q²=0"), ("--fixed",)),
    (("inspect", "planar2r", "--fixed", "q1=0,q1=1"), ("q1",)),
    (("inspect", "planar2r", "--fixed", "q1=90"), ("degrees",)),
    (("inspect", "planar2r", "--prefer", "k9_11"), ("k9_11",)),
    (("inspect", "planar2r", "--avoid", "k9_11"), ("k9_11",)),
    (("inspect", "planar2r", "--avoid", "k1_11", "--prefer", "k1_11"), ("k1_11", "prefer it or avoid it")),
    (("generate", "planar2r", "--precision", "half"), ("--precision: unknown 'half'", "double or float")),
    (("generate", "planar2r", "--targets", "c,fortran"), ("--targets: unknown", "fortran")),
    (("generate", "planar2r", "--targets", ""), ("target",)),
    (("generate", "planar2r", "--layout", "round"), ("--layout: unknown",)),
    (("generate", "planar2r", "--loads", "weight"), ("--loads: unknown",)),
    (("generate", "planar2r", "--model", "none.toml"), ("none.toml",)),
    (("plan", "planar2r", "--poses", "0", "-o", "p.csv"), ("--poses: expected",)),
    (("plan", "planar2r", "--poses", "1e3", "-o", "p.csv"), ("'--poses': expected a whole number:",)),
    (
        ("plan", "planar2r", "--poses", "9", "--force", "1kN", "-o", "p.csv"),
        ("'--force': expected a number:",),
    ),
    (
        ("plan", "planar2r", "--poses", "9", "--seed", "-1", "-o", "p.csv"),
        ("'--seed': expected a number greater",),
    ),
    (("plan", "scara", "--poses", "1", "-o", "p.csv"), ("1 pose for",)),
    (("plan", "planar2r", "--poses", "30000", "-o", "p.csv"), ("--candidates: 20000 are too few",)),
    (("plan", "planar2r", "--poses", "9", "--levels", "q2=0", "-o", "p.csv"), ("--levels: q2: expected",)),
    (
        ("plan", "planar2r", "--poses", "9", "--levels", "q9=3", "-o", "p.csv"),
        ("--levels: q9", "joints 1 to 2"),
    ),
    (("plan", "planar2r", "--poses", "9", "--sigma", "-3", "-o", "p.csv"), ("--sigma -3", "millimetres")),
]


@pytest.mark.parametrize(("arguments", "words"), BAD_OPTIONS, ids=lambda a: " ".join(a))
def test_a_bad_option_is_one_line_and_nothing_is_written(
    run: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    output = ("-o", "out") if arguments[0] == "generate" else ()
    assert_users_mistake(run(*arguments, *output), *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("diagnose", "planar2r", "data.csv", "--max-effects", "0", "-o", "out"), "--max-effects: expected"),
        (("diagnose", "planar2r", "data.csv", "--max-poses", "1", "-o", "out"), "--max-poses: expected"),
        ((*IDENTIFY, "--per-level", "q9"), "--per-level: q9: planar2r has joints 1 to 2"),
        ((*IDENTIFY, "--held-out", "1.5"), "--held-out: 1.5 is no share"),
        ((*IDENTIFY, "--measure", "angle"), "--measure: unknown 'angle'"),
    ],
)
def test_what_the_library_says_of_an_argument_the_command_says_of_its_option(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in (("poses.csv", POSES), ("truth.toml", TRUTH)):
        (tmp_path / name).write_text(text)
    assert run("simulate", "truth.toml", "--poses", "poses.csv", "-o", "data.csv").code == 0
    mistake = run(*arguments)
    assert_users_mistake(mistake, says)
    assert mistake.err.startswith(f"symstiff: {says}")
    assert not {"out", "m.toml"} & {p.name for p in tmp_path.iterdir()}


def test_a_plan_for_too_few_points_says_how_to_go_on(run: Run, tmp_path: Path) -> None:
    one = ("plan", "scara", "--poses", "10", "--markers", "p1", "--measure", "pose")
    result = run(*one, "-o", str(tmp_path / "poses.csv"))
    assert_users_mistake(result, "no plan tells k0_22", "leave --measure out")
    assert list(tmp_path.iterdir()) == []


BAD_USAGE = [
    (("frob",), ("no such command 'frob'", "symstiff --help")),
    (("generate",), ("missing argument 'robot'", "symstiff generate --help")),
    (("diagnose", "planar2r"), ("missing argument 'data'", "symstiff diagnose --help")),
    (("inspect", "planar2r", "--json"), ("'--json' requires an argument", "symstiff inspect --help")),
    (("generate", "planar2r", "--frob", "1", "-o", "x"), ("--frob", "symstiff generate --help")),
    (("plan", "planar2r", "--poses", "few", "-o", "x"), ("--poses", "symstiff plan --help")),
]


@pytest.mark.parametrize(("arguments", "words"), BAD_USAGE, ids=lambda a: " ".join(a))
def test_a_wrong_call_is_one_line_that_points_to_help(
    run: Run, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    assert_users_mistake(run(*arguments), *words)


def test_no_arguments_show_help(run: Run) -> None:
    result = run()
    assert "diagnose" in result.out
    assert result.err == ""


def test_a_model_of_another_robot_or_class_is_refused(run: Run, tmp_path: Path) -> None:
    from symstiff.model import joints_only
    from symstiff.robot import load

    model, out = tmp_path / "model.toml", tmp_path / "out"
    joints_only(load("scara"), "gravity").save(model)
    assert_users_mistake(run("generate", "planar2r", "-o", out, "--model", model), "model of scara")
    wrong = run("generate", "scara", "-o", out, "--model", model, "--loads", "wrench")
    assert_users_mistake(wrong, "loads gravity")
    assert [p.name for p in tmp_path.iterdir()] == ["model.toml"]


@pytest.mark.parametrize("place", ["file", "file/out", "/proc/out"])
def test_a_folder_that_cannot_be_written_is_one_line(run: Run, tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("mine")
    target = place if place[0] == "/" else f"{tmp_path}/{place}"
    assert_users_mistake(run("generate", "planar2r", "-o", target, "--no-compile"))
    assert (tmp_path / "file").read_text() == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_folder_that_holds_something_else_is_left_alone(run: Run, tmp_path: Path) -> None:
    folder = tmp_path / "thesis"
    folder.mkdir()
    (folder / "chapter1.tex").write_text("years of work")
    assert_users_mistake(run("generate", "planar2r", "-o", folder, "--no-compile"), "chapter1.tex")
    assert [p.name for p in folder.iterdir()] == ["chapter1.tex"]
    assert [p.name for p in tmp_path.iterdir()] == ["thesis"]


@pytest.mark.parametrize("place", ["/proc/out.json", "file/out.json", ".", "missing/out.json"])
def test_a_json_file_that_cannot_be_written_is_one_line(run: Run, tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("mine")
    assert_users_mistake(run("robots", "--json", tmp_path / place), "cannot write")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_output_that_finds_no_room_is_no_fault_of_ours() -> None:
    full = Path("/dev/full")
    if not full.is_char_device():
        pytest.skip("no /dev/full on this machine")
    with full.open("w") as out:
        done = subprocess.run(
            [sys.executable, "-m", "symstiff", "robots"],
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr == "symstiff: No space left on device: make room where the output goes\n"


def test_a_device_is_written_to_and_never_replaced(run: Run, tmp_path: Path) -> None:
    """Through a link: should the program replace what it is given, it is the link that goes."""
    full, link = Path("/dev/full"), tmp_path / "full.json"
    if not full.is_char_device():
        pytest.skip("no /dev/full on this machine")
    link.symlink_to(full)
    mistake = run("robots", "--json", link)
    assert_users_mistake(mistake, "No space left on device: choose another place with --json")
    assert link.is_symlink()
    assert full.is_char_device()
    assert [p.name for p in tmp_path.iterdir()] == ["full.json"]


def test_a_pipe_gets_the_result(run: Run, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    assert run("robots", "--json", pipe).code == 0
    assert os.read(reader, 2) == b"[\n"
    os.close(reader)
    assert pipe.is_fifo()


def test_a_link_to_a_file_stays_a_link(run: Run, tmp_path: Path) -> None:
    (tmp_path / "there.json").write_text("old")
    (tmp_path / "link.json").symlink_to("there.json")
    assert run("robots", "--json", tmp_path / "link.json").code == 0
    assert (tmp_path / "link.json").is_symlink()
    assert json.loads((tmp_path / "there.json").read_text())


@pytest.mark.parametrize("allowed", [0, 1, 5, 9])
def test_a_disk_that_fills_up_leaves_nothing_behind(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, allowed: int
) -> None:
    real, written = Path.write_bytes, [0]

    def fill(self: Path, data: bytes) -> int:
        written[0] += 1
        if written[0] > allowed:
            real(self, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(self, data)

    monkeypatch.setattr(Path, "write_bytes", fill)
    result = run("generate", "planar2r", "-o", tmp_path / "new" / "out", "--no-compile")
    assert_users_mistake(result, "No space left on device")
    assert [p for p in tmp_path.rglob("*") if p.name != "new"] == []


def test_a_disk_that_fills_up_leaves_the_old_folder_as_it_was(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "out"
    assert run("generate", "planar2r", "-o", folder, "--no-compile").code == 0
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    def full(self: Path, data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    assert_users_mistake(run("generate", "planar2r", "-o", folder, "--no-compile"), "No space left")
    monkeypatch.undo()
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
