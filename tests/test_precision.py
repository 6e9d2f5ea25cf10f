"""Both precisions: what single precision leaves out, and how far either is from 50 digits."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import mpmath
import pytest

from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.emit import emit_c
from symstiff.codegen.footprint_machines import CORTEX_M4F
from symstiff.codegen.functions import Functions
from symstiff.codegen.generate import generate
from symstiff.codegen.options import Options
from symstiff.codegen.reference import cases, plausible_values
from symstiff.codegen.text import CAlgebra
from symstiff.codegen.verify import CONFIGURATIONS
from symstiff.effects.instance import EffectInstance
from symstiff.errors import UserError
from symstiff.files import write_tree
from symstiff.model import StiffnessModel, joints_only
from symstiff.reduction import reduce
from symstiff.robot import load
from symstiff.symbolic.algebras import evaluate_decimal

NAME = "kuka_kr270"
LIBRARY = ("", "_selftest", "_batch")
DOUBLE_X86 = re.compile(r"\b(?!mov)\w*(?:sd|pd|sd2\w+|2sd|2pd)\b")
DOUBLE_ARM = re.compile(r"\.f64|__aeabi_d|__aeabi_\w*2d\b")


@pytest.fixture(scope="module")
def functions() -> Functions:
    return Functions(StiffnessModel.of(reduce(load(NAME), "gravity")))


@pytest.fixture(scope="module")
def folders(functions, tmp_path_factory) -> dict[tuple[str, str], Path]:
    found = {}
    for precision in ("double", "float"):
        for layout in ("unrolled", "compact"):
            folder = found[precision, layout] = tmp_path_factory.mktemp(f"{precision}_{layout}")
            write_tree(folder, emit_c(functions, Options(precision=precision, layout=layout, targets=("c",))))
    return found


def need(*tools: str) -> None:
    for tool in tools:
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is missing")


def disassembled(compiler: str, flags: tuple[str, ...], source: Path, place: Path) -> str:
    """Instructions and names of what is called, of one source."""
    need(compiler, compiler.replace("gcc", "objdump"))
    command = [compiler, *flags, "-std=c99", "-O2", f"-I{source.parent}", "-c", str(source), "-o", str(place)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    objdump = [compiler.replace("gcc", "objdump"), "-dr", "--no-show-raw-insn", str(place)]
    return subprocess.run(objdump, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("layout", ["unrolled", "compact"])
@pytest.mark.parametrize("part", LIBRARY)
def test_single_precision_has_no_double_operation_on_x86(folders, layout, part, tmp_path):
    if "x86_64" not in subprocess.run(["uname", "-m"], capture_output=True, text=True, check=True).stdout:
        pytest.skip("an x86-64 machine is missing")
    code = disassembled("gcc", (), folders["float", layout] / f"{NAME}{part}.c", tmp_path / "o")
    assert "subss" in code or "subps" in code
    assert DOUBLE_X86.findall(code) == []


def test_the_scan_for_double_operations_finds_those_of_double_precision(folders, tmp_path):
    code = disassembled("gcc", (), folders["double", "unrolled"] / f"{NAME}.c", tmp_path / "o")
    assert {"mulsd", "addsd"} <= set(DOUBLE_X86.findall(code))
    arm = folders["double", "unrolled"] / f"{NAME}.c"
    assert DOUBLE_ARM.search(disassembled(CORTEX_M4F.compiler, CORTEX_M4F.flags, arm, tmp_path / "o"))


@pytest.mark.parametrize("layout", ["unrolled", "compact"])
@pytest.mark.parametrize("part", LIBRARY)
def test_single_precision_calls_no_double_routine_on_cortex_m4f(folders, layout, part, tmp_path):
    source = folders["float", layout] / f"{NAME}{part}.c"
    code = disassembled(CORTEX_M4F.compiler, CORTEX_M4F.flags, source, tmp_path / "o")
    assert "vmul.f32" in code or "vsub.f32" in code
    assert DOUBLE_ARM.findall(code) == []


@pytest.mark.parametrize("part", [".h", ".c", "_selftest.c"])
def test_single_precision_text_has_neither_the_word_nor_a_literal_of_double(folders, part):
    text = (folders["float", "unrolled"] / f"{NAME}{part}").read_text()
    code = re.sub(r"/\*.*?\*/|\"[^\"]*\"", "", text, flags=re.S)
    assert "double" not in code
    assert re.findall(r"(?<![\w.])\d+(?:\.\d*(?:e[-+]?\d+)?|e[-+]?\d+)(?![\w.])", code) == []
    assert set(re.findall(r"\b(?:sin|cos|sqrt|fabs)\(", code)) == set()


@pytest.mark.parametrize(("precision", "least", "most"), [("double", 1e-17, 1e-14), ("float", 1e-9, 5e-6)])
def test_measured_error_bounds_stand_in_the_manifest(functions, precision, least, most, tmp_path):
    need("gcc")
    made = generate(functions.model, tmp_path / "out", Options(precision=precision, targets=("c",)))
    bounds = dict(made.manifest["verified"]["bounds"])
    assert bounds.pop("configurations") == CONFIGURATIONS >= 50
    batches = {"deflection_batch", "observation_batch"}
    assert set(bounds) == batches | {
        "deflection", "observation", "jacobian", "forward", "compensate", "stiffness",
    }  # fmt: skip
    for error in bounds.values():
        assert least < error < most
    assert made.manifest["verified"]["max_relative_error"] >= max(bounds.values())
    assert made.manifest["verified"]["footprint"] == {}


def test_reference_values_by_columns_are_those_of_the_recursion_to_45_digits(functions):
    values = plausible_values(functions.model)
    p = [values[n] for n in functions.model.parameters]
    with mpmath.workdps(50):
        for case in cases(functions, values, n=2, seed=9):
            dt = evaluate_decimal(functions.deflection, 50, p=p, q=case.q, w=case.w)["dt"]
            for a, b in zip(dt, case.dt, strict=True):
                assert abs(a - b) <= mpmath.mpf(10) ** -45 * max(abs(x) for x in dt)


def test_inverse_and_compensation_of_the_reference_satisfy_their_equations(functions):
    with mpmath.workdps(50):
        (case,) = cases(functions, plausible_values(functions.model), n=1, seed=4)
        assert case.K is not None
        product = mpmath.matrix(_rows(case.K, 6)) * mpmath.matrix(_rows(case.C, 6))
        assert mpmath.mnorm(product - mpmath.eye(6), "inf") < mpmath.mpf(10) ** -38
        step = mpmath.matrix([q - c for q, c in zip(case.q, case.q_cmd, strict=True)])
        assert (
            mpmath.norm(mpmath.matrix(_rows(case.J, 6)) * step - mpmath.matrix(case.dt))
            < mpmath.mpf(10) ** -40
        )


def _rows(flat, columns: int) -> list:
    return [list(flat[k : k + columns]) for k in range(0, len(flat), columns)]


def test_single_precision_refuses_a_clock_that_it_cannot_resolve(functions):
    shape = {"time": 480.0, "start": 1.7e9}
    model = functions.model.with_effect(EffectInstance("thermal_drift", {"link": 3}, shape))
    with pytest.raises(UserError, match=r"clock begins at 1700000000 s.*double precision"):
        emit_c(Functions(model), Options(targets=("c",), precision="float"))


def test_single_precision_refuses_a_value_that_it_does_not_hold(functions):
    grown = functions.model.with_effect(EffectInstance("payload_error", {"load": "payload"}))
    heavy = grown.with_values(dict(grown.values) | {"payload_error_payload_m": 1e60})
    with pytest.raises(UserError, match=r"payload_error_payload_m = 1e\+60 does not fit single precision"):
        emit_c(Functions(heavy), Options(targets=("c",), precision="float"))


@pytest.mark.parametrize("power", [0.5, 1.0])
def test_powers_of_the_weight_on_a_slide_are_within_single_precision(power: float, tmp_path) -> None:
    """As products of powers of whole numbers their parts are not: SymPy takes fractions apart."""
    if find_compiler() is None:
        pytest.skip("no C compiler")
    shape = {"width": 1.0, "load": 50.0, "power": power, "tapered_mass": 26.572050000000004}
    model = joints_only(load("scara")).with_effect(EffectInstance("hysteresis", {"joint": 3}, shape))
    made = generate(model, tmp_path / "code", Options(precision="float", targets=("c",)))
    assert made.verification.selftest is not None
    assert not re.search(r"\binff?\b", (tmp_path / "code" / "scara.c").read_text())


def test_a_number_that_single_precision_lacks_is_refused() -> None:
    assert CAlgebra(single=True).literal(3.4e38).endswith("f")
    with pytest.raises(UserError, match=r"number 1e\+39, which does not fit single precision: use double"):
        CAlgebra(single=True).literal(1e39)
