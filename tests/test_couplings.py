"""Couplings of eliminated parameters: they hold, in closed form and in the notation that is printed."""

from __future__ import annotations

import re
from fractions import Fraction

import pytest
import sympy as sp
from numerics import assert_couplings_hold

from symstiff.reduction import reduce
from symstiff.reduction.closed_form import _fit, closed_form
from symstiff.reduction.reading import combination
from symstiff.robot import from_table, library, load
from symstiff.robot.table import to_table

KR270 = load("kuka_kr270")


@pytest.mark.slow
@pytest.mark.parametrize("name", library())
def test_couplings_hold_in_an_independent_observation_matrix(name: str) -> None:
    for loads, measure in (("wrench", "pose"), ("gravity", "position")):
        assert_couplings_hold(reduce(load(name), loads, measure))


@pytest.mark.parametrize("name", library())
def test_couplings_in_closed_form_are_the_fractions_at_the_robots_lengths(name: str) -> None:
    robot = load(name)
    r = reduce(robot, "gravity", "pose")
    numbers = {f"{k}_{i}": getattr(j, k).sympy() for i, j in enumerate(robot.joint, 1) for k in ("a", "d")}
    if robot.convention == "modified":
        shape = [j.a.sympy() for j in robot.joint[1:]] + [sp.S.Zero]
        numbers |= {f"a_{i}": a for i, a in enumerate(shape, 1)}
    numbers |= {f"t_{axis}": v.sympy() for axis, v in zip("xyz", robot.tool.xyz, strict=True)}
    found, letters = closed_form(r), 0
    assert set(found) == set(r.partition.couplings)
    for e, row in found.items():
        assert set(row) == set(r.partition.couplings[e])
        for k, expression in row.items():
            letters += bool(expression.free_symbols)
            value = expression.subs({s: numbers[s.name] for s in expression.free_symbols})
            exact: Fraction = r.partition.couplings[e][k]
            assert value == sp.Rational(exact.numerator, exact.denominator)
    assert letters > 0


def test_a_coupling_reads_in_dh_symbols() -> None:
    found = closed_form(reduce(KR270, "gravity", "pose"))
    a_2 = sp.Symbol("a_2", real=True)
    assert found["k2_26"]["k0_33"] == -a_2
    assert found["k2_26"]["k1_66"] == 1 / a_2


@pytest.mark.parametrize("tool", [[0.05, 0.1, 0.4], [0.1, 0.1, 0.3]])
def test_couplings_of_a_kr270s_tool_hold_for_other_tools(tool: list[float]) -> None:
    here = {**to_table(KR270)["tool"], "xyz": tool}
    other = reduce(from_table({**to_table(KR270), "tool": here}), "gravity", "position")
    found = closed_form(reduce(KR270, "gravity", "position"))
    numbers = {f"{k}_{i}": getattr(j, k).sympy() for i, j in enumerate(KR270.joint, 1) for k in ("a", "d")}
    numbers |= {f"t_{axis}": sp.Rational(str(v)) for axis, v in zip("xyz", tool, strict=True)}
    for e in ("k6_26", "k6_35"):
        assert set(found[e]) == set(other.partition.couplings[e])
        for k, expression in found[e].items():
            value = expression.subs({s: numbers[s.name] for s in expression.free_symbols})
            assert value == sp.Rational(str(other.partition.couplings[e][k]))


def test_what_depends_on_lengths_in_no_short_form_is_a_decimal(monkeypatch: pytest.MonkeyPatch) -> None:
    r = reduce(KR270, "gravity", "position")
    whole = closed_form(r)
    monkeypatch.setattr("symstiff.reduction.closed_form._DEGREES", 3)
    decimals = 0
    for e, row in closed_form(r).items():
        for k, c in row.items():
            assert c == whole[e][k] or c.is_Float
            decimals += bool(c.is_Float)
            if c.is_Float:
                assert whole[e][k].free_symbols
                assert float(c) == pytest.approx(float(r.partition.couplings[e][k]), rel=1e-14)
    assert decimals == 4


@pytest.mark.parametrize("wrong", ["1 + a_2/1000000", "-1", "1/(a_1 - 1)"])
def test_a_formula_that_misses_the_exact_value_gives_way_to_a_decimal(
    wrong: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What fits modulo one prime by accident, or is infinite at the robot's own lengths: here a_1 is one metre."""
    r = reduce(load("planar2r"), "force", "position")
    letters = [(e, k) for e, row in closed_form(r).items() for k, c in row.items() if c.free_symbols]
    assert len(letters) > 5
    factor = sp.sympify(wrong, locals={s: sp.Symbol(s, real=True) for s in ("a_1", "a_2")})
    monkeypatch.setattr("symstiff.reduction.closed_form._fit", lambda *given: factor * _fit(*given))
    found = closed_form(r)
    for e, k in letters:
        assert found[e][k].is_Float
        assert float(found[e][k]) == pytest.approx(float(r.partition.couplings[e][k]), rel=1e-14)


def test_couplings_are_printed_in_one_notation_and_mean_what_was_found() -> None:
    found = closed_form(reduce(KR270, "gravity", "pose"))
    assert combination(found["k1_26"]) == "(k0_44 + k0_55 − k1_66 − k1_44)/a_1 − a_1·k0_33"
    t, d = sp.symbols("t_x d_6")
    made_up = {
        "c6": t**-2,
        "k3_44": -t / (d * (d + t)),
        "k4_55": sp.Rational(-5, 3),
        "k5_66": 1,
        "k5_55": (t - d) * t,
    }
    assert (
        combination(made_up)
        == "c6/t_x² − t_x·k3_44/(d_6·(d_6 + t_x)) − 5·k4_55/3 + k5_66 + t_x·(−d_6 + t_x)·k5_55"
    )
    raised = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹", "0123456789")
    for row in (
        made_up,
        *found.values(),
        *closed_form(reduce(load("planar2r"), "force", "position")).values(),
    ):
        text = combination(row)
        assert not set(text) & set("*^-")
        plain = re.sub("[⁰¹²³⁴-⁹]+", lambda power: f"**{power[0].translate(raised)}", text)
        powers = plain.replace("−", "-").replace("·", "*")
        wanted = sp.Add(*[sp.sympify(c) * sp.Symbol(k) for k, c in row.items()])
        same = {str(s): s for s in wanted.free_symbols}
        assert sp.simplify(sp.sympify(powers, locals=same) - wanted) == 0
