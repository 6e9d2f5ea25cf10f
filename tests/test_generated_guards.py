"""Guards of the generated C: what is beyond its range is refused, and code that refuses too much fails."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.functions import Functions
from symstiff.codegen.reference import cases, plausible_values
from symstiff.codegen.verify import build_library, c_errors
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
