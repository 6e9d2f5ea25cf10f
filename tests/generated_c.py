"""Models and compiled folders that the tests of generated code share."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from symstiff.codegen.emit import base_context
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.targets import TARGETS
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.robot import load

STRICT = [
    "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wfloat-conversion",
    "-Wshadow", "-Werror",
]  # fmt: skip


@cache
def model(robot: str = "kuka_kr270", loads: str = "gravity") -> StiffnessModel:
    """A reduced model with plausible values."""
    reduced = StiffnessModel.of(reduce(load(robot), loads=loads))
    rng = np.random.default_rng(4)
    sizes = [1e-6 if reduced.units[n] == "rad/(N*m)" else 1e-7 for n in reduced.parameters]
    values = rng.uniform(0.5, 1.5, len(sizes)) * np.float32(sizes)
    return reduced.with_values(dict(zip(reduced.parameters, map(float, np.float32(values)), strict=True)))


def described(robot: str, **text: str) -> StiffnessModel:
    """The model of a robot with another name or title."""
    known = model(robot)
    return replace(known, robot=known.robot.model_copy(update=text))


@cache
def emitted(robot: str, precision: str, targets: tuple[str, ...]) -> dict[str, bytes]:
    options = Options(precision=precision, targets=targets)
    functions = Functions(model(robot))
    files: dict[str, bytes] = {}
    for target in targets:
        files |= TARGETS[target].emitter()(functions, options)
    return files


def written(folder: Path, robot: str, precision: str, targets: tuple[str, ...] = ("c",)) -> Path:
    """A folder with what the targets write, without verification."""
    write_tree(folder, emitted(robot, precision, targets))
    return folder


def context(robot: str, precision: str = "double") -> dict:
    return base_context(Functions(model(robot)), Options(precision=precision))


def compiler(name: str = "gcc") -> str:
    if shutil.which(name) is None:
        pytest.skip(f"{name} is missing")
    return name


def run(*command: str | Path, cwd: Path | None = None) -> str:
    """Run a command that must succeed; its output."""
    done = subprocess.run([str(c) for c in command], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def shared_library(folder: Path, sources: list[str], flags: tuple[str, ...] = ("-O2",), cc: str = "gcc"):
    """Compile strictly to a shared library and load it."""
    path = folder / "shared.so"
    run(compiler(cc), *STRICT, *flags, "-fPIC", "-shared", "-I.", *sources, "-o", path, "-lm", cwd=folder)
    return ctypes.CDLL(str(path))


def poses(robot: str, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Joint variables within limits (n, dof) and wrenches (n, 6)."""
    rng = np.random.default_rng(seed)
    ranges = np.array([j.range for j in model(robot).robot.joint])
    q = rng.uniform(ranges[:, 0], ranges[:, 1], (n, len(ranges)))
    return q, rng.uniform(-1000, 1000, (n, 6)) * [1, 1, 1, 0.2, 0.2, 0.2]


SCALES = Scales(context={"time": 3600.0, "temperature": 10.0})


def grown(robot: str, effect: str, shape: int = 0) -> StiffnessModel:
    """A model with one effect of typical size, at its first place."""
    base, entry = model(robot), find(effect)
    where = entry.places(base.robot)[0]
    m = base.with_effect(EffectInstance(effect, where, entry.shapes(base.robot, where, SCALES)[shape]))
    return m.with_values(dict(base.values) | {e.name: e.typical for e in m.effect_parameters})


def needs(m: StiffnessModel) -> set[str]:
    """What the model has to know of the moment."""
    return {s.name for v in m.deflection_program.inputs if v.name == "context" for s in v.symbols}
