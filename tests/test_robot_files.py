"""Robot files: one clear line for every mistake, and nothing else for any bytes."""

from __future__ import annotations

import copy
import math
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.errors import UserError
from symstiff.model import joints_only
from symstiff.reduction.reduce import reduce
from symstiff.robot import from_table, library, load, parse, parse_exact

GOOD = """
format = 1
name = "two_link"
[[joint]]
a = 1
alpha = "pi/2"
d = 0
limits = [-3.1, 3.1]
[joint.link]
beam_axis = "x"
mass = 2.0
com = [0.5, 0, 0]
[joint.link.compliance]
11 = 1e-8
[[joint]]
type = "prismatic"
a = 0.7
alpha = 0
d = 0.1
limits = [0, 0.3]
[tool]
xyz = [0, 0, 0.2]
[[marker]]
name = "p1"
xyz = [0.1, 0, 0]
[gravity_compensator]
joint = 1
"""


def test_the_rounding_of_a_beams_direction_is_no_component_and_its_length_says_nothing() -> None:
    """As d·cos(alpha) in floating point: an oblique axis would keep combinations that no data show."""
    plain = GOOD.replace('beam_axis = "x"', "beam_axis = [0.33, -0.3, 0.0]")
    rounded = plain.replace("-0.3, 0.0]", "-0.3, 1.8369701987210297e-17]")
    assert parse(rounded.encode(), "robot.toml") == parse(plain.encode(), "robot.toml")
    sizes = []
    for direction in ("[1e-20, 0, 2e-20]", "[1e150, 0, 2e150]", "[1, 0, 2]"):
        robot = parse(GOOD.replace('"x"', direction).encode(), "robot.toml")
        sizes.append(len(reduce(robot).parameters))
    assert len(set(sizes)) == 1


# --- mistakes --------------------------------------------------------------------------------------------


def complaint(data: bytes) -> str:
    with pytest.raises(UserError) as caught:
        parse(data, "robot.toml")
    return str(caught.value)


def test_the_file_that_the_following_tests_spoil_is_good() -> None:
    assert parse(GOOD.encode()).dof == 2


def template(name: str, *rows: str) -> str:
    return f'[[template]]\nname = "{name}"\npattern = {list(rows)}\n[tool]'


JOINT = '[[joint]]\na = 1\nalpha = "pi/2"\nd = 0\nlimits = [-3.1, 3.1]\n'
MISTAKES = [
    ("format = 1", "", "format: missing: add format = 1"),
    ("format = 1", "format = 2", "format: 2: this program reads format 1: write format = 1"),
    ("format = 1", "format = 1.0", "format: 1.0: this program"),
    ("format = 1", "format = true", "format: true: this program"),
    ('name = "two_link"', "", "name: missing"),
    ('name = "two_link"', 'name = "class"', "name: 'class' is a word of C or C++, which"),
    ('name = "two_link"', 'name = "int"', "use e.g. int_robot"),
    ('name = "two_link"', 'name = "math"', "name: 'math' is a header of the C library"),
    ('name = "two_link"', 'name = "sin"', "name: 'sin' is a function of the C library"),
    ('name = "two_link"', 'name = "m"', "name: 'm' is a system's library"),
    ('name = "two_link"', 'name = "main"', "name: 'main' is a file or a target of the generated build"),
    (
        'name = "two_link"',
        'name = "my__arm"',
        "two underscores together, which C++, Structured Text and CasADi do not have: use e.g. my_arm",
    ),
    ('name = "two_link"', 'name = "arm_"', "name: 'arm_' gives names with two underscores together"),
    ('name = "two_link"', 'name = "x_rls"', "name: 'x_rls' is what files of a robot 'x' are called"),
    ('name = "two_link"', 'name = "2link"', "name: '2link' is no identifier: use [a-z][a-z0-9_]"),
    ('name = "two_link"', 'name = "two-link"', "name: 'two-link' is no identifier"),
    ('name = "two_link"', 'name = "a\\n"', "is no identifier"),
    ('name = "two_link"', 'name = "x/*"', "is no identifier"),
    ('name = "two_link"', "name = 1.5", "name: expected text in quotes, found 1.5"),
    ('name = "two_link"', "name.a.b = 1", "name: expected text in quotes, found a table"),
    ("format = 1", 'format = 1\ntitle = "a\\u001bb"', "title: use one line"),
    ("format = 1", 'format = 1\nconvention = "craig"', "convention: 'craig': use 'standard' or 'modified'"),
    ("format = 1", "format = 1\njoints = 3", "joints: unknown key: did you mean 'joint'?"),
    ("format = 1", "format = 1\nqqq = 3", "qqq: unknown key: remove it"),
    ("format = 1", "format = 1\nmass = 3", "mass: this key belongs in another table"),
    ('alpha = "pi/2"', 'alhpa = "pi/2"', "joint[1].alhpa: unknown key: did you mean 'alpha'?"),
    ('alpha = "pi/2"', "", "joint[1].alpha: missing: add it"),
    ('alpha = "pi/2"', "alpha = 90", "joint[1].alpha: 90 looks like degrees: angles are in radians"),
    ('alpha = "pi/2"', "alpha = -90.0", "joint[1].alpha: -90 looks like degrees"),
    ('alpha = "pi/2"', "alpha = \"__import__('os')\"", "joint[1].alpha: cannot read"),
    ('alpha = "pi/2"', "alpha = nan", "alpha: expected a finite number, found nan: write one such as 0.35"),
    ('alpha = "pi/2"', "alpha = -inf", "joint[1].alpha: expected a finite number, found -inf"),
    ('alpha = "pi/2"', "alpha = true", "joint[1].alpha: expected a number, found true"),
    ('alpha = "pi/2"', "alpha = [0]", "joint[1].alpha: expected a number or an expression"),
    ('alpha = "pi/2"', "alpha = {}", "joint[1].alpha: expected a number or an expression"),
    ('alpha = "pi/2"', "alpha = 1979-05-27", "joint[1].alpha: expected a number or an expression"),
    ("a = 0.7", "a = 1e999999999", "joint[2].a: expected a finite number of at most 300 digits, found 1e9"),
    ("a = 0.7", 'a = "1e999999999"', "joint[2].a: expected a finite number of at most 300 digits, found 1e9"),
    ("a = 0.7", f"a = 1{'0' * 1500}", "joint[2].a: expected a finite number, found an integer beyond"),
    ("a = 0.7", f"a = 1{'0' * 5000}", "is longer than 2000 characters"),
    ("a = 0.7", "a = 1979-13-77", "not valid TOML"),
    ("a = 0.7", f"a = 0x{'f' * 1500}", "joint[2].a: expected a finite number, found an integer beyond"),
    ("a = 0.7", "a = 9223372036854775808", "joint[2].a: 9.22337e+18 m is longer than any robot"),
    ("a = 0.7", 'a = "1/0"', "joint[2].a: '1/0': division by zero: write another divisor"),
    ("a = 0.7", "a = 700", "joint[2].a: 700 m is longer than any robot: lengths are in metres, not millim"),
    ("a = 0.7", "a = 0.7\na = 0.8", "not valid TOML: Cannot overwrite a value"),
    ('"prismatic"', '"linear"', "joint[2].type: 'linear': use 'revolute' or 'prismatic'"),
    ("limits = [0, 0.3]", "limits = [0, 300]", "joint[2]: limits [0, 300] look like millimetres"),
    ("limits = [0, 0.3]", "limits = [0.3, 0]", "joint[2]: limits [0.3, 0]: the lower one comes first"),
    ("limits = [0, 0.3]", "limits = [0]", "joint[2].limits[2]: missing: add it"),
    ("limits = [0, 0.3]", "limits = 0.3", "joint[2].limits: expected an array"),
    ("limits = [-3.1, 3.1]", "limits = [-185, 185]", "joint[1]: limits [-185, 185] look like degrees"),
    ("limits = [-3.1, 3.1]", "compliance = -1e-6", "joint[1].compliance: a compliance is not negative"),
    ("limits = [-3.1, 3.1]", "compliance = 4e5", "joint[1].compliance: 400000 looks like a stiffness"),
    (
        "joint = 1\n",
        "joint = 1\ns0 = -0.2\n",
        "gravity_compensator.s0: a spring's free length is not negative",
    ),
    ("joint = 1\n", "", "gravity_compensator.joint: missing: add it"),
    ("joint = 1\n", "joint = 0\n", "gravity_compensator.joint: 0: give at least 1"),
    (
        "joint = 1\n",
        "joint = 1979-05-27\n",
        "gravity_compensator.joint: expected an integer, found 1979-05-27",
    ),
    (
        "joint = 1\n",
        "joint = 1\nax = 0\nay = 0\n",
        "ax and ay are both 0: a spring that is held in the joint's axis turns nothing",
    ),
    ("joint = 1\n", "joint = 1\nL = 0\n", "gravity_compensator.L: a spring's lever is longer than nothing"),
    ("11 = 1e-8", "22 = 1e-8\n66 = 1e-8\n26 = 2e-8", "entry 26: of an elastic body its square is at most"),
    ("11 = 1e-8", "22 = 0\n26 = 2e-8", "0 times any: correct 2e-08, or one of these"),
    ("11 = 1e-8", "22 = 0\n66 = 1e-8\n26 = 2e-8", "0 times 1e-08: correct 2e-08, or one of these"),
    ("mass = 2.0", "mass = -2.0", "joint[1].link.mass: a mass is between 0 and"),
    ("com = [0.5, 0, 0]", "com = [500, 0, 0]", "joint[1].link.com[1]: 500 m is longer"),
    ("com = [0.5, 0, 0]", "com = [0.5, 0]", "joint[1].link.com[3]: missing"),
    ("com = [0.5, 0, 0]", "com = [0.5, 0, 0, 0]", "joint[1].link.com: 4 entries: give at most 3"),
    ("com = [0.5, 0, 0]", 'com = "x"', "joint[1].link.com: expected an array [...], found 'x'"),
    ('beam_axis = "x"', 'beam_axis = "w"', 'joint[1].link.beam_axis: use "x", "y", "z" or a direction'),
    ('beam_axis = "x"', "beam_axis = [1, 0]", "joint[1].link.beam_axis: use"),
    ('beam_axis = "x"', "beam_axis = [0, 0, 0]", "joint[1].link.beam_axis: a beam's direction cannot be"),
    ('beam_axis = "x"', 'template = "soft"', "joint[1].link.template: unknown template 'soft'"),
    ("11 = 1e-8", "21 = 1e-8", "joint[1].link.compliance: entry '21': name it by row and column"),
    ("11 = 1e-8", "11 = -1e-8", "joint[1].link.compliance: entry 11: a compliance on the diagonal"),
    ("11 = 1e-8", '11 = "x"', "joint[1].link.compliance.11: cannot read 'x'"),
    ("[tool]", "[tol]", "tol: unknown key: did you mean 'tool'?"),
    ("xyz = [0, 0, 0.2]", "xyz = [0, 0, 200]", "tool.xyz[3]: 200 m is longer"),
    ("xyz = [0, 0, 0.2]", "rpy = [0, 0, 90]", "tool.rpy[3]: 90 looks like degrees"),
    ("[tool]\nxyz = [0, 0, 0.2]", "[[tool]]\nxyz = [0, 0, 0.2]", "tool: expected a table, found an array"),
    ('name = "p1"', 'name = "tcp"', "marker: 'tcp' stands for two points"),
    ('name = "p1"', 'name = "p1"\nxyz=[0,0,0]\n[[marker]]\nname="p1"', "marker: 'p1' stands for two points"),
    ('name = "p1"', 'name = "p 1"', "marker[1].name: 'p 1' is no identifier"),
    ("[[marker]]", "[marker]", "marker: expected an array of tables: write [[marker]]"),
    ("joint = 1", "joint = 2", "gravity_compensator.joint: 2 is no revolute joint"),
    ("joint = 1", "joint = 9", "9 is no revolute joint of this robot: give one of 1"),
    ("joint = 1", "joint = true", "gravity_compensator.joint: expected an integer, found true"),
    ("joint = 1", 'joint = "1"', "gravity_compensator.joint: expected an integer, found '1'"),
    ("joint = 1", "joint = 0", "gravity_compensator.joint:"),
    ("joint = 1", "joint = 1\nL = 184.72", "gravity_compensator.L: 184.72 m is longer"),
    ("[tool]", '[[template]]\nname = "beam"\npattern = []\n[tool]', "template[1].pattern[1]: missing"),
    (
        "[tool]",
        template("t", "*.....", "......", "......", "......", "......", "*....."),
        "template[1].pattern: a template is symmetric",
    ),
    (
        "[tool]",
        template("t", "x", ".", ".", ".", ".", "."),
        "template[1].pattern: a template has six rows of six characters",
    ),
    (
        "[tool]",
        template("t", "......", ".....*", "......", "......", "......", ".*...."),
        "template[1].pattern: row 2: entry 26 is a coupling without 22 and 66 on the diagonal, which no elastic body",
    ),
    (
        "[tool]",
        template("t", "*.....", ".*....", "....*.", "......", "..*.*.", "......"),
        "template[1].pattern: row 3: entry 35 is a coupling without 33 on the diagonal",
    ),
    (
        "[tool]",
        template("full", *["......"] * 6),
        "template: the names must differ",
    ),
    ("[tool]", "[tool", "not valid TOML"),
    ("[tool]", "tool", "not valid TOML"),
    ("format = 1", "format = 1\nx = " + "[\n" * 3000 + "]" * 1500, "nested too deeply"),
    ("format = 1", f"format{'.a' * 900} = 1", "format: a table: this program"),
    ("format = 1", f"format = 1\nx{'.a' * 9000} = 1", "line 3 is longer than 2000 characters"),
]


@pytest.mark.parametrize(("good", "bad", "expected"), MISTAKES, ids=[f"{m[1][:30]!r}" for m in MISTAKES])
def test_a_mistake_is_one_line_that_names_file_key_and_remedy(good: str, bad: str, expected: str) -> None:
    assert good in GOOD
    message = complaint(GOOD.replace(good, bad, 1).encode())
    assert message.startswith("robot.toml: ")
    assert expected in message
    assert message.isprintable()
    assert len(message) < 400


def test_a_robot_without_joints_or_with_two_hundred_is_refused() -> None:
    head = 'format = 1\nname = "r"\n'
    assert "joint: missing: add a [[joint]]" in complaint(head.encode())
    assert "joint: a robot has at least one [[joint]]" in complaint((head + "joint = []\n").encode())
    assert "joint: expected an array of tables: write [[joint]]" in complaint(
        (head + "[joint]\na = 1").encode()
    )
    assert "joint: 200 entries: give at most 64" in complaint((head + JOINT * 200).encode())
    assert parse((head + JOINT * 64).encode()).dof == 64


def test_what_is_no_text_is_refused() -> None:
    assert "not a text file in UTF-8 (byte 0)" in complaint(GOOD.encode("utf-16"))
    assert "not a text file in UTF-8" in complaint(bytes(range(256)))
    assert "larger than" in complaint(b"#" * 300_000)
    assert "not valid TOML" in complaint(b"\x00\x01")
    assert "format: missing" in complaint(b"")


def test_a_byte_order_mark_and_windows_line_ends_do_no_harm() -> None:
    assert parse(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode()) == parse(GOOD.encode())


def test_a_place_without_a_robot_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is a directory: give a robot file"):
        load(tmp_path)
    for near in ("kuka_kr720", "KUKA_KR270"):
        with pytest.raises(
            UserError, match=rf"{near}: no such robot: did you mean 'kuka_kr270'\? .* one of "
        ):
            load(near)
    with pytest.raises(UserError, match=r"missing\.toml: no such robot file"):
        load(tmp_path / "missing.toml")
    for name in ("a\0b", "x" * 5000, "\udcff\ud800", "", "ur10/x"):
        with pytest.raises(UserError) as caught:
            load(name)
        assert str(caught.value).isprintable()


def test_a_model_in_the_place_of_a_robot_is_told_where_to_go(tmp_path: Path) -> None:
    file = tmp_path / "model.toml"
    joints_only(load("planar2r")).save(file)
    with pytest.raises(UserError, match=r"model\.toml: is a model, not a robot: .* --start"):
        load(file)


def test_a_robot_file_is_loaded_by_its_path(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(GOOD)
    assert load(file) == load(str(file)) == parse(GOOD.encode())


def test_a_decimal_of_a_file_is_the_number_that_was_written() -> None:
    robot = parse(GOOD.replace("a = 0.7", "a = 0.70000000000000000001").encode())
    assert robot.joint[1].a.rational == Fraction(70000000000000000001, 10**20)
    assert parse(GOOD.replace("a = 0.7", "a = 0.7_5").encode()).joint[1].a.rational == Fraction(3, 4)


def test_an_unknown_marker_is_named_with_those_that_are_known() -> None:
    robot = parse(GOOD.encode())
    assert robot.marker_position("tcp") == robot.tool.xyz
    assert robot.marker_position("p1") == robot.marker[0].xyz
    with pytest.raises(UserError, match="no marker 'p2': known are tcp, p1"):
        robot.marker_position("p2")


# --- whatever the bytes ----------------------------------------------------------------------------------


@contextmanager
def one_line_at_most() -> Iterator[None]:
    """Whatever happens inside, it is no exception but a UserError of one readable line."""
    message = ""
    try:
        yield
    except UserError as error:
        message = str(error)
    assert not message or message.isprintable()
    assert len(message) < 600


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_arbitrary_bytes_give_a_robot_or_one_line(data: bytes) -> None:
    with one_line_at_most():
        parse(data)


library_texts = st.sampled_from(
    [(resources.files("symstiff.robot") / "library" / f"{name}.toml").read_text() for name in library()]
)
chunks = st.one_of(
    st.text(max_size=12),
    st.text("0123456789.eE+-*/()pi \"'[]{}=,\n#_xob", max_size=20),
    st.sampled_from(
        ["nan", "-inf", "1e999", "true", "[[joint]]\n", "a.b.c = 1\n", '"""', "1979-13-77", "\\u0000"]
    ),
)


@settings(max_examples=300, deadline=None)
@given(library_texts, st.data(), chunks)
def test_a_spoilt_library_file_gives_a_robot_or_one_line(text: str, data: st.DataObject, chunk: str) -> None:
    start = data.draw(st.integers(0, len(text)))
    length = data.draw(st.integers(0, 12))
    with one_line_at_most():
        parse((text[:start] + chunk + text[start + length :]).encode("utf-8", "surrogatepass"))


toml_values = st.recursive(
    st.one_of(
        st.booleans(),
        st.integers(),
        st.integers(-(10**6000), 10**6000),
        st.floats(),
        st.text(max_size=30),
        st.text("0123456789.e+-*/()pi ", max_size=30),
        st.dates(),
        st.times(),
        st.datetimes(),
    ),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
GOOD_TABLE = tomllib.loads(GOOD)


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at] * bool(at) + [place for key, inner in items for place in places(inner, (*at, key))]


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(places(GOOD_TABLE)), toml_values)
def test_any_value_at_any_key_gives_a_robot_or_one_line(place: tuple[Any, ...], value: Any) -> None:
    table: Any = copy.deepcopy(GOOD_TABLE)
    *parents, last = place
    inner = table
    for key in parents:
        inner = inner[key]
    inner[last] = value
    with one_line_at_most():
        from_table(table)


@settings(max_examples=300, deadline=None)
@given(st.text("0123456789.eE+-*/()piπ ", max_size=60) | st.text(max_size=30))
def test_any_text_is_a_finite_exact_number_or_one_line(text: str) -> None:
    with one_line_at_most():
        assert math.isfinite(float(parse_exact(text)))


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=40))
def test_any_name_is_a_robot_of_the_library_or_one_line(name: str) -> None:
    if not Path(name.replace("\0", "_")).exists():
        with one_line_at_most():
            load(name)
