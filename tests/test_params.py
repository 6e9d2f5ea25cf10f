"""Parameters at start-up: every number to the last bit, every mistake named, nothing taken from another structure."""

from __future__ import annotations

import ctypes
import math
import struct
import subprocess
import tomllib
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.params import emit_params, params_text
from symstiff.codegen.targets import TARGETS
from symstiff.effects.instance import EffectInstance
from symstiff.errors import UserError
from symstiff.files import write_tree
from tests.generated_c import STRICT, compiler, model, run, shared_library, written

ROBOT = "scara"
PRELOADED = {"angle_1": -1.0, "angle_2": 0.0, "angle_3": 1.0}
SYNTAX, UNKNOWN, DUPLICATE, NUMBER, HASH, MISSING = range(-10, -16, -1)


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """precision → function(text) → (status, values, line)."""
    readers = {}
    for precision in ("double", "float"):
        folder = written(tmp_path_factory.mktemp(precision), ROBOT, precision, ("c", "params"))
        flags = ("-O1", "-g", "-fsanitize=undefined", "-fno-sanitize-recover=all")
        library = shared_library(folder, [f"{ROBOT}.c", f"{ROBOT}_params.c"], flags)
        real = np.float64 if precision == "double" else np.float32

        def read(text: bytes | str, library=library, real=real):
            data = text.encode() if isinstance(text, str) else text
            values = np.full(len(model(ROBOT).parameters), np.nan, real)
            line = ctypes.c_size_t(99)
            call = library.scara_params_read
            status = call(
                data, ctypes.c_size_t(len(data)), values.ctypes.data_as(ctypes.c_void_p), ctypes.byref(line)
            )
            return status, values, line.value

        readers[precision] = read
    return readers


def lines():
    return params_text(model(ROBOT)).splitlines()


def with_first(value: str) -> str:
    """The text of the model with another first value (line 3)."""
    text = lines()
    text[2] = f"{model(ROBOT).parameters[0]} = {value}"
    return "\n".join([*text, ""])


@pytest.mark.parametrize("precision", ["double", "float"])
def test_what_python_writes_is_read_to_the_last_bit(reader, precision):
    status, values, line = reader[precision](params_text(model(ROBOT)))
    assert (status, line) == (0, 0)
    np.testing.assert_array_equal(values, model(ROBOT).vector().astype(values.dtype))


def test_the_text_is_toml_and_takes_other_values():
    m = model(ROBOT)
    values = {n: 1e-8 * (k + 1) for k, n in enumerate(m.parameters)}
    assert tomllib.loads(params_text(m, values)) == {"parameter_hash": m.structure_hash, **values}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"k9_99": 1.0}, "no parameter 'k9_99'"),
        ({"c1": math.nan}, "c1: expected a finite number, found 'nan'"),
    ],
)
def test_values_that_the_model_cannot_have_are_not_written(values, message):
    m = model(ROBOT)
    values = {m.parameters[0] if k == "c1" else k: v for k, v in values.items()}
    with pytest.raises(UserError, match=message.replace("c1", m.parameters[0])):
        params_text(m, values)


@settings(max_examples=400, deadline=None)
@given(
    st.floats(min_value=0.0, max_value=1.7e308) | st.floats(0.0, 1e-307),
    st.sampled_from(["repr", "%.16e", "%.25e", "%.3g"]),
)
def test_any_number_is_read_as_python_reads_it(reader, x, form):
    text = repr(x) if form == "repr" else form % x
    status, values, _ = reader["double"](with_first(text))
    assert status == 0
    assert values[0] == float(text)


@settings(max_examples=400, deadline=None)
@given(st.integers(1, 0x7F7FFFFF) | st.integers(1, 0x01000000), st.integers(-1, 1), st.booleans())
def test_single_precision_is_rounded_once(reader, bits, side, negative):
    """Numbers just beside the middle between two neighbours: rounding through double would go astray."""
    low = struct.unpack("f", struct.pack("I", bits))[0]
    high = struct.unpack("f", struct.pack("I", bits + 1))[0] if bits < 0x7F7FFFFF else low
    middle = (Fraction(low) + Fraction(high)) / 2
    digits = 38 - math.floor(math.log10(low)) if low < 1 else 30
    scaled = round(middle * 10**digits) + side * (10 if side else 0)
    text = f"{scaled}e-{digits}"
    if len(str(scaled)) > 40:
        return
    exact = Fraction(scaled, 10**digits)
    below, above = exact - Fraction(low), Fraction(high) - exact
    wanted = low if below < above or (below == above and bits % 2 == 0) else high
    status, values, _ = reader["float"](with_first(("-" if negative else "") + text))
    assert status == 0
    assert abs(float(values[0])) == wanted


READABLE = [
    "0", "0.0", "-0.0e5", "0.000e-9999", "+1.5", "1e+3", "007.25", "12345678901234567890123.5e-30",
    "0." + "0" * 200 + "1", "2.2250738585072014e-308", "1.7976931348623157e308", "4503599627370496.5",
    "4503599627370497.5", "9007199254740993", "1e-308", "1e-400", "-1e-9999", "5e-324", "2.4703282292062328e-324",
    "0e99999", "0e-12345", "0.00e+" + "9" * 50, "1e-10000", "-1.5e-99999", "1e-" + "9" * 50, "1e-" + "0" * 20 + "7",
    "0." + "0" * 400 + "1e+400", "0." + "0" * 998 + "12e1000", "0" * 999 + "1e-5", "1" + "0" * 39 + "e-40",
    "2.4703282292062327e-324", "7.4109846876186981e-324", "2.2250738585072011e-308", "2.2250738585072013e-308",
]  # fmt: skip
UNREADABLE = [
    "1.", ".5", "1e", "e5", "+", "-", "--1", "1 2", "0x10", "nan", "inf", "1,5", "1e400", "1e99999",
    "1e10000", "1e" + "9" * 50, "0." + "0" * 999 + "1e10000", "0" * 1001, "1e-", "1e9999x",
    "1.8e308", "1.2.3", "1f", "1_000", "1" * 41, '"1"', "1e1.5", "١",
]  # fmt: skip


@pytest.mark.parametrize("text", READABLE)
def test_these_numbers_are_read(reader, text):
    status, values, _ = reader["double"](with_first(text))
    assert status == 0
    assert values[0] == float(text)


@pytest.mark.parametrize("precision", ["double", "float"])
def test_values_too_small_for_the_type_are_read_as_the_compiler_reads_them(reader, precision):
    """The text of one run holds the model's values, and its single precision has the nearest: no value is refused."""
    m = model(ROBOT)
    small = [1e-50, -1e-60, 1e-44, 3e-46, 1.1e-38, 5e-324, 1e-310, 1e-200]
    values = {n: small[k % len(small)] for k, n in enumerate(m.parameters)}
    status, found, line = reader[precision](params_text(m, values))
    assert (status, line) == (0, 0)
    np.testing.assert_array_equal(found, np.array([*values.values()]).astype(found.dtype))


@pytest.mark.parametrize("text", UNREADABLE)
def test_what_is_no_number_of_the_type_is_refused_with_its_line(reader, text):
    status, values, line = reader["double"](with_first(text))
    assert (status, line) == (NUMBER, 3)
    assert not values.any()


@pytest.mark.parametrize(("change", "status", "line"), [
    (lambda t: [*t, "k9_99 = 1.0"], UNKNOWN, -1),
    (lambda t: [*t, t[3]], DUPLICATE, -1),
    (lambda t: [*t, t[1]], DUPLICATE, -1),
    (lambda t: t[:-1], MISSING, 0),
    (lambda t: [t[0], *t[2:]], MISSING, 0),
    (lambda t: [], MISSING, 0),
    (lambda t: [t[0], t[1].replace('"', ""), *t[2:]], HASH, 2),
    (lambda t: [t[0], t[1][:-3] + '"', *t[2:]], HASH, 2),
    (lambda t: [t[0], 'parameter_hash = "' + "0" * 64 + '"', *t[2:]], HASH, 2),
    (lambda t: [*t[:3], "what", *t[3:]], SYNTAX, 4),
    (lambda t: [*t[:3], "= 3", *t[3:]], SYNTAX, 4),
    (lambda t: [*t[:3], "key =", *t[3:]], SYNTAX, 4),
    (lambda t: [*t[:3], "a b = 1", *t[3:]], SYNTAX, 4),
    (lambda t: [*t[:3], "[section]", *t[3:]], SYNTAX, 4),
])  # fmt: skip
def test_every_mistake_has_its_name_and_its_line(reader, change, status, line):
    text = change(lines())
    found, values, at = reader["double"]("\n".join([*text, ""]))
    assert (found, at) == (status, len(text) if line < 0 else line)
    assert not values.any()


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_text_that_was_cut_short_is_refused_wherever_the_cut_is(reader, precision):
    """A part of the last number is a number, and one of another size: every line must be ended."""
    m = model(ROBOT)
    text = params_text(m, dict.fromkeys(m.parameters, 2.5e-07))
    assert reader[precision](text)[0] == 0
    for at in range(len(text)):
        status, values, line = reader[precision](text[:at])
        whole = text[at - 1 : at] in ("", "\n")
        assert (status, line) == (MISSING, 0) if whole else status in (SYNTAX, HASH)
        assert not values.any()
    cut = text.rindex("e-07") + 1
    assert reader[precision](text[:cut])[::2] == (SYNTAX, text.count("\n"))


def test_order_blanks_comments_and_line_ends_do_not_matter(reader):
    text = lines()
    shuffled = [text[1], "", "   # nothing", *(f"\t{line}  " for line in reversed(text[2:]))]
    for end in ("\n", "\r\n"):
        status, values, _ = reader["double"](end.join([*shuffled, ""]))
        assert status == 0
        np.testing.assert_array_equal(values, model(ROBOT).vector())


def test_values_of_another_structure_are_refused(reader):
    m = model(ROBOT)
    other = replace(m, loads="wrench")
    assert other.structure_hash != m.structure_hash
    assert reader["double"](params_text(other, dict(m.values)))[0] == HASH


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.integers(0, 900), st.integers(0, 40))
def test_no_bytes_upset_the_reader(reader, junk, at, cut):
    """Junk spliced into a good text: an error or good values, never anything in between; undefined behaviour aborts."""
    good = params_text(model(ROBOT)).encode()
    text = good[:at] + junk + good[at + cut :]
    for precision in ("double", "float"):
        status, values, _ = reader[precision](text)
        assert status in range(-15, -9) or (status == 0 and np.isfinite(values).all())
        assert status == 0 or not values.any()


def test_null_pointers_are_errors(tmp_path):
    folder = written(tmp_path, ROBOT, "double", ("c", "params"))
    library = shared_library(folder, [f"{ROBOT}.c", f"{ROBOT}_params.c"])
    values = np.ones(len(model(ROBOT).parameters))
    assert (
        library.scara_params_read(None, ctypes.c_size_t(3), values.ctypes.data_as(ctypes.c_void_p), None)
        == -1
    )
    assert not values.any()
    assert library.scara_params_read(b"x", ctypes.c_size_t(1), None, None) == -1


def test_nothing_is_read_beyond_the_length(tmp_path):
    """A buffer without a terminating zero, under the address sanitizer."""
    folder = written(tmp_path, ROBOT, "double", ("c", "params"))
    (folder / "probe.c").write_text(
        '#include "scara_params.h"\n#include <stdio.h>\n#include <stdlib.h>\n#include <string.h>\n'
        "int main(void) { char all[9000]; size_t n = fread(all, 1, sizeof all, stdin), i; scara_params_t p;\n"
        "for (i = 0; i <= n; ++i) { char *c = malloc(i + (i == 0)); memcpy(c, all, i);\n"
        "if (scara_params_read(c, i, &p, NULL) > 0) { return 2; } free(c); }\n"
        "return scara_params_read(all, n, &p, NULL) == 0 ? 0 : 1; }\n"
    )
    sources = ["probe.c", "scara.c", "scara_params.c"]
    run(compiler(), "-fsanitize=address,undefined", "-g", "-I.", *sources, "-o", "probe", "-lm", cwd=folder)
    done = subprocess.run(
        ["./probe"], cwd=folder, input=(folder / "scara.params").read_bytes(), capture_output=True
    )
    assert done.returncode == 0, done.stderr.decode()


def test_the_reader_uses_neither_heap_nor_double_in_single_precision(tmp_path):
    folder = written(tmp_path, ROBOT, "float", ("c", "params"))
    text = (folder / "scara_params.c").read_text()
    assert "double" not in text.split("*/", 1)[1]
    run(compiler(), *STRICT, "-O2", "-c", "-I.", "scara_params.c", "-o", "p.o", cwd=folder)
    needed = {line.split()[-1] for line in run("nm", "-u", "p.o", cwd=folder).splitlines()}
    assert needed <= {"ldexpf", "memset", "memcpy", "__stack_chk_fail", "_GLOBAL_OFFSET_TABLE_"}


def test_the_parameters_of_effects_are_read_too(tmp_path):
    m = model(ROBOT).with_effect(EffectInstance("backlash", {"joint": 1}, {}))
    text = emit_params(Functions(m), Options(targets=("c", "params")))["scara_params.c"].decode()
    for e in m.effect_parameters:
        assert f'"{e.name}"' in text
        assert f"p->{e.name} = x;" in text


def test_a_grown_model_is_written_without_the_compliance_that_an_effect_replaced():
    """The model keeps the value of what was replaced; its text has a line for each parameter that is left."""
    m = model("kuka_kr270")
    grown = m.with_effect(EffectInstance("gravity_compensator", {"joint": 2}, PRELOADED))
    (gone,) = set(m.parameters) - set(grown.parameters)
    assert grown.values[gone] > 0
    found = tomllib.loads(params_text(grown))
    assert [*found] == ["parameter_hash", *grown.parameters]
    assert found[m.parameters[0]] == m.values[m.parameters[0]]
    assert found == tomllib.loads(params_text(grown, m.values))


@pytest.mark.parametrize("spoil", ["", "k9_99 = 1.0\n"])
def test_a_reader_sets_time_and_branch_to_their_defaults_whatever_stood_there(tmp_path, spoil):
    compiler()
    m = model(ROBOT)
    m = m.with_effect(EffectInstance("thermal_drift", {"link": 2}, {"time": 600.0, "start": 50.0}))
    m = m.with_effect(EffectInstance("hysteresis", {"joint": 1}, {"width": 5.0}))
    functions, options = Functions(m), Options(targets=("c", "params"))
    for target in options.targets:
        write_tree(tmp_path, TARGETS[target].emitter()(functions, options))
    library = shared_library(tmp_path, [f"{ROBOT}.c", f"{ROBOT}_params.c"])
    text = (params_text(m) + spoil).encode()
    numbers = np.full(len(m.parameters) + 2, np.nan)  # parameters, then branch and time in some order
    library.scara_params_read(text, ctypes.c_size_t(len(text)), numbers.ctypes.data_as(ctypes.c_void_p), None)
    assert sorted(numbers[-2:]) == [1.0, 50.0]
