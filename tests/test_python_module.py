"""The generated Python module stands without symstiff and gives the model's numbers."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.wrappers import emit_python
from symstiff.errors import UserError
from tests.generated_c import compiler, described, model, poses, written


@pytest.fixture(scope="module", params=["double", "float"])
def module(request, tmp_path_factory):
    compiler()
    folder = written(tmp_path_factory.mktemp("folder"), "scara", request.param, ("c", "python"))
    spec = importlib.util.spec_from_file_location("scara_generated", folder / "scara.py")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


@pytest.fixture(scope="module")
def compiled(module, tmp_path_factory):
    return module.load(module.build(tmp_path_factory.mktemp("library") / "model.so"))


def close(module, found, wanted):
    tolerance = 1e-13 if module.REAL is np.float64 else 2e-5
    assert found.shape == wanted.shape
    np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance * np.abs(wanted).max())


def test_it_imports_nothing_of_symstiff(module):
    text = open(module.__file__).read()  # noqa: SIM115
    imports = [line for line in text.splitlines() if line.startswith(("import ", "from "))]
    assert not any("symstiff" in line for line in imports)


def test_batches_are_those_of_the_model(module, compiled):
    m = model("scara")
    q, w = poses("scara", 100)
    close(module, compiled.deflection(q, w), m.deflection(q, w))
    close(module, compiled.deflection(q[::-1], w[0]), m.deflection(q[::-1], w[:1]))
    close(module, compiled.observation(q, w), m.observation(q, w))
    other = dict.fromkeys(m.parameters, 3e-7)
    close(module, compiled.deflection(q, w, other), m.deflection(q, w, values=other))
    assert dict(zip(module.PARAMETERS, module.DEFAULTS, strict=True)) == pytest.approx(dict(m.values))


def test_numbers_of_rows_that_do_not_fit_are_told(compiled):
    q, w = poses("scara", 5)
    with pytest.raises(ValueError, match="5 rows of q and 3 of w: give as many of both, or one of either"):
        compiled.deflection(q, w[:3])


def test_single_calls_work_and_errors_are_exceptions(module, compiled):
    q, w = poses("scara", 1)
    assert compiled.selftest() < 1e-3
    q_cmd = compiled.compensate(q[0], w[0])
    dt = compiled.deflection(q, w)[0]
    J = compiled.jacobian(q[0])
    moved = J @ (q[0] - q_cmd)
    assert np.abs(moved[:3] - dt[:3]).max() < 0.02 * np.abs(dt[:3]).max()
    assert compiled.forward(q[0]).shape == (4, 4)
    with pytest.raises(module.ModelError, match="NaN or infinite"):
        compiled.deflection(q * np.nan, w)
    with pytest.raises(module.ModelError) as caught:
        compiled.compensate(np.full(4, np.inf), w[0])
    assert caught.value.code == -2
    with pytest.raises(module.ModelError, match=r"more than 0\.25 rad or m"):
        compiled.compensate(q[0], 1e6 * w[0])
    with pytest.raises(KeyError, match="k9_99"):
        compiled.deflection(q, w, {"k9_99": 1.0})
    with pytest.raises(ValueError, match="q: expected"):
        compiled.deflection(q[:, :3], w)


@pytest.mark.parametrize("name", ["random", "numpy", "lambda"])
def test_a_module_that_would_hide_one_of_pythons_is_refused(name):
    functions = Functions(described("planar2r", name=name))
    with pytest.raises(UserError, match="rename the robot"):
        emit_python(functions, Options(targets=("c", "python")))


def test_without_a_compiler_it_says_what_to_do(module, monkeypatch):
    monkeypatch.setattr(module.shutil, "which", lambda name: None)
    with pytest.raises(OSError, match="no C compiler was found"):
        module.load()


def test_a_library_of_another_model_is_refused(module, tmp_path):
    folder = written(tmp_path, "scara", "float" if module.REAL is np.float64 else "double", ("c", "python"))
    spec = importlib.util.spec_from_file_location("scara_other", folder / "scara.py")
    other = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(other)
    with pytest.raises(OSError, match="is of another model"):
        module.load(other.build(tmp_path / "other.so"))


def test_values_that_are_not_given_are_the_models(module, compiled):
    m, (q, w) = model("scara"), poses("scara", 5)
    name = m.parameters[0]
    close(
        module,
        compiled.deflection(q, w, {name: 1e-6}),
        m.deflection(q, w, values=dict(m.values) | {name: 1e-6}),
    )


def test_a_library_that_it_builds_itself_leaves_no_folder_behind(module, tmp_path, monkeypatch):
    monkeypatch.setattr(module.tempfile, "mkdtemp", lambda prefix: str(tmp_path / f"{prefix}x"))
    (tmp_path / "scara-x").mkdir()
    q, w = poses("scara", 1)
    assert np.isfinite(module.load().deflection(q, w)).all()
    assert not list(tmp_path.iterdir())
