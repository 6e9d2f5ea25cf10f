"""Encodings that lack a character, commands that are stopped, readers that go away."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_line import IDENTIFY, Run, measured_arm, run_command_line  # noqa: F401

from symstiff.cli.plain import plain


@pytest.mark.parametrize("command", [("robots",), ("inspect", "planar2r")])
def test_characters_that_an_encoding_lacks_stop_no_command(command: tuple[str, ...]) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": "cp1252"}
    for extra in ((), ("--json", "-")):
        done = subprocess.run(
            [sys.executable, "-m", "symstiff", *command, *extra],
            capture_output=True,
            env=environment,
            check=False,
        )
        assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)  # the last one: whole in any encoding


def test_what_is_printed_to_a_closed_output_goes_nowhere() -> None:
    for extra in ("", "--json -"):
        command = f"exec '{sys.executable}' -m symstiff robots {extra} >&-"
        done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
        assert done.returncode == 0
        assert ("planar2r" in done.stderr) == bool(extra)  # the table makes room for JSON


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "cp437", "latin-1"])
def test_signs_and_exponents_are_told_in_every_encoding(encoding: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "symstiff", "inspect", "kuka_kr270", "--loads", "gravity"],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": encoding},
        check=True,
    )
    shown = done.stdout.decode(encoding)
    assert "(k0_44 + k0_55 - k1_66 - k1_44)/a_1 - a_1*k0_33" in shown.replace("·", "*")
    assert "?" not in shown
    text = plain("(2.64 ± 0.11)·10⁻⁷ rad, 1.5·10¹⁵, −τ₁², σ ≤ π, Größe", encoding)
    written = text.encode(encoding).decode(encoding).replace("·", "*").replace("±", "+-")
    assert written.startswith("(2.64 +- 0.11)*10^-7 rad, 1.5*10^15, -")
    assert written.endswith("Gr??e" if encoding == "ascii" else "Größe")


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_stopped_command_leaves_nothing_behind(tmp_path: Path, number: signal.Signals, code: int) -> None:
    program = (
        "import signal, sys, time\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell's background
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"  # nohup
        "from symstiff.cli import main\nimport symstiff.codegen.generate as g\n"
        "def slow(*_):\n    print('now', flush=True)\n    time.sleep(60)\n"
        "g.write_tree = slow\nsys.argv = ['symstiff', 'generate', 'planar2r', '-o', 'out']\nmain()\n"
    )
    job = subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert job.stdout is not None
    while "now" not in (line := job.stdout.readline()):
        assert line or job.poll() is None
    time.sleep(0.05)
    job.send_signal(number)
    _, err = job.communicate(timeout=30)
    assert job.returncode == code
    assert err.strip() == ("symstiff: interrupted" if number == signal.SIGINT else "")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_that_an_import_makes_another_error_of_is_an_interrupt(tmp_path: Path) -> None:
    """Libraries in C end their import with an ImportError."""
    program = (
        "import os, signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from symstiff.cli import main\nimport symstiff.codegen.generate as g\n"
        "def importing(*_):\n    try:\n        os.kill(os.getpid(), signal.SIGINT)\n        sum(range(10**6))\n"
        "    except KeyboardInterrupt:\n        pass\n    raise ImportError('failed to import')\n"
        "g.write_tree = importing\nsys.argv = ['symstiff', 'generate', 'planar2r', '-o', 'out']\nmain()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr.strip()) == (130, "symstiff: interrupted")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "written"),
    [
        (("generate", "planar2r", "--no-compile", "-o", "out"), "out"),
        (("identify", "planar2r", "data.csv", "--start", "joints", "-o", "out"), "out"),
        (("diagnose", "planar2r", "data.csv", "--start", "joints", "-o", "out"), "out"),
        (("plan", "planar2r", "--poses", "9", "--candidates", "128", "-o", "out"), "out"),
        (("simulate", "truth.toml", "--poses", "poses.csv", "-o", "out"), "out"),
        (("compensate", "model.toml", "poses.csv", "-o", "out"), "out"),
        (("inspect", "planar2r"), "j.json"),
        (("robots",), "j.json"),
        (("targets",), "j.json"),
    ],
    ids=lambda a: a[0],
)
def test_a_reader_that_goes_away_costs_no_file(
    run: Run, place: Path, arguments: tuple[str, ...], written: str
) -> None:
    if arguments[0] == "compensate":
        assert run(*IDENTIFY[:-1], "model.toml").code == 0
    code, err = without_reader(place, *arguments, "--json", "j.json")
    assert (code, err) == (141, "")
    assert (place / written).exists()
    assert json.loads((place / "j.json").read_text())


@pytest.mark.parametrize("arguments", [("robots", "--json", "-"), ("--help",), ("plan", "--help")])
def test_a_reader_that_goes_away_is_no_fault_of_ours(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    code, err = without_reader(tmp_path, *arguments)
    assert code == 141
    assert "symstiff:" not in err
    assert "Error" not in err


def without_reader(folder: Path, *arguments: str) -> tuple[int, str]:
    """Exit code and standard error of a command that writes into a pipe which nobody reads."""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "symstiff", *arguments],
        cwd=folder,
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(write)
    return done.returncode, done.stderr
