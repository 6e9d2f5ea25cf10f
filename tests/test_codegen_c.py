"""The C sources alone: strict builds, analysers, sanitizers, fuzzing, errors, and what every option changes."""

from __future__ import annotations

import ctypes
import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from symstiff.codegen.compact import compact
from symstiff.codegen.emit import emit_c, operations
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load

NAME = "kuka_kr270"
STRICT = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wfloat-conversion",
    "-Wdouble-promotion",
]
STRICT += ["-Wshadow", "-Werror"]
LAYOUTS = ("unrolled", "compact")
VARIANTS = [(p, y) for p in ("double", "float") for y in LAYOUTS]
E_NULL, E_NONFINITE, E_SINGULAR, E_RANGE = -1, -2, -3, -5


def need(*tools: str) -> None:
    for tool in tools:
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is missing")


def done(*command: str | Path, cwd: Path | None = None) -> str:
    """Run a command that must succeed; what it prints."""
    result = subprocess.run([str(c) for c in command], cwd=cwd, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout + result.stderr


@pytest.fixture(scope="module")
def functions() -> Functions:
    model = StiffnessModel.of(reduce(load(NAME), "gravity"))
    return Functions(model.with_values(dict.fromkeys(model.parameters, 1e-7)))


@pytest.fixture(scope="module")
def folders(functions, tmp_path_factory) -> dict[tuple[str, str], Path]:
    """One folder of sources a variant (precision, layout)."""
    found = {}
    for precision, layout in VARIANTS:
        folder = found[precision, layout] = tmp_path_factory.mktemp(f"{precision}_{layout}")
        write_tree(folder, emit_c(functions, Options(precision=precision, layout=layout, targets=("c",))))
    return found


@pytest.fixture(scope="module")
def libraries(folders) -> dict[tuple[str, str], ctypes.CDLL]:
    need("gcc")
    for folder in folders.values():
        done(
            "gcc",
            "-O1",
            *STRICT,
            "-fPIC",
            "-shared",
            f"{NAME}.c",
            f"{NAME}_selftest.c",
            "-o",
            "lib.so",
            "-lm",
            cwd=folder,
        )
    return {variant: ctypes.CDLL(str(folder / "lib.so")) for variant, folder in folders.items()}


def real(precision: str):
    return ctypes.c_float if precision == "float" else ctypes.c_double


def controller_sources() -> list[str]:
    """What runs on a controller, as opposed to host programs and whole-workspace batches."""
    return [f"{NAME}.c", f"{NAME}_selftest.c"]


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_builds_without_a_warning_and_passes_its_selftest(folders, compiler, variant, tmp_path):
    need(compiler)
    folder = folders[variant]
    program = tmp_path / "selftest"
    sources = [folder / f for f in (*controller_sources(), f"test_{NAME}.c")]
    done(compiler, "-O1", *STRICT, f"-I{folder}", *sources, "-o", program, "-lm")
    assert "selftest: passed" in done(program)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_selftest_fails_when_a_default_of_the_arithmetic_is_changed(folders, precision, tmp_path):
    need("gcc")
    folder = folders[precision, "unrolled"]
    text = (folder / f"{NAME}.c").read_text()
    literal = "1.25f" if precision == "float" else "1.25"
    assert literal in text  # the length of link 2
    (tmp_path / f"{NAME}.c").write_text(text.replace(literal, literal.replace("1.25", "1.2501")))
    sources = [tmp_path / f"{NAME}.c", folder / f"{NAME}_selftest.c", folder / f"test_{NAME}.c"]
    done("gcc", "-O1", f"-I{folder}", *sources, "-o", tmp_path / "selftest", "-lm")
    failed = subprocess.run([str(tmp_path / "selftest")], capture_output=True, text=True, check=False)
    assert failed.returncode == 1
    assert "failed" in failed.stdout


@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_selftest_fails_where_a_stiffness_is_not_a_number(folders, precision, tmp_path):
    need("gcc")
    folder = folders[precision, "unrolled"]
    text = (folder / f"{NAME}_selftest.c").read_text()
    call = f"const int status = {NAME}_stiffness(&test_params, c->q, K);"
    assert call in text
    spoilt = text.replace(call, f"{call}\n    K[7] = (K[7] - K[7]) / (K[7] - K[7]);")
    (tmp_path / f"{NAME}_selftest.c").write_text(spoilt)
    sources = [folder / f"{NAME}.c", tmp_path / f"{NAME}_selftest.c", folder / f"test_{NAME}.c"]
    done("gcc", "-O1", f"-I{folder}", *sources, "-o", tmp_path / "selftest", "-lm")
    failed = subprocess.run([str(tmp_path / "selftest")], capture_output=True, text=True, check=False)
    assert (failed.returncode, "failed" in failed.stdout) == (1, True)


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only"])
@pytest.mark.parametrize("source", [f"{NAME}.c", f"{NAME}_batch.c"])
def test_shortcuts_that_take_the_checks_for_nan_away_do_not_compile(folders, flag, source, tmp_path):
    need("gcc")
    folder = folders["double", "unrolled"]
    command = ["gcc", "-O2", flag, f"-I{folder}", "-c", str(folder / source), "-o", str(tmp_path / "x.o")]
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode != 0
    assert "compile without -ffast-math and -ffinite-math-only" in refused.stderr


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_selftest_is_clean_under_address_and_undefined_behaviour_sanitizers(folders, variant, tmp_path):
    need("gcc")
    sources = [folders[variant] / f for f in (*controller_sources(), f"test_{NAME}.c")]
    flags = [
        "-g",
        "-O1",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
        f"-I{folders[variant]}",
    ]
    done("gcc", *flags, *sources, "-o", tmp_path / "selftest", "-lm")
    assert "passed" in done(tmp_path / "selftest")


@pytest.mark.slow
@pytest.mark.parametrize("variant", [("double", "unrolled"), ("float", "compact")])
def test_fuzzing_finds_no_unnamed_error_and_no_output_that_is_not_finite(folders, variant, tmp_path):
    folder = folders[variant]
    sources = [folder / f for f in (f"fuzz_{NAME}.c", f"{NAME}.c", f"{NAME}_batch.c")]
    flags = ["-g", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{folder}"]
    program = tmp_path / "fuzz"
    fuzzer = ["clang", *flags, "-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all"]
    try:
        built = subprocess.run(
            [*fuzzer, *sources, "-o", program, "-lm"], capture_output=True, text=True, check=False
        )
        has_fuzzer = built.returncode == 0
    except FileNotFoundError:
        has_fuzzer = False
    if has_fuzzer:
        assert "Done 4000 runs" in done(program, "-runs=4000", "-seed=1", "-max_len=200", cwd=tmp_path)
    else:
        need("gcc")
        flags += [f"-D{NAME.upper()}_FUZZ_MAIN", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
        done("gcc", *flags, *sources, "-o", program, "-lm")
        assert "20000 runs" in done(program, "20000")


def test_the_fuzzing_harness_notices_a_result_that_is_not_finite(folders, tmp_path):
    need("gcc")
    folder = folders["double", "unrolled"]
    text = (folder / f"{NAME}.c").read_text()
    (tmp_path / f"{NAME}.c").write_text(text.replace("status = status_of(dt, 6);", ""))
    sources = [tmp_path / f"{NAME}.c", folder / f"fuzz_{NAME}.c", folder / f"{NAME}_batch.c"]
    program = tmp_path / "fuzz"
    done("gcc", f"-D{NAME.upper()}_FUZZ_MAIN", "-O1", f"-I{folder}", *sources, "-o", program, "-lm")
    failed = subprocess.run([str(program), "20000"], capture_output=True, text=True, check=False)
    assert failed.returncode != 0
    assert "violated: outputs are finite" in failed.stderr


def _deflection(library: ctypes.CDLL, precision: str, p, q, w) -> tuple[int, list[float]]:
    out = (real(precision) * 6)(*[1.0] * 6)
    return getattr(library, f"{NAME}_deflection")(p, q, w, out), list(out)


def _numbers(precision: str, values):
    return (real(precision) * len(values))(*values)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_every_bad_input_gives_its_named_error_and_zeros(libraries, functions, precision):
    library = libraries[precision, "unrolled"]
    p = _numbers(precision, [1e-7] * len(functions.model.parameters))
    q, w = [0.1, -1.0, 1.2, 0.3, 0.5, -0.2], [0.0, 0.0, -2000.0, 0.0, 0.0, 0.0]
    assert _deflection(library, precision, p, _numbers(precision, q), _numbers(precision, w))[0] == 0
    zeros = [0.0] * 6
    assert _deflection(library, precision, None, _numbers(precision, q), _numbers(precision, w)) == (
        E_NULL,
        zeros,
    )
    assert _deflection(library, precision, p, None, _numbers(precision, w)) == (E_NULL, zeros)
    assert _deflection(library, precision, p, _numbers(precision, q), None) == (E_NULL, zeros)
    for bad in (math.nan, math.inf, -math.inf):
        for k in range(6):
            spoilt = _numbers(precision, [*q[:k], bad, *q[k + 1 :]])
            assert _deflection(library, precision, p, spoilt, _numbers(precision, w)) == (E_NONFINITE, zeros)
            spoilt = _numbers(precision, [*w[:k], bad, *w[k + 1 :]])
            assert _deflection(library, precision, p, _numbers(precision, q), spoilt) == (E_NONFINITE, zeros)
    large = 1e308 if precision == "double" else 3e38
    overflow = _numbers(precision, [large] * 6)
    big = _numbers(precision, [large] * len(functions.model.parameters))
    assert _deflection(library, precision, big, _numbers(precision, q), overflow) == (E_NONFINITE, zeros)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_singular_pose_leaves_the_joint_command_as_it_was(libraries, functions, precision):
    library = libraries[precision, "unrolled"]
    p = _numbers(precision, [1e-7] * len(functions.model.parameters))
    q = _numbers(precision, [0.1, -1.0, 1.2, 0.3, 0.0, -0.2])  # axes 4 and 6 on one line
    w, q_cmd = _numbers(precision, [0, 0, -2000, 0, 0, 0]), _numbers(precision, [9.0] * 6)
    compensate = getattr(library, f"{NAME}_compensate")
    assert compensate(p, q, w, q_cmd) == E_SINGULAR
    assert list(q_cmd) == list(q)
    w[0] = math.nan
    assert compensate(p, q, w, q_cmd) == E_NONFINITE
    assert list(q_cmd) == list(q)
    q[2] = math.inf
    assert compensate(p, q, w, q_cmd) == E_NONFINITE
    assert list(q_cmd) == [0.0] * 6


@pytest.mark.parametrize(("precision", "bend"), [("double", 1e-6), ("float", 1e-3)])
def test_a_correction_that_is_not_small_leaves_the_joint_command_as_it_was(
    libraries, functions, precision, bend
):
    library = libraries[precision, "unrolled"]
    p = _numbers(precision, [1e-7] * len(functions.model.parameters))
    q = _numbers(precision, [0.1, -1.0, 1.2, 0.3, bend, -0.2])  # axes 4 and 6 almost on one line
    w, q_cmd = _numbers(precision, [0, 0, -2500, 0, 0, 0]), _numbers(precision, [9.0] * 6)
    compensate = getattr(library, f"{NAME}_compensate")
    assert compensate(p, q, w, q_cmd) == E_RANGE
    assert list(q_cmd) == list(q)
    q[4] = 0.5
    assert compensate(p, q, w, q_cmd) == 0
    assert 0 < max(abs(a - b) for a, b in zip(q_cmd, q, strict=True)) < 0.05


def test_output_arrays_may_be_the_input_arrays(libraries, functions):
    library = libraries["double", "unrolled"]
    p = _numbers("double", [1e-7] * len(functions.model.parameters))
    q, w = [0.1, -1.0, 1.2, 0.3, 0.5, -0.2], [100.0, 50.0, -2000.0, 10.0, 20.0, 30.0]
    for function in ("deflection", "compensate"):
        call = getattr(library, f"{NAME}_{function}")
        apart = _numbers("double", [0.0] * 6)
        assert call(p, _numbers("double", q), _numbers("double", w), apart) == 0
        for k in (0, 1):
            inputs = [_numbers("double", q), _numbers("double", w)]
            assert call(p, *inputs, inputs[k]) == 0
            assert list(inputs[k]) == list(apart)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_compact_layout_gives_the_same_matrices_to_rounding(libraries, functions, precision):
    size = 6 * len(functions.model.stiffness_parameters)
    epsilon = np.finfo(real(precision)).eps
    rng = np.random.default_rng(5)
    p = _numbers(precision, rng.uniform(0.5e-7, 1.5e-7, size // 6))
    for _ in range(20):
        q, w = _numbers(precision, rng.uniform(-3, 3, 6)), _numbers(precision, rng.uniform(-2000, 2000, 6))
        A = [
            np.array(_called(libraries[precision, y], "observation", precision, size, q, w)) for y in LAYOUTS
        ]
        assert np.abs(A[0] - A[1]).max() <= 40 * epsilon * np.abs(A[0]).max()
        K = [np.array(_called(libraries[precision, y], "stiffness", precision, 36, p, q)) for y in LAYOUTS]
        assert np.abs(K[0] - K[1]).max() <= 1e5 * epsilon * np.abs(K[0]).max()


def _called(library: ctypes.CDLL, function: str, precision: str, size: int, *inputs) -> list[float]:
    out = (real(precision) * size)()
    getattr(library, f"{NAME}_{function}")(*inputs, out)
    return list(out)


def test_the_compact_layout_is_less_code_and_says_what_it_costs(folders, functions, tmp_path):
    need("gcc", "size")
    text = {}
    for layout in LAYOUTS:
        done("gcc", "-std=c99", "-Os", "-c", folders["double", layout] / f"{NAME}.c", "-o", tmp_path / "m.o")
        text[layout] = int(done("size", tmp_path / "m.o").splitlines()[1].split()[0])
    assert text["compact"] < 0.75 * text["unrolled"]
    counts = {y: operations(functions, Options(layout=y)) for y in LAYOUTS}
    assert counts["compact"]["deflection"] == counts["unrolled"]["deflection"]
    assert counts["compact"]["compliance"]["mul"] > counts["unrolled"]["compliance"]["mul"]
    header = (folders["double", "compact"] / f"{NAME}.h").read_text()
    assert f"{counts['compact']['observation']['mul']} mul" in header


def test_the_compact_tables_name_each_term_once(functions):
    layout = compact(functions.model)
    assert len(set(layout.terms)) == len(layout.terms)
    assert {p for p, _, _ in layout.terms} == set(range(len(functions.model.stiffness_parameters)))
    for _, at, by in layout.terms:
        assert max(at, by) < len(layout.joints)


def test_two_sets_of_options_never_share_a_model_hash(functions):
    model = functions.model
    options = [
        Options(precision=p, layout=y, targets=t) for p, y in VARIANTS for t in (("c",), ("c", "casadi"))
    ]
    hashes = {o.model_hash(model.structure_hash, dict(model.values)) for o in options}
    assert len(hashes) == len(options)


def _recorded(folder: Path) -> set[tuple[str, str]]:
    """(rule, file) of the deviation record."""
    return set(
        re.findall(r"^\| ([\d.]+) \| \w+ \| `([^`]+)` \| \S.*\|$", (folder / "MISRA.md").read_text(), re.M)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variant", "sources"),
    [
        (("double", "unrolled"), [f"{NAME}.c", f"{NAME}_selftest.c", f"{NAME}_batch.c"]),
        (("float", "compact"), [f"{NAME}.c", f"{NAME}_selftest.c"]),
    ],
)
def test_misra_findings_and_the_deviation_record_are_the_same(folders, variant, sources):
    need("cppcheck")
    folder = folders[variant]
    command = ["cppcheck", "-q", "--std=c99", "--addon=misra", "--template={file}:{id}"]
    printed = done(*command, *sources, cwd=folder)
    if "Did not find addon" in printed:
        pytest.skip("the MISRA addon of cppcheck is missing")
    findings = {(rule, file) for file, rule in re.findall(r"^(.*):misra-c2012-([\d.]+)$", printed, re.M)}
    assert findings == {(rule, file) for rule, file in _recorded(folder) if file in (*sources, f"{NAME}.h")}


@pytest.mark.slow
@pytest.mark.parametrize("variant", [("double", "unrolled"), ("float", "compact")])
def test_the_static_analyser_of_gcc_is_silent(folders, variant, tmp_path):
    need("gcc")
    for source in controller_sources():
        printed = done(
            "gcc",
            "-std=c99",
            "-fanalyzer",
            "-O2",
            "-Wall",
            "-Werror",
            "-c",
            source,
            "-o",
            tmp_path / "o",
            cwd=folders[variant],
        )
        assert printed == ""


@pytest.mark.parametrize("variant", [("double", "unrolled"), ("float", "compact")])
def test_clang_tidy_has_nothing_to_say(folders, variant):
    need("clang-tidy")
    sources = [*controller_sources(), f"{NAME}_batch.c", f"test_{NAME}.c", "main.c", f"fuzz_{NAME}.c"]
    checks = "-checks=-*,bugprone-*,cert-*,clang-analyzer-*"
    printed = done(
        "clang-tidy",
        "-quiet",
        checks,
        "--warnings-as-errors=*",
        *sources,
        "--",
        "-std=c99",
        cwd=folders[variant],
    )
    assert "warning:" not in printed
