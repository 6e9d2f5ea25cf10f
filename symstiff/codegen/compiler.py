"""The C compiler of the machine, or the one of the ziglang wheel, or none."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

STRICT = (
    "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Werror",
)  # fmt: skip


@dataclass(frozen=True)
class Compiler:
    """A command that compiles C."""

    command: tuple[str, ...]

    @property
    def name(self) -> str:
        """How to call it in a message."""
        return Path(self.command[0]).name if len(self.command) == 1 else "zig cc"

    def run(self, arguments: Sequence[str], cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        """Run it; the caller looks at the return code."""
        return subprocess.run(
            [*self.command, *arguments], cwd=cwd, capture_output=True, text=True, check=False, timeout=300
        )


def find_compiler() -> Compiler | None:
    """$CC, cc, gcc, clang, then zig's compiler from its wheel."""
    wanted = os.environ.get("CC", "").split()
    if wanted and shutil.which(wanted[0]):
        return Compiler(tuple(wanted))
    for name in ("gcc", "cc", "clang"):
        if shutil.which(name):
            return Compiler((name,))
    if importlib.util.find_spec("ziglang") is not None:
        return Compiler((sys.executable, "-m", "ziglang", "cc"))
    return None
