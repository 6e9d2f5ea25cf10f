"""Guards of the generated C: what is beyond its range is refused, and code that refuses too much fails."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.reference import cases, plausible_values
from symstiff.codegen.verify import build_library, c_errors, verify
from tests.generated_c import compiler, model, shared_library, written

ROBOT = "scara"


@pytest.mark.parametrize(("precision", "beyond"), [("double", 2e75), ("float", 2e9)])
@pytest.mark.parametrize("place", ["q", "w"])
def test_an_observation_matrix_of_a_load_or_angle_beyond_its_range_is_refused(
    tmp_path, precision, beyond, place
):
    compiler()
    real = np.float64 if precision == "double" else np.float32
    library = shared_library(written(tmp_path, ROBOT, precision), [f"{ROBOT}.c"])
    q, w = np.full(4, 0.3, real), np.full(6, 10.0, real)
    A = np.full((6, len(model(ROBOT).stiffness_parameters)), np.nan, real)
    arguments = [x.ctypes.data_as(ctypes.c_void_p) for x in (q, w, A)]
    assert library.scara_observation(*arguments) == 0
    assert A.any()
    {"q": q, "w": w}[place][1] = beyond
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
        "bounded_all(SCARA_MAX_CORRECTION, x, N_JOINTS)", "bounded_all(1.0e-30, x, N_JOINTS)"
    )
    assert spoilt != text
    source.write_text(spoilt)
    library = build_library(folder, scratch, ROBOT, cc)
    with pytest.raises(RuntimeError, match="scara_compensate returned -5 instead of 0"):
        c_errors(library, functions, found, values, False)


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
