"""The command line in a test: run it in this process, and what a user's mistake looks like."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from symstiff.cli import main

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


POSES = "pose,q1[deg],q2[deg],fx[N],fy[N]\n" + "".join(
    f"a{k},{10 * k},{30 + 7 * k * k},{100 - 10 * k},{50 + 9 * k}\n" for k in range(6)
)
TRUTH = 'format = 1\nrobot = "planar2r"\n[noise]\nsigma_mm = 0.01\n'
IDENTIFY = ("identify", "planar2r", "data.csv", "--start", "joints", "-o", "m.toml")


@dataclass(frozen=True)
class Result:
    code: int
    out: str
    err: str


Run = Callable[..., Result]


@pytest.fixture(name="run")
def run_command_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Run:
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


@pytest.fixture(name="place")
def measured_arm(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the measurements of a planar arm."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "truth.toml").write_text(TRUTH)
    (tmp_path / "poses.csv").write_text(POSES)
    assert run("simulate", "truth.toml", "--poses", "poses.csv", "-o", "data.csv").code == 0
    return tmp_path


def assert_users_mistake(result: Result, *words: str) -> None:
    assert result.code == 2, result
    lines = result.err.splitlines()
    assert len(lines) == 1, result.err
    assert result.out[:1] != "\n"
    assert lines[0].startswith("symstiff: ")
    for word in words:
        assert word in lines[0]
