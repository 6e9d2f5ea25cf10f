"""Batches agree with single calls, vectorise, name their errors, and keep the stated bounds of sine and cosine."""

from __future__ import annotations

import ctypes
import math
import re
import subprocess
from pathlib import Path

import mpmath
import numpy as np
import pytest

from symstiff.codegen.batch import SizeAlgebra, always_finite, small_arguments
from symstiff.codegen.functions import Functions
from symstiff.codegen.generate import generate
from symstiff.codegen.options import Options
from symstiff.codegen.sincos import DOUBLE, FLOAT
from symstiff.effects.instance import EffectInstance
from symstiff.symbolic.program import Emit
from tests.generated_c import STRICT, compiler, model, poses, shared_library, written

CASES = [("kuka_kr270", "double"), ("kuka_kr270", "float"), ("scara", "double")]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Robot and precision → loaded library and real type."""
    libraries = {}
    for robot, precision in CASES:
        folder = written(tmp_path_factory.mktemp(robot), robot, precision)
        sources = [f"{robot}.c", f"{robot}_batch.c"]
        real = np.float64 if precision == "double" else np.float32
        libraries[robot, precision] = shared_library(folder, sources), real
    return libraries


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


def parameters(robot, real):
    return np.ascontiguousarray(model(robot).vector(), dtype=real)


def scalar(library, robot, real, q, w):
    p, dt, status = parameters(robot, real), np.empty((len(q), 6), real), []
    for k in range(len(q)):
        a, b = np.ascontiguousarray(q[k], real), np.ascontiguousarray(w[k], real)
        status.append(
            getattr(library, f"{robot}_deflection")(pointer(p), pointer(a), pointer(b), pointer(dt[k]))
        )
    return dt, status


def batch(library, robot, real, q, w):
    p = parameters(robot, real)
    a, b, dt = q.T.astype(real, order="C"), w.T.astype(real, order="C"), np.full((6, len(q)), np.nan, real)
    status = getattr(library, f"{robot}_deflection_batch")(
        pointer(p), ctypes.c_size_t(len(q)), pointer(a), pointer(b), pointer(dt)
    )
    return dt.T, status


@pytest.mark.parametrize(("robot", "precision"), CASES)
@pytest.mark.parametrize("n", [0, 1, 63, 64, 65, 200])
def test_a_batch_equals_single_calls_but_for_rounding(built, robot, precision, n):
    library, real = built[robot, precision]
    q, w = poses(robot, n)
    one, codes = scalar(library, robot, real, q, w)
    many, status = batch(library, robot, real, q, w)
    assert status == 0
    assert codes == [0] * n
    for block in (slice(0, 3), slice(3, 6)):
        size = np.abs(one[:, block]).max(initial=0.0)
        np.testing.assert_allclose(many[:, block], one[:, block], rtol=0, atol=40 * np.finfo(real).eps * size)


def test_poses_in_error_have_zeros_and_the_last_error_is_returned(built):
    library, real = built["kuka_kr270", "double"]
    q, w = poses("kuka_kr270", 150)
    good, _ = batch(library, "kuka_kr270", real, q, w)
    q[3, 2], w[70, 5], q[149, 0] = np.nan, np.inf, 1e308
    dt, status = batch(library, "kuka_kr270", real, q, w)
    _, codes = scalar(library, "kuka_kr270", real, q, w)
    assert status == [c for c in codes if c][-1] == -2
    bad = [k for k, c in enumerate(codes) if c]
    assert set(bad) == {3, 70}
    assert not dt[bad].any()
    same = [k for k in range(149) if k not in bad]
    np.testing.assert_array_equal(dt[same], good[same])


def test_joint_variables_beyond_the_reach_go_to_the_scalar_function(built):
    library, real = built["kuka_kr270", "double"]
    q, w = poses("kuka_kr270", 10)
    q[4] += 2 * np.pi * 1000
    one, _ = scalar(library, "kuka_kr270", real, q, w)
    many, status = batch(library, "kuka_kr270", real, q, w)
    assert status == 0
    np.testing.assert_array_equal(many[4], one[4])


def test_parameters_that_are_not_finite_give_zeros(built):
    library, real = built["kuka_kr270", "double"]
    q, w = poses("kuka_kr270", 5)
    p = parameters("kuka_kr270", real)
    p[3] = np.nan
    dt = np.ones((6, 5))
    status = library.kuka_kr270_deflection_batch(
        pointer(p), ctypes.c_size_t(5), pointer(q.T.copy()), pointer(w.T.copy()), pointer(dt)
    )
    assert status == -2
    assert not dt.any()
    assert library.kuka_kr270_deflection_batch(None, ctypes.c_size_t(5), None, None, None) == -1


@pytest.mark.parametrize("order", ["C", "F"])
def test_observation_matrices_in_any_layout_times_parameters_are_deflections(built, order):
    library, real = built["kuka_kr270", "double"]
    robot, m = "kuka_kr270", len(model("kuka_kr270").parameters)
    q, w = poses(robot, 100)
    A = np.full((100, 6 * m), np.nan, order=order)
    a, b = np.array(q, order=order), np.array(w[:1], order=order)
    strides = [(ctypes.c_size_t * 2)(x.strides[1] // 8, x.strides[0] // 8) for x in (a, b, A)]
    strides[1][1] = 0  # one wrench for all poses
    status = library.kuka_kr270_observation_strided(
        ctypes.c_size_t(100), pointer(a), strides[0], pointer(b), strides[1], pointer(A), strides[2]
    )
    assert status == 0
    same, _ = batch(library, robot, real, q, np.repeat(w[:1], 100, axis=0))
    found = A.reshape(100, 6, m) @ model(robot).vector()
    np.testing.assert_allclose(found, same, rtol=0, atol=1e-14 * np.abs(same).max())


def test_the_observation_batch_of_one_array_a_component_is_the_strided_one(built):
    library, real = built["scara", "double"]
    m = len(model("scara").parameters)
    q, w = poses("scara", 30)
    A, a, b = np.empty((6 * m, 30)), q.T.copy(), w.T.copy()
    assert library.scara_observation_batch(ctypes.c_size_t(30), pointer(a), pointer(b), pointer(A)) == 0
    found = A.reshape(6, m, 30).transpose(2, 0, 1) @ model("scara").vector()
    dt, _ = batch(library, "scara", real, q, w)
    np.testing.assert_allclose(found, dt, rtol=0, atol=1e-14 * np.abs(dt).max())


def tiles(library, robot, real, q, w, A):
    """Fill tiles from arrays that hold one component after the other; the status."""
    a, b, n = q.T.astype(real, order="C"), w.T.astype(real, order="C"), len(q)
    stride = (ctypes.c_size_t * 2)(n, 1)
    call = getattr(library, f"{robot}_observation_tiles")
    return call(ctypes.c_size_t(n), pointer(a), stride, pointer(b), stride, pointer(A))


def strided(library, robot, real, q, w):
    """Observation matrices pose after pose, and the status."""
    m = len(model(robot).parameters)
    a, b, A = (np.ascontiguousarray(x, real) for x in (q, w, np.full((len(q), 6 * m), np.nan)))
    stride = [(ctypes.c_size_t * 2)(1, x.shape[1]) for x in (a, b, A)]
    call = getattr(library, f"{robot}_observation_strided")
    status = call(
        ctypes.c_size_t(len(q)), pointer(a), stride[0], pointer(b), stride[1], pointer(A), stride[2]
    )
    return A, status


@pytest.mark.parametrize(("robot", "precision"), CASES)
@pytest.mark.parametrize("n", [1, 8, 37, 6000])
def test_tiles_hold_the_same_observation_matrices_and_leave_zeros_alone(built, robot, precision, n):
    library, real = built[robot, precision]
    size, tile = 6 * len(model(robot).parameters), 8 if precision == "double" else 16
    q, w = poses(robot, n)
    wanted, _ = strided(library, robot, real, q, w)
    A = np.full((-(-n // tile) + 1, size, tile), 7, real)
    assert tiles(library, robot, real, q, w, A) == 0
    assert (A[-1] == 7).all()
    emitted = Functions(model(robot)).observation.statements
    stored = [s.index for s in emitted if isinstance(s, Emit) and s.expression != 0]
    zero = np.setdiff1d(np.arange(size), stored)
    assert (A[:, zero] == 7).all()
    A[:, zero] = 0
    np.testing.assert_array_equal(A[:-1].transpose(0, 2, 1).reshape(-1, size)[:n], wanted)


def test_poses_in_error_are_zeros_in_their_tile(built):
    library, real = built["kuka_kr270", "double"]
    q, w = poses("kuka_kr270", 24)
    q[3, 2], w[11, 5], w[20] = np.nan, np.inf, 1e100
    A = np.zeros((3, 156, 8))
    assert tiles(library, "kuka_kr270", real, q, w, A) == -2
    found = A.transpose(0, 2, 1).reshape(-1, 156)
    wanted, status = strided(library, "kuka_kr270", real, q, w)
    assert status == -2
    np.testing.assert_array_equal(found, wanted)
    assert not found[[3, 11, 20]].any()
    assert found[[2, 4, 10, 12, 19, 21]].any(axis=1).all()
    assert library.kuka_kr270_observation_tiles(ctypes.c_size_t(1), None, None, None, None, pointer(A)) == -1


@pytest.mark.parametrize("missing", range(4))
def test_a_missing_input_of_tiles_leaves_zeros_in_whole_tiles(built, missing):
    library, _ = built["kuka_kr270", "double"]
    A = np.ones((3, 156, 8))
    stride = (ctypes.c_size_t * 2)(9, 1)
    given = [pointer(np.zeros((6, 9))), stride, pointer(np.zeros((6, 9))), stride]
    given[missing] = None
    assert library.kuka_kr270_observation_tiles(ctypes.c_size_t(9), *given, pointer(A)) == -1
    assert not A[:2].any()
    assert (A[2] == 1).all()


@pytest.mark.parametrize(("robot", "precision"), CASES)
def test_matrices_that_need_no_check_are_finite_at_the_bounds_of_the_inputs(built, robot, precision):
    library, real = built[robot, precision]
    functions = Functions(model(robot))
    assert always_finite(functions.observation, precision == "float")
    assert not always_finite(functions.deflection, precision == "float")
    reach, load = (999, 0.99e75) if precision == "double" else (99, 0.99e9)
    q, w = poses(robot, 64)
    A, status = strided(library, robot, real, reach * np.sign(q), load * np.sign(w))
    assert status == 0
    assert np.isfinite(A).all()


@pytest.mark.parametrize("cc", ["gcc", "clang"])
def test_the_main_loops_vectorise(tmp_path, cc):
    folder = written(tmp_path, "kuka_kr270", "double")
    report = ["-fopt-info-vec"] if cc == "gcc" else ["-Rpass=loop-vectorize"]
    arguments = [*STRICT, "-Wno-error", "-O3", *report, "-c", "kuka_kr270_batch.c", "-o", "b.o"]
    done = subprocess.run([compiler(cc), *arguments], cwd=folder, capture_output=True, text=True, check=True)
    lines = (folder / "kuka_kr270_batch.c").read_text().splitlines()
    for function in ("deflection_block", "observation_block"):
        start = next(k for k, line in enumerate(lines) if f"static void {function}" in line)
        loop = next(k for k in range(start, len(lines)) if "for (i = 0" in lines[k]) + 1
        assert any(
            f"kuka_kr270_batch.c:{loop}:" in line and "vectorized" in line
            for line in done.stderr.splitlines()
        )


@pytest.mark.parametrize("flag", ["-DSYMSTIFF_LIBMVEC", "-DKUKA_KR270_CLONES"])
def test_the_platforms_vector_library_and_clones_give_the_same_numbers(tmp_path, flag):
    folder = written(tmp_path, "kuka_kr270", "double")
    sources = ["kuka_kr270.c", "kuka_kr270_batch.c"]
    if "LIBMVEC" in flag:
        if not list(Path("/").glob("usr/lib*/**/libmvec.so*")) + list(Path("/").glob("lib*/**/libmvec.so*")):
            pytest.skip("libmvec is missing")
        sources.append("-lmvec")
    library = shared_library(folder, sources, ("-O3", "-Wno-pedantic", flag))
    q, w = poses("kuka_kr270", 130)
    one, _ = scalar(library, "kuka_kr270", np.float64, q, w)
    many, status = batch(library, "kuka_kr270", np.float64, q, w)
    assert status == 0
    np.testing.assert_allclose(many, one, rtol=0, atol=1e-14 * np.abs(one).max())


def arguments_to_test(numbers, real):
    """Random arguments up to the reach, and the neighbours of every multiple of π/4 there."""
    rng = np.random.default_rng(1)
    k = np.arange(
        -int(numbers.reach / np.pi * 4), int(numbers.reach / np.pi * 4) + 1, 1 if numbers is FLOAT else 7
    )
    near = [real(x) for x in k * (np.pi / 4)]
    spread = [np.nextafter(x, real(s), dtype=real) for x in near for s in (-np.inf, np.inf)]
    drawn = rng.uniform(-numbers.reach, numbers.reach, 1500).astype(real)
    small = (rng.uniform(-1, 1, 1000) * 10.0 ** rng.uniform(-12, 0, 1000)).astype(real)
    return np.unique(np.array([*near, *spread, *drawn, *small], dtype=real))


@pytest.mark.parametrize(("precision", "numbers", "flags"), [
    ("double", DOUBLE, "-ffp-contract=off"), ("double", DOUBLE, "-ffp-contract=fast -march=native"),
    ("float", FLOAT, "-ffp-contract=off"), ("float", FLOAT, "-ffp-contract=fast -march=native"),
])  # fmt: skip
def test_sine_and_cosine_keep_their_stated_bound(tmp_path, precision, numbers, flags):
    folder = written(tmp_path, "scara", precision)
    (folder / "probe.c").write_text(
        '#include "scara_batch.c"\n'
        f"void probe({precision} x, {precision} *out);\n"
        f"void probe({precision} x, {precision} *out) {{ out[0] = sine(x); out[1] = cosine(x); }}\n"
    )
    library = shared_library(folder, ["probe.c", "scara.c"], ("-O2", *flags.split()))
    real = np.float64 if precision == "double" else np.float32
    library.probe.argtypes = [ctypes.c_double if precision == "double" else ctypes.c_float, ctypes.c_void_p]
    out, worst = np.empty(2, real), 0.0
    with mpmath.workdps(60):
        for x in arguments_to_test(numbers, real):
            library.probe(x, pointer(out))
            for found, exact in zip(out, (mpmath.sin(float(x)), mpmath.cos(float(x))), strict=True):
                unit = float(np.spacing(real(abs(float(exact)))))
                worst = max(worst, abs(float((mpmath.mpf(float(found)) - exact) / unit)))
    assert worst <= numbers.ulp
    assert worst > 0.3  # the stated bound is no empty phrase


def test_arguments_that_may_leave_the_domain_keep_the_librarys_sine():
    import sympy as sp

    from symstiff.symbolic.builder import Builder
    from symstiff.symbolic.program import Vector

    q, w = sp.Symbol("q_1", real=True), sp.Symbol("w_1", real=True)
    b = Builder("x", (Vector("q", (q,)), Vector("w", (w,))))
    arguments = (q, 3 * q + 1, 5000 * q, w, q**2)
    b.output("y", (5,), [sp.sin(a) for a in arguments])
    program = b.build()
    found = small_arguments(program, single=False)
    assert sorted(found) == [False, False, True, True, True]
    assert all(small_arguments(Functions(model("scara")).deflection, single=True))


@pytest.mark.parametrize("robot", ["kuka_kr270", "scara"])
@pytest.mark.parametrize("layout", ["C", "F"])
@pytest.mark.parametrize("function", ["deflection", "observation"])
def test_outputs_may_lie_in_the_inputs_where_the_strides_are_the_same(built, robot, function, layout):
    """40 poses, five blocks: the arrays of the call in place against those of one with room for each."""
    library, real = built[robot, "double"]
    p, (q, w) = parameters(robot, real), poses(robot, 40)
    size = 6 if function == "deflection" else 6 * len(model(robot).parameters)
    stride = (ctypes.c_size_t * 2)(*((40, 1) if layout == "C" else (1, size)))

    def called(same: str) -> np.ndarray:
        arrays = {n: np.zeros((size, 40), real, order=layout) for n in ("q", "w", "out")}
        for name, given in (("q", q), ("w", w)):
            arrays[name][: given.shape[1]] = given.T
        arrays["out"] = arrays[same]
        given = [x for n in ("q", "w", "out") for x in (pointer(arrays[n]), stride)]
        first = [pointer(p)] if function == "deflection" else []
        assert getattr(library, f"{robot}_{function}_strided")(*first, ctypes.c_size_t(40), *given) == 0
        return arrays["out"]

    for same in ("q", "w"):
        np.testing.assert_array_equal(called(same), called("out"))


def test_the_header_promises_no_other_place_for_outputs():
    """What a block writes may be read by the next one: not promised for tiles, other strides and the parameters."""
    header = (Path(__file__).parent.parent / "generated" / "ur10" / "ur10.h").read_text()
    text = " ".join(header.replace("\n *", " ").split())
    assert "An output array may be q or w of the same call" in text
    assert "it is no part of *p and overlaps no input otherwise" in text
    assert (
        "dt or A may be q or w where both have the same strides, no other. */ int ur10_deflection_strided("
        in text
    )
    assert re.search(r"A is neither q nor w\.[^*]*\*/ #define UR10_TILE", text)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_law_of_a_high_power_is_generated_and_its_overflow_found(tmp_path, precision):
    m = model("planar2r").with_effect(
        EffectInstance("nonlinear_stiffness", {"joint": 2}, {"load": 5.0, "power": 5.0})
    )
    assert SizeAlgebra([]).sum([(1, 1e308), (-1, 1e308)]) == math.inf
    compiler()
    made = generate(m, tmp_path / "code", Options(precision=precision, targets=("c",)))
    assert not always_finite(m.deflection_program, precision == "float")
    assert made.verification.max_relative_error < (1e-12 if precision == "double" else 2e-5)
