"""A model whose compliances were all replaced by an effect: its code has no ``k`` and no observation, and is right."""

from __future__ import annotations

import ctypes
import json
import subprocess
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.codegen.footprint import bench
from symstiff.codegen.functions import Functions
from symstiff.codegen.generate import generate
from symstiff.codegen.options import Options
from symstiff.codegen.targets import TARGETS
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import parse
from tests.generated_c import STRICT, compiler, shared_library
from tests.generated_c import run as done

ROBOT = """
format = 1
name = "rig"
[base.link]
template = "rigid"
[[joint]]
a = 0.1
alpha = "-pi/2"
d = 0.5
[joint.link]
template = "rigid"
[[joint]]
a = 0.7
alpha = 0
d = 0
[joint.link]
template = "rigid"
[tool]
xyz = [0.1, 0.0, 0.0]
"""
NAMES = [f"gravity_compensator_2_c{k}" for k in (1, 2, 3)]
Q, W = [0.0, 0.0], [0.0, 0.0, -1000.0, 0.0, 0.0, 0.0]
BENT = [0.0, 0.0, -1.28e-3, 0.0, 1.6e-3, 0.0]
"""At q2 = 0 the second of three compliances holds: 2e-6 rad/(N·m) × 1000 N × 0.8 m, and 0.8 m of arm turn by it."""
VALUES = [1e-6, 2e-6, 3e-6]


def a_model() -> StiffnessModel:
    bare = StiffnessModel.of(reduce(parse(ROBOT.encode(), "rig.toml"), "gravity"))
    preloaded = {"angle_1": -1.0, "angle_2": 0.0, "angle_3": 1.0}
    return bare.with_effect(EffectInstance("gravity_compensator", {"joint": 2}, preloaded))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("precision", "layout"), [("double", "unrolled"), ("double", "compact"), ("float", "unrolled")]
)
def test_every_target_but_the_estimator_writes_valid_code(
    tmp_path: Path, precision: str, layout: str
) -> None:
    m, targets = a_model(), tuple(t for t in TARGETS if t != "rls")
    assert (m.stiffness_parameters, m.parameters) == ((), tuple(NAMES))
    compiler()
    folder = tmp_path / "rig"
    made = generate(m, folder, Options(precision, layout, targets))
    assert made.verification.compiled
    assert (made.manifest["parameters"], [*made.manifest["effect_parameters"]]) == ([], NAMES)
    assert "observation" not in made.manifest["operations"]
    assert "observation" not in (folder / "rig.h").read_text()
    real = np.float64 if precision == "double" else np.float32
    text = (folder / "rig.params").read_bytes()
    assert [*tomllib.loads(text.decode())][1:] == NAMES
    for cc in ("gcc", "clang"):
        library = shared_library(
            folder, [f.name for f in folder.glob("*.c") if "main" not in f.read_text()], cc=cc
        )
        p, dt = np.ones(3, real), np.ones(6, real)
        q, w = np.array(Q, real), np.array(W, real)
        at = [ctypes.c_void_p(x.ctypes.data) for x in (p, q, w, dt)]
        assert library.rig_params_read(text, ctypes.c_size_t(len(text)), at[0], None) == 0
        assert not p.any()
        p[:] = VALUES
        assert library.rig_deflection(*at) == 0
        np.testing.assert_allclose(dt, BENT, rtol=1e-6, atol=1e-12)
        dt[:] = 1
        assert library.rig_deflection_batch(at[0], ctypes.c_size_t(1), *at[1:]) == 0
        np.testing.assert_allclose(dt, BENT, rtol=1e-6, atol=1e-12)


def test_the_programs_beside_the_library_build_and_pass(tmp_path: Path) -> None:
    folder, cc = tmp_path / "rig", compiler()
    generate(a_model(), folder, Options(targets=("c",)))
    (folder / "count.c").write_text(bench(Functions(a_model()), single=False))
    library = ["rig.c", "rig_batch.c", "rig_selftest.c"]
    for program, flags in (
        ("main", ()),
        ("test_rig", ()),
        ("fuzz_rig", ("-DRIG_FUZZ_MAIN",)),
        ("count", ()),
    ):
        strict = STRICT if program != "count" else ["-std=c99"]
        done(cc, *strict, *flags, f"{program}.c", *library, "-o", program, "-lm", cwd=folder)
        done(f"./{program}", cwd=folder)


def test_casadi_and_cpp_and_python_give_the_deflection(tmp_path: Path) -> None:
    ca = pytest.importorskip("casadi")
    folder, cxx = tmp_path / "rig", compiler("g++")
    generate(a_model(), folder, Options(targets=("c", "casadi", "cpp", "python")))
    deflection = ca.Function.load(str(folder / "rig_deflection.casadi"))
    np.testing.assert_allclose(np.array(deflection(VALUES, Q, W)).ravel(), BENT, atol=1e-12)
    (folder / "use.cpp").write_text(
        '#include "rig.hpp"\n#include <cstdio>\nint main() { rig::twist dt; rig::params p{1e-6, 2e-6, 3e-6};\n'
        "const auto s = rig::deflection(p, rig::joints{}, rig::wrench{0, 0, -1000, 0, 0, 0}, dt);\n"
        'std::printf("%d %zu %.9g", int(s), rig::parameter_names.size(), dt[2]); }\n'
    )
    objects = ["rig.o", "rig_batch.o", "rig_selftest.o"]
    done(compiler(), "-O2", "-c", *(o.replace(".o", ".c") for o in objects), cwd=folder)
    done(cxx, "-std=c++17", "-Wall", "-Wextra", "-Werror", "use.cpp", *objects, "-o", "use", cwd=folder)
    assert done("./use", cwd=folder) == "0 0 -0.00128"
    script = (
        f"import rig; m = rig.load(); values = dict(zip(rig.PARAMETERS, {VALUES}))\n"
        f"print(m.deflection({Q}, {W}, values)[0].tolist())"
    )
    printed = subprocess.run(["python", "-c", script], cwd=folder, capture_output=True, text=True, check=True)
    np.testing.assert_allclose(json.loads(printed.stdout), BENT, atol=1e-12)


def test_an_arm_without_any_spring_has_code_whose_stiffness_is_singular(tmp_path: Path) -> None:
    compiler()
    robot = parse(ROBOT.encode(), "rig.toml")
    offset = EffectInstance("joint_offset", {"joint": 2})
    made = generate(StiffnessModel(robot, (), effects=(offset,)), tmp_path / "rig")
    assert made.verification.compiled
    library = shared_library(tmp_path / "rig", ["rig.c"])
    params, q, dt, K = ((ctypes.c_double * n)() for n in (1, 2, 6, 36))
    params[0] = 1e-3
    w = (ctypes.c_double * 6)(*W)
    assert library.rig_deflection(params, q, w, dt) == 0
    np.testing.assert_allclose([*dt], [0.0, 0.0, -0.8e-3, 0.0, 1e-3, 0.0], atol=1e-15)
    assert library.rig_stiffness(params, q, K) == -3


def test_the_estimator_is_refused_in_one_line(tmp_path: Path, run: Run) -> None:
    (tmp_path / "rig.toml").write_text(ROBOT)
    a_model().save(tmp_path / "model.toml")
    given = ["generate", tmp_path / "rig.toml", "--model", tmp_path / "model.toml", "-o", tmp_path / "out"]
    refused = run(*given, "--targets", "c,rls")
    assert_users_mistake(refused, "has no compliances to identify: remove rls from --targets")
    assert run(*given, "--no-compile").code == 0
