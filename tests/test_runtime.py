"""Compiled models give the numbers of NumPy, in place, and say so where they cannot be compiled."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from symstiff.codegen import library as library_module
from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.library import cache_folder
from symstiff.codegen.runtime import Evaluator, NotCompiled, compiled
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.errors import UserError
from tests.generated_c import model, poses

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler, nor ziglang")


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """A cache folder for this session's tests only."""
    monkeypatch.setenv("SYMSTIFF_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))
    cache_folder.cache_clear()
    yield
    cache_folder.cache_clear()


def close(found, wanted):
    assert found.shape == wanted.shape
    np.testing.assert_allclose(
        found, wanted, rtol=0, atol=1e-13 * np.abs(wanted).max(initial=0.0), equal_nan=True
    )


@needs_compiler
@pytest.mark.parametrize("robot", ["kuka_kr270", "scara", "franka_panda"])
def test_compiled_deflections_and_observations_are_those_of_numpy(robot):
    m = model(robot)
    evaluator = m.compile()
    assert evaluator.backend == "c"
    q, w = poses(robot, 77)
    close(evaluator.deflection(q, w), m.deflection(q, w))
    close(evaluator.observation(q, w), m.observation(q, w))
    other = dict.fromkeys(m.parameters, 2e-07)
    close(evaluator.deflection(q, w, values=other), m.deflection(q, w, values=other))


@needs_compiler
def test_any_layout_is_read_in_place():
    m = model("scara")
    evaluator = m.compile()
    q, w = poses("scara", 40)
    wanted = m.deflection(q, w)
    close(evaluator.deflection(np.asfortranarray(q), w[:, :]), wanted)
    wide = np.zeros((40, 2 * q.shape[1]))
    wide[:, ::2] = q
    close(evaluator.deflection(wide[:, ::2], w), wanted)
    close(evaluator.deflection(q[::-1], w[::-1]), wanted[::-1])
    close(evaluator.deflection(q.tolist(), w.tolist()), wanted)
    close(evaluator.deflection(q, w[0]), m.deflection(q, w[:1]))
    close(evaluator.deflection(q[0], w), m.deflection(q[:1], w))
    assert evaluator.deflection(q[:0], w[:0]).shape == (0, 6)
    assert evaluator.observation(q[:0], w[0]).shape == (0, 6, len(m.parameters))


@needs_compiler
def test_poses_out_of_reach_and_not_finite_are_those_of_numpy():
    m = model("scara")
    q, w = poses("scara", 70)
    q[3, 0], q[66, 1], w[5, 2] = 1e5, np.nan, np.inf
    with np.errstate(invalid="ignore"):
        close(m.compile().deflection(q, w)[[3, 4]], m.deflection(q[[3, 4]], w[[3, 4]]))
        found, wanted = m.compile().deflection(q, w), Evaluator(m, None).deflection(q, w)
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(wanted))


@needs_compiler
def test_threads_change_nothing():
    m = model("scara")
    q, w = poses("scara", 7001)
    one, three = compiled(m), compiled(m, threads=3)
    np.testing.assert_array_equal(one.deflection(q, w), three.deflection(q, w))
    np.testing.assert_array_equal(one.observation(q, w), three.observation(q, w))


@needs_compiler
def test_the_interpreters_lock_is_released():
    evaluator = model("kuka_kr270").compile()
    q, w = poses("kuka_kr270", 400_000)
    evaluator.deflection(q[:10], w[:10])
    counted, done = [0], threading.Event()

    def count():
        while not done.is_set():
            counted[0] += 1
            time.sleep(0)

    counter = threading.Thread(target=count)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(60)  # the counter only runs where this thread lets go
    try:
        counter.start()
        before = counted[0]
        evaluator.deflection(q, w)
        after = counted[0]
    finally:
        done.set()
        sys.setswitchinterval(interval)
        counter.join()
    assert after > before


CONTEXT = {"time": 0.3, "temperature": 31.0, "branch": -1.0}


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(
    "effect",
    ["backlash", "transmission_error", "link_weight", "hysteresis", "thermal_drift", "payload_error"],
)
def test_models_grown_by_an_effect_keep_all_their_columns(effect):
    m = model("kuka_kr270")
    entry = find(effect)
    where = entry.places(m.robot)[-1]
    m = m.with_effect(
        EffectInstance(
            effect,
            where,
            entry.shapes(m.robot, where, Scales(context={"time": 3600.0, "temperature": 10.0}))[0],
        )
    )
    m = m.with_values(dict.fromkeys(m.parameters, 1e-07) | {e.name: e.typical for e in m.effect_parameters})
    q, w = poses("kuka_kr270", 50)
    columns = {s.name for v in m.deflection_program.inputs if v.name == "context" for s in v.symbols}
    context = {c: np.full(50, CONTEXT[c]) for c in columns}
    evaluator = m.compile()
    assert evaluator.backend == "c"
    close(evaluator.deflection(q, w, context=context), m.deflection(q, w, context=context))
    found, wanted = evaluator.observation(q, w, context=context), m.observation(q, w, context=context)
    for k in range(len(m.parameters)):
        close(found[:, :, k], wanted[:, :, k])


def test_without_a_compiler_numpy_answers_and_a_warning_says_so(monkeypatch):
    monkeypatch.setattr("symstiff.codegen.runtime.find_compiler", lambda: None)
    m = model("scara")
    with pytest.warns(NotCompiled, match="no C compiler was found"):
        evaluator = m.compile()
    assert evaluator.backend == "numpy"
    q, w = poses("scara", 5)
    np.testing.assert_array_equal(evaluator.deflection(q, w), m.deflection(q, w))
    np.testing.assert_array_equal(evaluator.observation(q, w), m.observation(q, w))


@needs_compiler
def test_a_compiler_that_fails_is_a_warning(monkeypatch, tmp_path):
    from symstiff.codegen.compiler import Compiler

    monkeypatch.setenv("SYMSTIFF_CACHE", str(tmp_path))
    cache_folder.cache_clear()
    monkeypatch.setattr("symstiff.codegen.runtime.find_compiler", lambda: Compiler(("false",)))
    with pytest.warns(NotCompiled, match="false could not build"):
        assert model("scara").compile().backend == "numpy"


@needs_compiler
def test_a_library_is_built_once_and_found_by_another_process():
    m = model("scara")
    m.compile()
    built = {p: p.stat().st_mtime_ns for p in cache_folder().glob("*/scara*")}
    assert len(built) == 1
    script = "from tests.generated_c import model; print(model('scara').compile().backend)"
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": "."},
    )
    assert done.stdout.strip() == "c"
    assert {p: p.stat().st_mtime_ns for p in cache_folder().glob("*/scara*")} == built
    assert not list(cache_folder().glob("*/.build-*"))


@needs_compiler
def test_values_need_no_new_library_but_another_structure_does():
    m = model("scara")
    first = m.compile().library
    assert m.with_values(dict.fromkeys(m.parameters, 1e-06)).compile().library is first
    fewer = replace(m, compliances=m.compliances[:-1], values={})
    assert fewer.compile().library is not first


@pytest.mark.skipif(os.name == "nt", reason="folders on Windows have no mode")
def test_a_cache_folder_that_others_can_write_to_is_not_used(tmp_path, monkeypatch):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    monkeypatch.setenv("SYMSTIFF_CACHE", str(shared))
    cache_folder.cache_clear()
    assert cache_folder() != shared


@needs_compiler
def test_arithmetic_that_a_compiler_broke_is_found_out(monkeypatch):
    m = model("scara")
    monkeypatch.setattr(library_module, "_LOADED", {})
    right = library_module.c_source
    monkeypatch.setattr(library_module, "c_source", lambda *a: right(*a).replace(" + (", " - (", 40))
    with pytest.raises(RuntimeError, match="differs from NumPy"):
        m.compile()


@pytest.mark.parametrize("backend", ["c", "numpy"])
def test_results_are_written_to_the_array_that_is_given(backend):
    m = model("scara")
    evaluator = m.compile() if backend == "c" else Evaluator(m, None)
    q, w = poses("scara", 30)
    dt, A = np.full((30, 6), np.nan), np.full((30, 6, len(m.parameters)), np.nan)
    assert np.shares_memory(evaluator.deflection(q, w, out=dt), dt)
    assert np.shares_memory(evaluator.observation(q, w, out=A), A)
    close(dt, m.deflection(q, w))
    close(A, m.observation(q, w))
    with pytest.raises(UserError, match=r"out: expected a contiguous array of doubles of shape \(30, 6\)"):
        evaluator.deflection(q, w, out=np.empty((6, 30)).T)
    with pytest.raises(UserError, match="out: expected a contiguous array"):
        evaluator.deflection(q, w, out=beside_its_words(np.empty((30, 6))))
    close(evaluator.deflection(beside_its_words(q), beside_its_words(w)), m.deflection(q, w))


def test_columns_at_values_are_written_to_the_array_that_is_given_and_to_no_other() -> None:
    m = model("scara").with_effect(EffectInstance("force_sensor_bias", {"load": "force_sensor"}))
    assert not m.is_linear
    evaluator, (q, w) = Evaluator(m, None), poses("scara", 5)
    A = np.full((5, 6, len(m.parameters)), np.nan)
    assert evaluator.observation(q, w, out=A) is A
    close(A, m.observation(q, w))
    none = np.empty((0, *A.shape[1:]))
    assert evaluator.observation(q[:0], w[:0], out=none) is none
    for other in (A.astype(np.float32), A[:3], np.empty((2, *A.shape))):
        with pytest.raises(UserError, match="out: expected a contiguous array"):
            evaluator.observation(q, w, out=other)


def beside_its_words(array):
    """The same numbers one byte beside where doubles begin, as packets of a network hold them."""
    raw = np.zeros(array.nbytes + 1, np.uint8)[1:]
    out = raw.view(np.float64).reshape(array.shape)
    out[...] = array
    return out


def test_arrays_of_a_wrong_shape_are_named():
    evaluator = Evaluator(model("scara"), None)
    with pytest.raises(UserError, match=r"w: expected an array of shape \(N, 6\)"):
        evaluator.deflection(np.zeros((3, 4)), np.zeros((3, 5)))
    with pytest.raises(UserError, match="q and w: expected as many rows, or one, found 3 in q and 2 in w"):
        evaluator.deflection(np.zeros((3, 4)), np.zeros((2, 6)))
