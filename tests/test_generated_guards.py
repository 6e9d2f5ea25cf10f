"""Guards of the generated C: what is beyond its range is refused, and code that refuses too much fails."""

from __future__ import annotations

import ctypes
import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.emit import emit_c
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.reference import cases, plausible_values, unit_length
from symstiff.codegen.verify import build_library, c_errors, verify
from symstiff.compensation import compensate_online
from symstiff.effects.instance import EffectInstance
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.symbolic.numeric import forward, joint_jacobian
from tests.generated_c import compiler, model, poses, shared_library, written

ROBOT = "scara"


@pytest.mark.parametrize(("precision", "bound"), [("double", 1e75), ("float", 1e9)])
@pytest.mark.parametrize("place", ["q", "w"])
def test_an_observation_matrix_of_a_load_or_angle_beyond_its_range_is_refused(
    tmp_path, precision, bound, place
):
    """Up to the bound that docs/formats.md promises, in all inputs at once, no product overflows."""
    compiler()
    real = np.float64 if precision == "double" else np.float32
    library = shared_library(written(tmp_path, ROBOT, precision), [f"{ROBOT}.c"])
    q, w = np.full(4, bound, real), np.full(6, bound, real)
    A = np.full((6, len(model(ROBOT).stiffness_parameters)), np.nan, real)
    arguments = [x.ctypes.data_as(ctypes.c_void_p) for x in (q, w, A)]
    assert library.scara_observation(*arguments) == 0
    assert A.any()
    assert np.isfinite(A).all()
    {"q": q, "w": w}[place][1] = np.nextafter(real(bound), real(np.inf))
    assert library.scara_observation(*arguments) == -2
    assert not A.any()


def test_a_library_that_gives_no_command_where_there_is_one_is_not_verified(tmp_path):
    cc = find_compiler()
    if cc is None:
        pytest.skip("no C compiler")
    functions = Functions(model(ROBOT))
    values = plausible_values(functions.model)
    found = cases(functions, values, 4, 23, False)
    assert any(case.compensation == 0 for case in found)
    folder, scratch = tmp_path / "code", tmp_path / "scratch"
    folder.mkdir()
    scratch.mkdir()
    written(folder, ROBOT, "double")
    source = folder / f"{ROBOT}.c"
    text = source.read_text()
    spoilt = text.replace(
        "bounded_all((double)SCARA_MAX_CORRECTION, x, N_JOINTS)", "bounded_all(1.0e-30, x, N_JOINTS)"
    )
    assert spoilt != text
    source.write_text(spoilt)
    library = build_library(folder, scratch, ROBOT, cc)
    with pytest.raises(RuntimeError, match="scara_compensate returned -5 instead of 0"):
        c_errors(library, functions, found, values, False)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize(
    ("function", "right", "wrong"),
    [
        ("deflection", "deflection_block(p, q, w, dt);", "deflection_block(p, q, w, dt); dt[1] += dt[1];"),
        ("observation", "observation_block(q, w, A);", "observation_block(w, w, A);"),
        ("observation", "*tile = &A[begin * 42U]", "*tile = &A[0]"),
    ],
)
def test_functions_for_many_poses_are_verified_too(tmp_path, precision, function, right, wrong):
    cc = find_compiler()
    if cc is None:
        pytest.skip("no C compiler")
    functions, options = Functions(model(ROBOT)), Options(precision=precision, targets=("c",))
    written(tmp_path, ROBOT, precision)
    proof = verify(tmp_path, functions, cc, options)
    assert 0.0 < proof.bounds[f"{function}_batch"] < 3e-6
    source = tmp_path / f"{ROBOT}_batch.c"
    before, body, after = source.read_text().rpartition(f"static int {function}_poses(")
    assert right in after
    source.write_text(before + body + after.replace(right, wrong, 1))
    with pytest.raises(RuntimeError, match=f"{function} of many poses is wrong"):
        verify(tmp_path, functions, cc, options)


@pytest.mark.parametrize("spoilt", ["deflection", "observation", "jacobian", "compliance", "forward"])
def test_every_function_that_casadi_loads_is_verified(tmp_path, spoilt):
    ca = pytest.importorskip("casadi")
    functions, options = Functions(model(ROBOT)), Options(targets=("casadi",))
    written(tmp_path, ROBOT, "double", ("casadi",))
    assert verify(tmp_path, functions, None, options).errors["casadi"] < 1e-13
    path = str(tmp_path / f"{ROBOT}_{spoilt}.casadi")
    function = ca.Function.load(path)
    inputs = [ca.SX.sym(f"i{k}", function.size1_in(k)) for k in range(function.n_in())]
    ca.Function(function.name(), inputs, [1.001 * function(*inputs)]).save(path)
    with pytest.raises(RuntimeError, match="CasADi's functions are wrong by"):
        verify(tmp_path, functions, None, options)


def off(m: StiffnessModel, target: np.ndarray, q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """How far the loaded tool (N,) is from target poses, rotations as lengths."""
    T, dt = forward(m.robot, q), m.deflection(q, w)
    turned = Rotation.from_rotvec(dt[:, 3:]) * Rotation.from_matrix(T[:, :3, :3] @ target[:, :3, :3].mT)
    moved = T[:, :3, 3] + dt[:, :3] - target[:, :3, 3]
    return np.linalg.norm(np.hstack([moved, unit_length(m) * turned.as_rotvec()]), axis=1)


@pytest.mark.parametrize("robot", ["ur10", "scara"])
def test_beside_a_singular_pose_no_command_is_worse_than_none(tmp_path: Path, robot: str) -> None:
    """Steps within the bound of a correction made an error up to a hundred times as large."""
    m = model(robot)
    library = shared_library(written(tmp_path, robot, "double"), [f"{robot}.c"])
    q, w = poses(robot, 400, seed=5)
    joint, q_cmd = {"ur10": 2, "scara": 1}[robot], np.empty_like(q)
    q[:, joint] = 10.0 ** np.linspace(-4, -1, len(q))  # almost stretched
    calls = [
        [ctypes.c_void_p(x.ctypes.data) for x in (m.vector(), *row)] for row in zip(q, w, q_cmd, strict=True)
    ]
    status = np.array([getattr(library, f"{robot}_compensate")(*call) for call in calls])
    assert set(status) == {0, -5, -6}
    np.testing.assert_array_equal(q_cmd[status < 0], q[status < 0])
    np.testing.assert_allclose(q_cmd, compensate_online(m, q, w), rtol=0, atol=1e-9)
    before, after = (off(m, forward(m.robot, q), x, w) for x in (q, q_cmd))
    assert (after <= 1.1 * before).all()
    refused = np.flatnonzero(status == -6)
    weights = np.array([1.0, 1.0, 1.0, *[unit_length(m)] * 3])
    J, dt = joint_jacobian(m.robot, q), m.deflection(q, w)
    steps = [np.linalg.lstsq(weights[:, None] * J[k], weights * dt[k], rcond=None)[0] for k in refused]
    assert (
        off(m, forward(m.robot, q[refused]), q[refused] - steps, w[refused]) > 0.9 * before[refused]
    ).all()


LAWS = (
    EffectInstance("backlash", {"joint": 1}, {"width": 0.2}),
    EffectInstance("hysteresis", {"joint": 2}, {"width": 0.3}),
    EffectInstance("nonlinear_stiffness", {"joint": 1}, {"load": 0.6, "knee": 1.0}),
    EffectInstance("nonlinear_stiffness", {"joint": 4}, {"load": 0.15, "saturation": 1.0}),
)


@cache
def lawful() -> StiffnessModel:
    """A model with laws that bend far below the loads of a robot, and values for all that it has."""
    m = model(ROBOT)
    for law in LAWS:
        m = m.with_effect(law)
    return m.with_values(dict(m.values) | {e.name: 0.75 * e.typical for e in m.effect_parameters})


def selftest_status(folder: Path, text: str) -> int:
    """What the self-test's program returns with another text of the functions."""
    (folder / f"{ROBOT}.c").write_text(text)
    sources = [f"{ROBOT}.c", f"{ROBOT}_selftest.c", f"test_{ROBOT}.c"]
    command = [compiler(), "-O0", "-I.", *sources, "-o", "selftest", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    return subprocess.run([folder / "selftest"], capture_output=True, check=False).returncode


def literals(text: str, part: slice, pattern: str) -> Iterator[re.Match[str]]:
    """What a part of the text has of a pattern."""
    return re.compile(pattern).finditer(text, part.start, part.stop)


def replaced(text: str, found: re.Match[str], factor: float) -> str:
    """The text with a literal of C so many times greater."""
    literal = f"{factor * float(found[0].rstrip('f')):.9g}"
    literal += "" if "." in literal or "e" in literal else ".0"
    return text[: found.start()] + literal + "f" * found[0].endswith("f") + text[found.end() :]


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_selftest_sees_where_laws_bend_and_what_the_defaults_are(tmp_path, precision):
    functions = Functions(lawful())
    write_tree(tmp_path, emit_c(functions, Options(precision=precision, targets=("c",))))
    text = (tmp_path / f"{ROBOT}.c").read_text()
    assert selftest_status(tmp_path, text) == 0
    core = slice(text.index("void deflection_core("), text.index("void observation_core("))
    bends = list(literals(text, core, r"(?<![\d.])[1-6]\.\d+f?(?=\*t)"))
    table = slice(first := text.index("default_params = {"), text.index("};", first))
    defaults = list(literals(text, table, r"\d+\.\d+(?:e-?\d+)?f?"))
    assert (len(bends), len(defaults)) == (len(LAWS), len(lawful().parameters) + 1)
    for found in bends:
        assert selftest_status(tmp_path, replaced(text, found, 1.3)) != 0, found
    for found in defaults[:-1]:  # the last is no parameter but the branch
        assert selftest_status(tmp_path, replaced(text, found, 1.01)) != 0, found


@pytest.mark.parametrize("precision", ["double", "float"])
def test_many_poses_are_verified_where_laws_bend(tmp_path, precision):
    cc = find_compiler()
    if cc is None:
        pytest.skip("no C compiler")
    functions, options = Functions(lawful()), Options(precision=precision, targets=("c",))
    write_tree(tmp_path, emit_c(functions, options))
    assert verify(tmp_path, functions, cc, options).configurations > 64
    source = tmp_path / f"{ROBOT}_batch.c"
    text = source.read_text()
    (knee,) = literals(text, slice(0, text.index("void observation_block(")), r"(?<![\d.])1\.66\d*f?(?=\*t)")
    source.write_text(replaced(text, knee, 1.1))
    with pytest.raises(RuntimeError, match="deflection of many poses is wrong"):
        verify(tmp_path, functions, cc, options)
