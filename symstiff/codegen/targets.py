"""What can be emitted: one line a target; its module is imported only when it is asked for.

An emitter is a function (Functions, Options) → {file name: bytes}; it walks Programs and fills templates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options

Emitter = Callable[["Functions", "Options"], dict[str, bytes]]


@dataclass(frozen=True)
class Target:
    """Where a target's emitter is, what it writes, and whether it needs the C sources beside it.

    parts: endings of the C sources and headers that join the library and its installation (``_params.c``).
    """

    module: str
    function: str
    writes: str
    needs_c: bool = False
    parts: tuple[str, ...] = ()

    def emitter(self) -> Emitter:
        """Import and return the emitter."""
        return getattr(import_module(self.module), self.function)  # type: ignore[no-any-return]

    def files(self, name: str, end: str) -> list[str]:
        """Names of the parts that are sources (``.c``) or headers (``.h``) of the library."""
        return [name + part for part in self.parts if part.endswith((".h", ".hpp")) == (end == ".h")]


TARGETS: dict[str, Target] = {
    "c": Target("symstiff.codegen.emit", "emit_c", "C99 sources, self-test, CMake and pkg-config files"),
    "casadi": Target("symstiff.codegen.casadi", "emit_casadi", "CasADi functions (always double precision)"),
    "params": Target(
        "symstiff.codegen.params",
        "emit_params",
        "reader of parameter values at start-up",
        True,
        ("_params.c", "_params.h"),
    ),
    "rls": Target("symstiff.codegen.rls", "emit_rls", "recursive least squares", True, ("_rls.c", "_rls.h")),
    "cpp": Target(
        "symstiff.codegen.wrappers", "emit_cpp", "C++17 header over the C functions", True, (".hpp",)
    ),
    "python": Target(
        "symstiff.codegen.wrappers", "emit_python", "Python module over the compiled library", True
    ),
    "fmi2": Target("symstiff.codegen.fmi", "emit_fmi2", "FMI 2.0 co-simulation FMU"),
    "fmi3": Target("symstiff.codegen.fmi", "emit_fmi3", "FMI 3.0 co-simulation FMU"),
    "st": Target("symstiff.codegen.structured_text", "emit_st", "IEC 61131-3 function block"),
}
