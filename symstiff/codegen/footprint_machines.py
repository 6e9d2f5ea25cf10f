"""Machines that generated C is measured on: this one, and Cortex-M boards under QEMU."""

from __future__ import annotations

import platform
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from symstiff.codegen.emit import templates


@dataclass(frozen=True)
class Machine:
    """A compiler with its flags, and the emulated board that runs what it makes (none: this machine)."""

    name: str
    compiler: str
    flags: tuple[str, ...] = ()
    board: str = ""
    doubles: bool = True

    @property
    def missing(self) -> str:
        """The first tool that is not installed, or nothing."""
        tools = (self.compiler, "qemu-system-arm") if self.board else (self.compiler,)
        return next((t for t in tools if shutil.which(t) is None), "")

    def compile(self, arguments: Sequence[str], cwd: Path) -> None:
        """Run the compiler. Raises RuntimeError with its message."""
        command = [self.compiler, *self.flags, "-std=c99", "-O2", *arguments]
        done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=300)
        if done.returncode:
            raise RuntimeError(f"{self.compiler}: {done.stderr[:2000]}")

    def link_board(self, arguments: Sequence[str], program: str, cwd: Path) -> None:
        """Compile and link a program for the board."""
        support = templates() / "footprint"
        board = [
            "-DBOARD",
            "-nostartfiles",
            "--specs=nosys.specs",
            f"-T{support / 'board.ld'}",
            f"-I{support}",
        ]
        self.compile([*board, *arguments, str(support / "startup.c"), "-o", program, "-lm"], cwd)

    def run_board(self, program: Path) -> subprocess.CompletedProcess[str]:
        """Run a program on the board; one instruction takes a nanosecond of the board's time."""
        command = [
            "qemu-system-arm",
            "-machine",
            self.board,
            "-icount",
            "shift=0",
            "-nographic",
            "-monitor",
            "none",
        ]
        command += ["-semihosting-config", "enable=on,target=native", "-kernel", str(program)]
        return subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,  # where semihosting writes
            text=True,
            check=False,
            timeout=120,
        )

    def version(self) -> str:
        """The compiler's version, in a word."""
        done = subprocess.run(
            [self.compiler, "-dumpfullversion"], capture_output=True, text=True, check=False, timeout=60
        )
        return f"{self.compiler} {done.stdout.strip()}"


HOST = Machine({"AMD64": "x86-64", "x86_64": "x86-64"}.get(platform.machine(), platform.machine()), "gcc")
CORTEX_M7 = Machine(
    "cortex-m7",
    "arm-none-eabi-gcc",
    ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"),
    "mps2-an500",
)
CORTEX_M4F = Machine(
    "cortex-m4f",
    "arm-none-eabi-gcc",
    ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
    "mps2-an386",
    doubles=False,
)
MACHINES = (HOST, CORTEX_M7, CORTEX_M4F)
