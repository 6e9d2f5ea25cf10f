"""Mistakes in a table: refused in one line with file and line, whatever the damage."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.calibration.tables.checks import check_robot
from symstiff.calibration.tables.table import read_table
from symstiff.errors import UserError
from symstiff.robot import from_table
from tests.test_tables import GOOD, TWO, attempt, line_of, refusal, save


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("a,90,0.5,10,-2.5,3,p2", "a,,0.5,10,-2.5,3,p2", 4, "missing"),
        ("b,-45", ",-45", 5, "missing"),
        ("b,-45", "b\x1b[31m,-45", 5, "cannot be printed"),
        ("3,p2,1,", "3,p\x072,1,", 4, "cannot be printed"),
        ("-2.5,3,p2,1,", "-2.5,3,p2,,", 4, "missing"),
        ("1.1,2100", "nan,2100", 3, "finite"),
        ("1.1,2100", "inf,2100", 3, "finite"),
        ("1.1,2100", "1e999,2100", 3, "finite"),
        ("1.1,2100", "1.1 mm,2100", 3, "number"),
        ("1.1,2100", "1_1,2100", 3, "number"),
        ("b,-45,-0.5", "b,-45,-30", 5, "degrees"),
        ("b,-45,-0.5", "b,-45,-0,5", 5, "cells"),
        ("1.5,0.02,4", "1.5,0,4", 5, "positive"),
        ("1.5,0.02,4", "1.5,-0.02,4", 5, "positive"),
        ("1.5,0.02,4", "1.5,1e-300,4", 5, "no device reads as finely"),
        ("down", "sideways", 5, "up or down"),
        ("1.4,0.01,2,294.15,1,up,2", "1.4,0.01,2,-1,1,up,2", 3, "-1 K is below absolute zero"),
        (
            "1.4,0.01,2,294.15,1,up,2",
            "1.4,0.01,2,1e308,1,up,2",
            3,
            "1e308 K is no temperature that a robot has",
        ),
        (
            "1.4,0.01,2,294.15,1,up,2",
            "1.4,0.01,1e308,294.15,1,up,2",
            3,
            "1e308 min is no time of a measurement",
        ),
        (
            "1.4,0.01,2,294.15,1,up,2",
            "1.4,0.01,1e10,294.15,1,up,2",
            3,
            "1e10 min is no time of a measurement",
        ),
        ("1.4,0.01,2,294.15,1,up,2", "1.4,1e-9,2,294.15,1,up,2", 3, "differ by more than 1e+06"),
        ("a,90,0.5,10,-2.5,3,p2", "a,90,0.5,1e-200,0,0,p2", 4, "nothing feels a load of 1e-200 N: write 0"),
        ("1.4,0.01,2,294.15,1,up,2", "1.4,0.01,2,294.15,1,up,1", 3, "duplicate"),
        ("a,90,0.5,10,-2.5,3,p2", "a,90,0.6,10,-2.5,3,p2", 4, "label"),
        ("-0.0031", "-3.1", 3, "unit"),
        ("q1[deg]", "q1", 1, "without a unit"),
        ("fx[N]", "fx", 1, "without a unit"),
        ("fx[N]", "fx[]", 1, "without a unit"),
        ("fx[N]", "fx[kg]", 1, "does not fit"),
        ("fx[N]", "fx[mm]", 1, "does not fit"),
        ("q1[deg]", "q1[N]", 1, "does not fit"),
        ("mx[N*m]", "mx[N]", 1, "does not fit"),
        ("dx[mm]", "dx[deg]", 1, "does not fit"),
        ("repeat", "repeat[s]", 1, "no unit"),
        ("fx[N]", "fx[N", 1, "header"),
        ("fx[N]", "", 1, "header"),
        ("fx[N]", "Fx[N]", 1, "did you mean 'fx'"),
        ("sigma_x[mm]", "sigma_rz[rad]", 1, "not measured"),
        ("dx[mm]", "x[mm]", 1, "deflection"),
        ("q2[rad]", "q3[rad]", 1, "q2"),
        ("q2[rad]", "q1[rad]", 1, "two columns"),
        ("pose,", "name,", 1, "unknown column"),
        (
            "pose,",
            "# 12.3.2026\npose,",
            1,
            "unknown column '# 12.3.2026': comments are not read: remove such lines",
        ),
        ("q1[deg]", "q1(deg)", 1, "unknown column 'q1(deg)': write q1[deg]"),
        ("fx[N]", "fx {kN}", 1, "write fx[kN]"),
        ("fx[N]", "f(x)", 1, "known are"),
        ("1.1,2100", "1.1,\uff12100", 3, "is no number"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_mistake_is_refused_with_file_and_line(tmp_path, old, new, line, says):
    assert old in GOOD
    message = refusal(tmp_path, GOOD.replace(old, new, 1))
    assert line_of(message) == line
    assert says in message


LONG = "\x1b]0;" + "x" * 5000


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("dx[mm]", f"dx[m{LONG}]"),
        ("dx[mm]", LONG),
        ("repeat", f"repeat[{LONG}]"),
        ("q1[deg]", f"q{'1' * 5000}[deg]"),
        ("dx[mm]", f"[{LONG}"),
        ("fx[N]", "fx[\x1cN\x1c],fx[N]"),
        ("down", LONG),
        ("1.1,2100", f"{LONG},2100"),
        ("1.1,2100", f"{'0' * 5000}inf,2100"),
        ("1.1,2100", f"1{'0' * 300},2100"),
        ("1.4,0.01,2,294.15,1,up,2", f"1.4,0.01,2,-{'1' * 300},1,up,2"),
    ],
)
def test_a_message_repeats_no_control_codes_and_no_long_text_of_a_table(tmp_path, old, new):
    assert old in GOOD
    message = refusal(tmp_path, GOOD.replace(old, new, 1))
    assert message.isprintable()
    assert len(message.replace(str(tmp_path), "")) < 300


def test_a_message_repeats_no_long_label(tmp_path):
    label = "y" * 5000
    moved = GOOD.replace("\na,", f"\n{label},").replace(
        f"{label},90,0.5,10,-2.5,3,p2", f"{label},90,0.6,10,-2.5,3,p2"
    )
    assert len(refusal(tmp_path, moved)) < 300 + 2 * len(str(tmp_path))
    strange = read_table(save(tmp_path, GOOD.replace("p2", label)))
    with pytest.raises(UserError, match=r"no marker 'yyy.*[.]{3}'") as error:
        check_robot(strange, from_table(TWO))
    assert len(str(error.value)) < 300 + len(str(tmp_path))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "line 1: empty"),
        ("\n\n", "empty"),
        ("pose,q1[deg],fx[N],dx[mm]\n", "line 1: a header and no rows"),
        (b"pose,q1[deg]\n\x00\x01\x02", "line 2: not a text file"),
        (b"pose,q1[deg]\n\xff\xfe", "line 2: not text"),
        (b"\x89PNG\r\n\x1a\n", "not text"),
        ("pose;q1[deg];dx[mm]\na;1;2\n", "commas"),
        ("q1[deg],fx[N],dx[mm]\n1,1,1\n", "no column 'pose'"),
        ("pose,fx[N],dx[mm]\na,1,1\n", "no joint columns"),
        ("pose,q1[deg],fx[N]\na,1,1\n", "nothing measured"),
        ("pose,q1[deg],fx[N],dx[mm]\na,1,0,1\n", "every wrench is zero"),
        ("pose,q1[deg],dx[mm]\na,1,1\n", "every wrench is zero"),
        ("pose,q1[deg],x[mm],rx[rad]\na,1,1,0\n", "rotation vector"),
        ("pose,q1[deg],x[mm],y[mm],z[mm],rx[rad],ry[rad],rz[rad]\na,1,1,1,1,90,0,0\n", "degrees"),
        ('pose,q1[deg],x[mm]\n"a,1,1\n', "line 2: not a row"),
        ('pose,q1[deg],x[mm]\na,1,1\n"b,1,1\nc,1,1\nd,1,1\n', "line 3: not a row"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_table_is_refused(tmp_path, text, says):
    assert says in refusal(tmp_path, text)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"nowhere\.csv"):
        read_table(tmp_path / "nowhere.csv")
    with pytest.raises(UserError, match="cannot read"):
        read_table(tmp_path)


@settings(max_examples=150, deadline=None)
@given(st.one_of(st.binary(max_size=300), st.text(max_size=300).map(str.encode)), st.integers(0, len(GOOD)))
def test_any_damage_to_a_file_is_refused_in_one_line_or_harmless(tmp_path_factory, noise, where):
    path = Path(tmp_path_factory.getbasetemp()) / "damaged.csv"
    for content in (noise, GOOD[:where].encode() + noise[:20] + GOOD[where:].encode()):
        path.write_bytes(content)
        table, message = attempt(path)
        assert "\n" not in message
        assert table is None or np.isfinite(np.hstack([table.q, table.w])).all()
