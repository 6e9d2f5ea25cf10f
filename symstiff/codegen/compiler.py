"""The C compiler of the machine, or the one of the ziglang wheel, or none."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

STRICT = (
    "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror",
)  # fmt: skip

_ZIG = (sys.executable, "-m", "ziglang", "cc")
_TRIAL = "#include <math.h>\ndouble trial(double x);\ndouble trial(double x) { return sin(x); }\n"


@dataclass(frozen=True)
class Compiler:
    """A command that compiles C."""

    command: tuple[str, ...]

    @property
    def name(self) -> str:
        """How to call it in a message."""
        if self.command == _ZIG:
            return "zig cc"
        return " ".join([Path(self.command[0]).name, *self.command[1:]])

    @property
    def chosen(self) -> bool:
        """Whether the user asked for it by $CC."""
        return self.command == _wanted()

    def run(self, arguments: Sequence[str], cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        """Run it; the caller looks at the return code."""
        return subprocess.run(
            [*self.command, *arguments], cwd=cwd, capture_output=True, text=True, check=False, timeout=300
        )


def find_compiler() -> Compiler | None:
    """$CC alone where it is set, else the first of gcc, cc, clang and zig's wheel that serves this machine."""
    wanted = _wanted()
    candidates = [wanted] if wanted else _usual()
    return next((Compiler(command) for command in candidates if _serves(command)), None)


def _usual() -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = [(name,) for name in ("gcc", "cc", "clang") if shutil.which(name)]
    return [*found, _ZIG] if importlib.util.find_spec("ziglang") is not None else found


def why_none() -> str:
    """Why ``find_compiler`` finds none, for messages."""
    return "$CC does not make programs for this machine" if _wanted() else "no C compiler was found"


def ignored() -> str:
    """$CC where it names no command of this machine; empty otherwise."""
    return os.environ.get("CC", "") if not _wanted() else ""


def _wanted() -> tuple[str, ...]:
    """The words of $CC; none where it names no command of this machine."""
    try:
        words = shlex.split(os.environ.get("CC", ""))
    except ValueError:  # an open quote
        return ()
    return tuple(words) if words and shutil.which(words[0]) else ()


@cache
def _serves(command: tuple[str, ...]) -> bool:
    """Whether a library that the command builds can be loaded here; tried once, in a process of its own."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "trial.c").write_text(_TRIAL)
        build = ["-std=c99", *shared_flags(), "trial.c", "-o", "trial.so", "-lm"]
        load = [sys.executable, "-I", "-S", "-c", "import ctypes, sys; ctypes.CDLL(sys.argv[1])"]
        try:
            if Compiler(command).run(build, folder).returncode != 0:
                return False
            done = subprocess.run(
                [*load, str(folder / "trial.so")], capture_output=True, check=False, timeout=60
            )
        except (OSError, subprocess.SubprocessError):
            return False
        return done.returncode == 0


def shared_flags() -> list[str]:
    """What makes a compiler build a shared library for this system."""
    return ["-shared"] if sys.platform == "win32" else ["-fPIC", "-shared"]
