"""The command line: help, JSON contract, exit codes, one line for every mistake, nothing half-written."""

from __future__ import annotations

import errno
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from symstiff.cli import main
from symstiff.robot import library

COMMANDS = (
    "robots",
    "inspect",
    "generate",
    "targets",
    "plan",
    "simulate",
    "identify",
    "diagnose",
    "compensate",
)


@dataclass(frozen=True)
class Result:
    code: int
    out: str
    err: str


Run = Callable[..., Result]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Run:
    """Run a command line in this process, through the entry point of the console script.

    Nothing outside the test's own folder can be replaced, whatever the program does.
    """
    replace = os.replace

    def guarded(source: Any, target: Any) -> None:
        assert Path(target).absolute().is_relative_to(tmp_path), f"would replace {target}"
        replace(source, target)

    monkeypatch.setattr(os, "replace", guarded)

    def _run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["symstiff", *map(str, arguments)])
        capsys.readouterr()
        code: Any = 0
        try:
            main()
        except SystemExit as exit_:
            code = exit_.code or 0
        out, err = capsys.readouterr()
        return Result(code, out, err)

    return _run


def assert_users_mistake(result: Result, *words: str) -> None:
    assert result.code == 2, result
    lines = [line for line in result.err.splitlines() if line.strip()]
    assert len(lines) == 1, result.err
    assert lines[0].startswith("symstiff: ")
    for word in words:
        assert word in lines[0]


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


def test_inspect_takes_fixed_joints_and_wishes(run: Run) -> None:
    free = json.loads(run("inspect", "planar2r", "--json", "-").out)
    fixed = json.loads(run("inspect", "planar2r", "--fixed", "q2=pi/2", "--json", "-").out)
    assert fixed["fixed"] == {"q2": "pi/2"}
    assert fixed["rank"] < free["rank"]
    gone = next(iter(free["couplings"]))
    wished = json.loads(run("inspect", "planar2r", "--prefer", gone, "--json", "-").out)
    assert gone in wished["parameters"]


OBLIQUE = """
format = 1
name = "oblique"
[[joint]]
a = 0.5
alpha = "pi/2"
d = 0.2
[joint.link]
beam_axis = [0.5, 0, 0.2]
[[joint]]
a = 0.4
alpha = 0
d = 0
[joint.link]
template = "rigid"
[tool]
xyz = [0.05, 0.1, 0.2]
"""


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


# --- mistakes --------------------------------------------------------------------------------------------

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
    (("inspect", "nowhere.toml"), ("nowhere.toml", "no such robot")),
    (("inspect", "."), ("is a directory",)),
    (("inspect", "planar2r", "--loads", "weight"), ("unknown loads", "wrench, force, gravity")),
    (("inspect", "planar2r", "--measure", "angle"), ("unknown measure", "pose, position")),
    (("inspect", "planar2r", "--fixed", "q9=0"), ("cannot fix q9",)),
    (("inspect", "planar2r", "--fixed", "q1"), ("--fixed",)),
    (("inspect", "planar2r", "--fixed", "q1=__import__('os')"), ("cannot read",)),
    (("inspect", "planar2r", "--fixed", "q1=nan"), ("finite",)),
    (("inspect", "planar2r", "--fixed", "q²=0"), ("--fixed",)),
    (("inspect", "planar2r", "--fixed", "q1=0,q1=1"), ("q1",)),
    (("inspect", "planar2r", "--fixed", "q1=90"), ("degrees",)),
    (("inspect", "planar2r", "--prefer", "k9_11"), ("k9_11",)),
    (("inspect", "planar2r", "--avoid", "k9_11"), ("k9_11",)),
    (("generate", "planar2r", "--precision", "half"), ("unknown precision", "double or float")),
    (("generate", "planar2r", "--targets", "c,fortran"), ("unknown target", "fortran")),
    (("generate", "planar2r", "--targets", ""), ("target",)),
    (("generate", "planar2r", "--layout", "round"), ("unknown layout",)),
    (("generate", "planar2r", "--loads", "weight"), ("unknown loads",)),
    (("generate", "planar2r", "--model", "none.toml"), ("none.toml",)),
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


def test_a_device_is_written_to_and_never_replaced(run: Run, tmp_path: Path) -> None:
    """Through a link: should the program replace what it is given, it is the link that goes."""
    full, link = Path("/dev/full"), tmp_path / "full.json"
    if not full.is_char_device():
        pytest.skip("no /dev/full on this machine")
    link.symlink_to(full)
    assert_users_mistake(run("robots", "--json", link), "No space left on device")
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


def test_a_fault_of_ours_is_one_line_and_exit_code_1(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("two\nlines")

    monkeypatch.setattr("symstiff.cli.show.show_robots", broken)
    result = run("robots")
    assert result.code == 1
    assert len(result.err.strip().splitlines()) == 1
    assert "a fault of ours (ZeroDivisionError: two lines)" in result.err
