"""The function block parses, and its arithmetic is that of NumPy and of the C functions."""

from __future__ import annotations

import ctypes
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

pytest.importorskip("blark", reason="blark is missing")

from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.reference import unit_length
from symstiff.codegen.structured_text import StructuredAlgebra, emit_st
from symstiff.codegen.text import Text
from symstiff.compensation import compensate_online
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.symbolic.algebras import evaluate_numpy
from tests.generated_c import grown, model, needs, poses, shared_library, written
from tests.structured_text import Block

# Arms of four, six and seven joints; few compliances, since the parser is slow.
ROBOTS = ["scara", "puma560", "franka_panda"]


@cache
def small(robot: str):
    m = model(robot)
    return (
        m
        if robot == "scara"
        else replace(m, compliances=m.compliances[:3], values={n: m.values[n] for n in m.parameters[:3]})
    )


@cache
def source(robot: str, precision: str = "double") -> str:
    options = Options(precision=precision, targets=("st",))
    return emit_st(Functions(small(robot)), options)[f"FB_{robot}.st"].decode()


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_deflections_are_those_of_numpy(robot):
    block, m = Block(source(robot)), small(robot)
    q, w = poses(robot, 6)
    wanted = m.deflection(q, w)
    for k in range(6):
        outputs = block(q=q[k], w=w[k])
        assert outputs["status"] == 0
        np.testing.assert_allclose(outputs["dt"], wanted[k], rtol=0, atol=1e-13 * np.abs(wanted[k]).max())


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_commands_are_the_least_joint_motions_that_undo_the_deflection(robot):
    """lstsq knows both: least squares where joints are missing, fewest motions where there are more than six."""
    block, m = Block(source(robot)), small(robot)
    q, w = poses(robot, 6, seed=1)
    J = evaluate_numpy(Functions(m).jacobian, q=q)["J"]
    weights = np.array([1.0] * 3 + [unit_length(m)] * 3)
    dt = m.deflection(q, w)
    for k in range(6):
        outputs = block(q=q[k], w=w[k])
        assert outputs["status"] == 0
        wanted = np.linalg.lstsq(weights[:, None] * J[k], weights * dt[k], rcond=None)[0]
        np.testing.assert_allclose(
            q[k] - outputs["q_cmd"], wanted, rtol=0, atol=1e-9 * np.abs(wanted).max() + 1e-15
        )


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "float"])
def test_both_precisions_agree_with_the_c_functions(precision, tmp_path):
    folder = written(tmp_path, "scara", precision)
    library = shared_library(folder, ["scara.c"])
    real = np.float64 if precision == "double" else np.float32
    block = Block(source("scara", precision))
    q, w = poses("scara", 6, seed=2)
    p = model("scara").vector().astype(real)
    for k in range(6):
        a, b, dt, command = q[k].astype(real), w[k].astype(real), np.empty(6, real), np.empty(4, real)
        p_, a_, b_, dt_, command_ = (x.ctypes.data_as(ctypes.c_void_p) for x in (p, a, b, dt, command))
        assert (
            library.scara_deflection(p_, a_, b_, dt_) == library.scara_compensate(p_, a_, b_, command_) == 0
        )
        outputs = block(q=a, w=b)
        assert outputs["dt"].dtype == real
        eps = float(np.finfo(real).eps)
        np.testing.assert_allclose(outputs["dt"], dt, rtol=0, atol=100 * eps * np.abs(dt).max())
        np.testing.assert_allclose(outputs["q_cmd"], command, rtol=0, atol=20 * eps)


def test_a_command_that_would_be_worse_than_none_is_refused():
    block, m = Block(source("scara")), model("scara")
    q, w = poses("scara", 12, seed=5)
    q[:, 1] = 10.0 ** np.linspace(-5, -1, len(q))  # almost stretched
    wanted, seen = compensate_online(m, q, w), set()
    for k in range(len(q)):
        outputs = block(q=q[k], w=w[k])
        np.testing.assert_allclose(outputs["q_cmd"], wanted[k], rtol=0, atol=1e-9)
        seen.add(int(outputs["status"]))
    assert seen == {0, -5, -6}


def test_other_parameters_may_be_given_and_the_defaults_are_the_models():
    m, block = model("scara"), Block(source("scara"))
    assert {n: float(block.variables[n.lower()]) for n in m.parameters} == m.values
    q, w = poses("scara", 1)
    values = dict.fromkeys(m.parameters, 2e-7)
    wanted = m.deflection(q, w, values=values)[0]
    found = block(q=q[0], w=w[0], **values)["dt"]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13 * np.abs(wanted).max())


@pytest.mark.parametrize("change", ["q", "w", "parameter"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_an_error_with_zeros(change, bad):
    q, w = poses("scara", 1)
    inputs = {"q": q[0].copy(), "w": w[0].copy()}
    if change == "parameter":
        inputs[model("scara").parameters[2]] = bad
    else:
        inputs[change][2] = bad
    outputs = Block(source("scara"))(**inputs)
    assert outputs["status"] == -2
    assert not outputs["dt"].any()
    np.testing.assert_array_equal(outputs["q_cmd"], np.zeros(4) if change == "q" else q[0])


def test_a_singular_pose_is_an_error_that_keeps_the_joints():
    q = np.array([0.1, -0.4, 0.3, 0.2, 0.0, 0.5])  # the axes of joints 4 and 6 coincide
    outputs = Block(source("puma560"))(q=q, w=np.full(6, 100.0))
    assert outputs["status"] == -3
    np.testing.assert_array_equal(outputs["q_cmd"], q)


def test_a_correction_that_is_not_small_is_an_error_that_keeps_the_joints():
    q = np.array([0.1, -0.4, 0.3, 0.2, 1e-6, 0.5])
    outputs = Block(source("puma560"))(q=q, w=np.full(6, 100.0))
    assert outputs["status"] == -5
    assert not outputs["dt"].any()
    np.testing.assert_array_equal(outputs["q_cmd"], q)


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["backlash", "transmission_error"])
def test_laws_of_effects_are_written_in_standard_functions(effect):
    m = model("planar2r")
    entry = find(effect)
    where = entry.places(m.robot)[1]
    m = m.with_effect(EffectInstance(effect, where, entry.shapes(m.robot, where, Scales())[0]))
    m = m.with_values(dict.fromkeys(m.parameters, 1e-7) | {e.name: e.typical for e in m.effect_parameters})
    block = Block(emit_st(Functions(m), Options(targets=("st",)))["FB_planar2r.st"].decode())
    q, w = poses("planar2r", 4)
    wanted = m.deflection(q, w)
    for k in range(4):
        found = block(q=q[k], w=w[k])["dt"]
        np.testing.assert_allclose(found, wanted[k], rtol=0, atol=1e-12 * np.abs(wanted[k]).max())


@pytest.mark.parametrize(("precision", "tolerance"), [("double", 2e-14), ("float", 4e-6)])
def test_tanh_of_small_arguments_keeps_its_digits(precision, tolerance):
    algebra = StructuredAlgebra(single=precision == "float")
    kind = np.float32 if precision == "float" else np.float64
    words = {
        "SEL": lambda second, a, b: b if second else a, "ABS": np.abs, "EXP": np.exp,
        "LIMIT": lambda low, x, high: min(max(x, low), high),
    }  # fmt: skip
    code = algebra.call("tanh", [Text("x")]).code
    code = re.sub(r"(?:REAL#)?(\d+\.\d+(?:E-?\d+)?)", r"kind(\1)", code)
    for x in (1e-9, 1e-6, 1e-3, 0.03, 0.0499, 0.0501, 0.3, 2.0, 50.0):
        for sign in (1.0, -1.0):
            found = eval(code, {**words, "kind": kind, "x": kind(sign * x)})
            assert found == pytest.approx(np.tanh(sign * x), rel=tolerance)


def test_single_precision_has_no_untyped_literal():
    text = re.sub(r"\(\*.*?\*\)", "", source("scara", "float"), flags=re.DOTALL)
    assert "LREAL" not in text
    literals = re.findall(r"(\S*?)(\d+\.\d+(?:E[-+]?\d+)?)", text)
    assert len(literals) > 30
    assert all(before.endswith("REAL#") for before, _ in literals)


def test_no_two_names_differ_by_case_alone():
    for robot in ROBOTS:
        declared = re.findall(r"^    (\w+) : ", source(robot), flags=re.MULTILINE)
        assert len({n.lower() for n in declared}) == len(declared)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize(("effect", "shape"), [("hysteresis", 0), ("thermal_drift", 0), ("thermal_drift", 1)])
def test_laws_of_the_moment_read_it_from_inputs(effect, shape, precision):
    m = grown("planar2r", effect, shape)
    text = emit_st(Functions(m), Options(precision=precision, targets=("st",)))["FB_planar2r.st"].decode()
    block, (q, w) = Block(text), poses("planar2r", 1)
    names = {"time": "time_s", "temperature": "temperature", "branch": "branch"}
    moments = [
        {"time": 0.0, "temperature": 20.0, "branch": 1.0},
        {"time": 1800.0, "temperature": 31.0, "branch": -1.0},
    ]
    seen = []
    for moment in moments:
        known = {n: moment[n] for n in needs(m)}
        wanted = m.deflection(q, w, context={n: np.array([x]) for n, x in known.items()})[0]
        outputs = block(q=q[0], w=w[0], **{names[n]: x for n, x in known.items()})
        tolerance = 1e-12 if precision == "double" else 1e-4
        np.testing.assert_allclose(outputs["dt"], wanted, rtol=0, atol=tolerance * np.abs(wanted).max())
        seen.append(wanted)
        if moment is moments[0]:
            np.testing.assert_array_equal(Block(text)(q=q[0], w=w[0])["dt"], outputs["dt"])
    assert np.abs(seen[0] - seen[1]).max() > 1e-3 * np.abs(seen[0]).max()
    bad = block(q=q[0], w=w[0], **{names[sorted(needs(m))[0]]: np.nan})
    assert bad["status"] == -2
    assert not np.any(bad["dt"])
    if "branch" in needs(m):
        beyond = block(q=q[0], w=w[0], branch=7.0)
        assert beyond["status"] == -7
        assert not np.any(beyond["dt"])
