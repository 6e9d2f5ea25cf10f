"""Where many poses are evaluated the compiled model is used, quietly, and nothing that comes out depends on it."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest

from symstiff.calibration.plan import Goal, Search, workspace_for
from symstiff.calibration.plan import plan as choose_poses
from symstiff.calibration.rows import equations, predict
from symstiff.calibration.tables.measurements import measurements
from symstiff.codegen import library, runtime
from symstiff.codegen.compiler import Compiler, find_compiler
from symstiff.codegen.library import cache_folder
from symstiff.codegen.runtime import for_poses
from symstiff.compensation.trajectory import compensate, compensate_online
from tests.generated_c import model, poses

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler, nor ziglang")


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    """A cache folder for this session's tests only."""
    monkeypatch.setenv("SYMSTIFF_CACHE", str(tmp_path_factory.getbasetemp() / "heavy"))
    monkeypatch.setattr(library, "_LOADED", {})
    cache_folder.cache_clear()
    yield
    cache_folder.cache_clear()


@pytest.fixture
def both(monkeypatch):
    """Results of a call with everything compiled, and with NumPy."""

    def results(call):
        with monkeypatch.context() as patch:
            patch.setattr(runtime, "_LOADING", 1)
            patch.setattr(runtime, "_BUILDING", 1)
            used = []
            evaluate = runtime.Evaluator.evaluate
            patch.setattr(
                runtime.Evaluator,
                "evaluate",
                lambda self, *a: used.append(self.backend) or evaluate(self, *a),
            )
            compiled = call()
        assert "c" in used
        return compiled, call()

    return results


def close(found, wanted):
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * np.nanmax(np.abs(wanted)))


def test_a_library_is_used_where_it_pays(monkeypatch, tmp_path):
    monkeypatch.setenv("SYMSTIFF_CACHE", str(tmp_path))
    cache_folder.cache_clear()
    m = model("scara")
    backends = [for_poses(m, n).backend for n in (10, 50_000, 200_000, 50_000, 10)]
    assert backends == ["numpy", "numpy", "c", "c", "numpy"]


@pytest.mark.parametrize("compiler", [None, Compiler(("false",))], ids=["none", "broken"])
def test_nothing_warns_of_a_compiler_that_only_speed_would_need(compiler, monkeypatch, tmp_path):
    monkeypatch.setenv("SYMSTIFF_CACHE", str(tmp_path))
    cache_folder.cache_clear()
    monkeypatch.setattr("symstiff.codegen.runtime.find_compiler", lambda: compiler)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        evaluator = for_poses(model("scara"), 10**9)
    assert evaluator.backend == "numpy"
    q, w = poses("scara", 5)
    np.testing.assert_array_equal(evaluator.deflection(q, w), model("scara").deflection(q, w))


def test_an_evaluator_goes_to_another_process():
    m = model("scara")
    again = pickle.loads(pickle.dumps(m.compile()))
    assert again.backend == "c"
    assert pickle.loads(pickle.dumps(for_poses(m, 1))).backend == "numpy"
    q, w = poses("scara", 20)
    np.testing.assert_array_equal(again.observation(q, w), m.compile().observation(q, w))


def test_a_plan_is_the_same(both):
    search = Search(candidates=300, starts=2, seed=3)
    compiled, numpy = both(lambda: choose_poses(model("scara"), Goal(8), search=search))
    np.testing.assert_allclose(compiled.q, numpy.q, rtol=0, atol=1e-6)  # the optimiser's own tolerance
    close(compiled.std, numpy.std)
    assert compiled.score == pytest.approx(numpy.score, rel=1e-12)


def test_equations_and_predictions_are_the_same(both):
    m = model("scara")
    q, w = poses("scara", 60)
    table = measurements(q, w, kind="deflection", values=m.deflection(q, w))
    compiled, numpy = both(lambda: equations(m, table))
    close(compiled.A, numpy.A)
    compiled, numpy = both(lambda: predict(m, table))
    close(compiled, numpy)


def test_compensated_trajectories_are_the_same(both):
    m = model("kuka_kr270")
    q, w = poses("kuka_kr270", 40)
    compiled, numpy = both(lambda: compensate(m, q, w))
    close(compiled.q_cmd, numpy.q_cmd)
    compiled, numpy = both(lambda: compensate_online(m, q, w))
    close(compiled, numpy)


def test_a_map_of_the_workspace_is_the_same(both):
    m = model("kuka_kr270")
    compiled, numpy = both(lambda: workspace_for(m, [0, 0, -1000, 0, 0, 0], counts=(9, 7)))
    assert compiled.deflection.shape == (9, 7, 6)
    close(compiled.deflection, numpy.deflection)
    close(compiled.deflection[3, 2], m.deflection(compiled.q[3, 2], [0, 0, -1000, 0, 0, 0])[0])


def test_values_of_another_size_need_no_derivation():
    m = model("scara")
    assert m.deflection_program is m.with_values(dict.fromkeys(m.parameters, 1e-7)).deflection_program
    assert m.linear_program is m.observation_program
