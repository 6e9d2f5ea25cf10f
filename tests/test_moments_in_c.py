"""Laws that follow the moment: the generated C reads it beside the parameters, and clocks begin anywhere."""

from __future__ import annotations

import ctypes
import math

import numpy as np
import pytest

from symstiff.codegen.emit import emit_c
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import catalogue
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load
from tests.test_codegen_c import NAME, STRICT, _deflection, _numbers, done, need


@pytest.fixture(scope="module")
def functions() -> Functions:
    model = StiffnessModel.of(reduce(load(NAME), "gravity"))
    return Functions(model.with_values(dict.fromkeys(model.parameters, 1e-7)))


def test_an_effect_of_the_moment_reads_it_beside_the_parameters(functions, tmp_path):
    need("gcc")
    place = catalogue()["hysteresis"].places(functions.model.robot)[0]
    shape = catalogue()["hysteresis"].shapes(functions.model.robot, place, Scales())[0]
    model = functions.model.with_effect(EffectInstance("hysteresis", place, shape))
    values = dict.fromkeys(model.parameters, 1e-7) | {e.name: e.typical for e in model.effect_parameters}
    write_tree(tmp_path, emit_c(Functions(model), Options(targets=("c",))))
    sources = [f"{NAME}.c", f"{NAME}_batch.c"]
    done("gcc", "-O1", *STRICT, "-fPIC", "-shared", *sources, "-o", "lib.so", "-lm", cwd=tmp_path)
    library = ctypes.CDLL(str(tmp_path / "lib.so"))
    q, w = [0.1, -1.0, 1.2, 0.3, 0.5, -0.2], [500.0, 300.0, -2000.0, 0.0, 0.0, 0.0]
    seen = []
    for branch in (1.0, -1.0):
        p = _numbers("double", [*model.vector(values), branch])
        status, dt = _deflection(library, "double", p, _numbers("double", q), _numbers("double", w))
        assert status == 0
        context = {"branch": np.array([branch])}
        expected = model.deflection(np.array([q]), np.array([w]), values=values, context=context)[0]
        np.testing.assert_allclose(dt, expected, rtol=1e-9, atol=1e-15)
        seen.append(dt)
    assert seen[0] != seen[1]


LOOPS = {"branch": {"width": 20.0}, "turn": {"knee": 100.0}}


def looped(functions: Functions, name: str) -> StiffnessModel:
    """A model with a loop that asks for the branch, or for the turn."""
    model = functions.model.with_effect(EffectInstance("hysteresis", {"joint": 2}, LOOPS[name]))
    return model.with_values(dict.fromkeys(model.parameters, 1e-7))


@pytest.mark.parametrize(
    ("name", "known", "unknown"),
    [
        ("branch", (1.0, -1.0, 0.3, 0.0), (7.0, -1.001, 1e300)),
        ("turn", (1.0, 2.0, -1.5, 1e6), (0.3, 0.0, -0.999)),
    ],
)
def test_what_no_law_knows_of_the_moment_is_refused(functions, tmp_path, name, known, unknown):
    need("gcc")
    model = looped(functions, name)
    write_tree(tmp_path, emit_c(Functions(model), Options(targets=("c",))))
    sources = [f"{NAME}.c", f"{NAME}_batch.c"]
    done("gcc", "-O1", *STRICT, "-fPIC", "-shared", *sources, "-o", "lib.so", "-lm", cwd=tmp_path)
    library = ctypes.CDLL(str(tmp_path / "lib.so"))
    q, w = _numbers("double", [0.1, -1.0, 1.2, 0.3, 0.5, -0.2]), _numbers("double", [0, 0, -2000.0, 0, 0, 0])
    for value in (*known, *unknown, math.nan):
        p = _numbers("double", [*model.vector(), value])
        status = 0 if value in known else -7 if value in unknown else -2
        dt, K, q_cmd = (_numbers("double", [9.0] * n) for n in (6, 36, 6))
        assert getattr(library, f"{NAME}_deflection")(p, q, w, dt) == status
        assert getattr(library, f"{NAME}_stiffness")(p, q, K) in ({0, -3} if status == 0 else {status})
        assert getattr(library, f"{NAME}_compensate")(p, q, w, q_cmd) == status
        assert any(dt) == (status == 0)
        assert status == 0 or (list(q_cmd) == list(q) and not any(K))
        assert getattr(library, f"{NAME}_deflection_batch")(p, ctypes.c_size_t(1), q, w, dt) == status
        assert any(dt) == (status == 0)


@pytest.mark.parametrize("name", LOOPS)
def test_fuzzing_draws_moments_that_laws_know(functions, tmp_path, name):
    need("gcc")
    write_tree(tmp_path, emit_c(Functions(looped(functions, name)), Options(targets=("c",))))
    sources = [f"fuzz_{NAME}.c", f"{NAME}.c", f"{NAME}_batch.c"]
    flags = ["-O1", f"-D{NAME.upper()}_FUZZ_MAIN", "-fsanitize=undefined", "-fno-sanitize-recover=all"]
    done("gcc", *flags, *STRICT, *sources, "-o", "fuzz", "-lm", cwd=tmp_path)
    assert "4000 runs" in done("./fuzz", "4000", cwd=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("constant", [{}, {"T": 100.0}])
@pytest.mark.parametrize("start", [0.0, 80_000.0, 1.7e9])
def test_a_clock_may_begin_anywhere_and_by_default_nothing_has_drifted(functions, tmp_path, start, constant):
    need("gcc")
    shape = {"time": 480.0, **({"start": start} if start else {}), **constant}
    model = functions.model.with_effect(EffectInstance("thermal_drift", {"link": 3}, shape))
    values = dict.fromkeys(model.parameters, 1e-7) | dict.fromkeys(
        [p.name for p in model.effect_parameters], 2e-4
    )
    model = model.with_values(values)
    write_tree(tmp_path, emit_c(Functions(model), Options(targets=("c",))))
    done("gcc", "-O1", *STRICT, "-fPIC", "-shared", f"{NAME}.c", "-o", "lib.so", "-lm", cwd=tmp_path)
    tested = [f"{NAME}.c", f"{NAME}_selftest.c", f"test_{NAME}.c"]
    done("gcc", "-O1", *STRICT, *tested, "-o", "selftest", "-lm", cwd=tmp_path)
    assert "passed" in done("./selftest", cwd=tmp_path)
    library = ctypes.CDLL(str(tmp_path / "lib.so"))
    q, w = [0.1, -1.0, 1.2, 0.3, 0.5, -0.2], [500.0, 300.0, -2000.0, 0.0, 0.0, 0.0]
    default = list((ctypes.c_double * (len(model.parameters) + 1)).in_dll(library, f"{NAME}_default_params"))
    assert default[-1] == start
    still = model.with_values(dict(values) | {p.name: 0.0 for p in model.effect_parameters})
    for seconds in (0.0, 240.0):
        p = _numbers("double", [*default[:-1], start + seconds])
        status, dt = _deflection(library, "double", p, _numbers("double", q), _numbers("double", w))
        context = {"time": np.array([start + seconds])}
        expected = model.deflection([q], [w], context=context)[0]
        assert status == 0
        np.testing.assert_allclose(dt, expected, rtol=1e-9)
        grown = np.linalg.norm(expected[:3] - still.deflection([q], [w], context=context)[0][:3])
        share = (1 - math.exp(-seconds / 100)) / (1 - math.exp(-4.8)) if constant else seconds / 480
        assert grown == pytest.approx(2e-4 * math.sqrt(3) * share, rel=1e-6, abs=1e-15)
