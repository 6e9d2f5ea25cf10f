"""Shared libraries of models, built once and kept in a cache folder that only this user can write to."""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from symstiff.codegen.batch import batch_function, vector_context
from symstiff.codegen.compiler import Compiler, shared_flags
from symstiff.codegen.emit import environment
from symstiff.errors import UserError
from symstiff.symbolic.program import Program

if TYPE_CHECKING:
    from symstiff.model import StiffnessModel

_WIDE = ("-O3", "-march=native", "-mprefer-vector-width=512", "-ffp-contract=fast")
FLAGS = (_WIDE, ("-O3", "-march=native"), ("-O3",), ("-O2",))  # the first that the compiler takes
_LOADED: dict[str, ctypes.CDLL] = {}


def library(model: StiffnessModel, programs: Mapping[str, Program], compiler: Compiler) -> ctypes.CDLL:
    """The loaded library of a model; built where the cache has none. Raises UserError where it cannot be built."""
    source = c_source(model, programs)
    key = _key(source, compiler)
    if key not in _LOADED:
        path = _place(model, key)
        if not path.is_file():
            _build(source, path, compiler)
        try:
            _LOADED[key] = ctypes.CDLL(str(path))
        except OSError as error:
            raise UserError(f"the library that {compiler.name} built cannot be loaded: {error}") from error
    return _LOADED[key]


def is_built(model: StiffnessModel, programs: Mapping[str, Program], compiler: Compiler) -> bool:
    """Whether the library of a model needs no building."""
    return _place(model, _key(c_source(model, programs), compiler)).is_file()


def _place(model: StiffnessModel, key: str) -> Path:
    return cache_folder() / key / f"{model.robot.name}{_suffix()}"


def c_source(model: StiffnessModel, programs: Mapping[str, Program]) -> str:
    """The C text: the functions ``deflection`` and ``observation`` over strided arrays, in double precision."""
    batches = [
        batch_function(
            p, {"p": lambda k: f"p[{k}]"}, "const double *p", False, f"{name} of {model.robot.name}"
        )
        | {"name": name}
        for name, p in programs.items()
        if p.size(p.outputs[0][0])
    ]
    context = {"name": model.robot.name, "structure_hash": model.structure_hash}
    template = environment().get_template("c/runtime.c.j2")
    text: str = template.render({**context, "batches": batches, "v": vector_context(False)})
    return text


@cache
def cache_folder() -> Path:
    """``$SYMSTIFF_CACHE`` or the user's cache folder; a temporary one where others could write to that.

    A library from a folder that others can write to would run their code.
    """
    wanted = os.environ.get("SYMSTIFF_CACHE")
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    folder = Path(wanted) if wanted else Path(base).expanduser() / "symstiff"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        state = folder.stat()
        private = os.name == "nt" or (state.st_uid == os.geteuid() and not state.st_mode & 0o022)
        if private and os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    temporary = tempfile.mkdtemp(prefix="symstiff-")
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return Path(temporary)


def _key(source: str, compiler: Compiler) -> str:
    """What the binary depends on: the text, the compiler, the flags and the processor."""
    parts = [source, *compiler.command, _compiler_version(compiler), repr(FLAGS), _processor(), sys.platform]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


@cache
def _compiler_version(compiler: Compiler) -> str:
    done = subprocess.run(
        [*compiler.command, "--version"], capture_output=True, text=True, check=False, timeout=60
    )
    return done.stdout


@cache
def _processor() -> str:
    """The instruction sets of this machine, as far as the system tells."""
    text = platform.machine() + platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return text
    return text + "".join(sorted({line for line in lines if line.startswith(("flags", "Features", "isa"))}))


def _suffix() -> str:
    return {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def _build(source: str, path: Path, compiler: Compiler) -> None:
    """Compile beside the place, then move: another process sees the whole library or none."""
    path.parent.mkdir(exist_ok=True, mode=0o700)
    with tempfile.TemporaryDirectory(prefix=".build-", dir=path.parent) as scratch:
        text, built = Path(scratch) / "model.c", Path(scratch) / path.name
        text.write_bytes(source.encode())
        for flags in FLAGS:
            done = compiler.run(["-std=c99", *flags, *shared_flags(), str(text), "-o", str(built), "-lm"])
            if done.returncode == 0:
                os.replace(built, path)
                return
    raise UserError(f"{compiler.name} could not build a shared library: {done.stderr.strip()[:300]}")
