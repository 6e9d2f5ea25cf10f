"""Laws without a name by a sliding joint's variable are polynomials in metres, those by an angle are waves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.arrays import Array
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.remarks import _of_rows
from symstiff.discrepancy.laws.law import Law, largest_load
from symstiff.discrepancy.laws.of_angles import laws_of_angle
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.search.localise import FittedLaw
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.report.code import formulas
from symstiff.report.html import render
from symstiff.report.unnamed import law_in_short, law_text
from symstiff.report.words import sentence
from symstiff.robot import load
from tests.test_assemble import design, readings, truth_of
from tests.test_discrepancy_engine import arm

CODE = {"folder": True, "compiled": True, "text": "compiled", "error": 1e-15}


def _values(problem: Problem, v: int, text: str) -> Array:
    """A law's text, evaluated."""
    assert problem.q is not None
    assert problem.tau is not None
    names = {f"q{j + 1}": x for j, x in enumerate(problem.q.T)}
    load_share = problem.tau[:, v] / largest_load(problem, v)
    functions = {"sin": np.sin, "cos": np.cos, "exp": np.exp}
    return np.asarray(eval(text.replace("^", "**"), functions, {"tau": load_share, **names}))


@pytest.mark.parametrize(("slides", "shift"), [((), 0.0), ((1,), 0.0), ((0, 2), 0.7), ((1,), -3.0)])
def test_the_text_of_a_law_is_what_its_values_are(slides: tuple[int, ...], shift: float) -> None:
    a = arm(8).problem
    assert a.q is not None
    problem = replace(a, slides=slides, q=a.q + shift)
    for v in range(3):
        for law in laws_of_angle(problem, v):
            for text, values in zip(law.text, law.values.T, strict=True):
                assert _values(problem, v, text) == pytest.approx(values, abs=1e-12)


def _waves(a: Problem, v: int, j: int) -> list[Law]:
    """What laws by an angle have always been."""
    assert a.q is not None
    assert a.tau is not None
    t, out = a.tau[:, v] / largest_load(a, v), []
    for n in (1, 2, 3, 5) if j == v else (1, 2):
        wave = np.column_stack([np.sin(n * a.q[:, j]), np.cos(n * a.q[:, j])])
        name = f"{n}*q{j + 1}" if n > 1 else f"q{j + 1}"
        out.append(Law((f"tau*sin({name})", f"tau*cos({name})"), t[:, None] * wave, j == v))
        if n <= 2:
            out.append(Law((f"sin({name})", f"cos({name})"), wave, j == v))
    return out


def _of(laws: list[Law], joint: int) -> list[Law]:
    """Laws by a joint's variable alone, but for spots and an encoder's scale."""
    alone = (law for law in laws if law.text[0].count("q") == 1 and "exp" not in law.text[0] and law.text[1:])
    return [law for law in alone if f"q{joint}" in law.text[0]]


def _same(found: list[Law], expected: list[Law]) -> bool:
    return all(
        a.text == b.text and a.own == b.own and np.array_equal(a.values, b.values)
        for a, b in zip(found, expected, strict=True)
    )


def test_laws_by_a_revolute_joint_are_waves_beside_a_slide_too() -> None:
    problem = arm(8).problem
    for slides in ((), (1,)):
        for v in range(3):
            laws = laws_of_angle(replace(problem, slides=slides), v)
            for j in {0, 1, 2} - set(slides):
                assert _same(_of(laws, j + 1), _waves(problem, v, j))


def test_laws_by_a_slide_are_powers_over_its_range() -> None:
    a = arm(8).problem
    assert a.q is not None
    way = np.linspace(0.1, 0.9, a.rows)
    problem = replace(a, slides=(1,), q=np.column_stack([a.q[:, 0], way, a.q[:, 2]]))
    other, own = (_of(laws_of_angle(replace(problem, differences=True), v), 2) for v in (0, 1))
    x = "(q2 - 0.5)/0.4"
    assert [law.text for law in other] == [
        (f"tau*{x}", f"tau*({x})^2"), (x, f"({x})^2"), (f"tau*({x})^3", f"tau*({x})^4"), (f"({x})^3", f"({x})^4"),
    ]  # fmt: skip
    assert [law.text[0] for law in own][-1] == f"tau*({x})^5"
    assert len(own) == 5
    assert np.abs(other[1].values).max() == pytest.approx(1.0)
    assert not _of(laws_of_angle(replace(problem, q=np.ones_like(problem.q)), 0), 2)


def test_what_repeats_along_a_slide_is_looked_for_in_positions_up_to_sixteen_times() -> None:
    a = arm(8).problem
    assert a.q is not None
    way = np.linspace(0.1, 0.9, a.rows)
    problem = replace(a, slides=(1,), q=np.column_stack([a.q[:, 0], way, a.q[:, 2]]))
    laws = [law for law in laws_of_angle(problem, 1) if law.family == "waves along q2"]
    orders = [float(law.text[0].split("*")[0].removeprefix("sin(")) for law in laws]
    assert orders == pytest.approx([np.pi * k / 0.8 for k in range(2, 33)], rel=5e-3)
    for law in laws[::5]:
        for text, values in zip(law.text, law.values.T, strict=True):
            assert _values(problem, 1, text) == pytest.approx(values, abs=1e-12)
    assert not any(law.family.startswith("waves") for law in laws_of_angle(problem, 0))


@pytest.mark.slow
def test_a_rail_whose_error_repeats_is_no_robot_that_misses_its_poses() -> None:
    """The error is the same in all rows of a pose, and passed for the robot's repeatability."""
    table: Measurements = design("scara", "absolute", poses=30)
    values = readings(truth_of("scara"), table)
    values[:, 2] += 1.5e-4 * np.sin(97.0 * table.q[:, 2] + 0.4)
    values[:, :3] += np.random.default_rng(0).normal(size=(len(table), 3)) * 2e-5
    found = diagnose(Task(load("scara"), replace(table, values=values)))
    law = found.last.law
    assert found.verdict == "unexplained"
    assert law is not None
    assert law.virtual_joint == "joint 3"
    assert "sin(9" in law.expression
    assert law.explained > 0.4
    assert not law.scales  # no load is in it, and nobody speaks of one
    assert "with" not in law_text(found, law)
    page = render(found, {"code": CODE, "decide": None}, [])
    assert "To copy, in m: <code>" in page


@pytest.fixture(scope="module")
def found() -> Finding:
    """A slide, a SCARA's quill, that gives way more at both of its ends."""
    table: Measurements = design("scara", "deflection", poses=30)
    x = table.q[:, 2]
    x = (x - x.mean()) / np.ptp(x) * 2
    values = readings(truth_of("scara"), table)
    values[:, 2] += 3e-6 * table.w[:, 2] * (x**2 - 0.3 * x)
    values[:, :3] += np.random.default_rng(0).normal(size=(len(table), 3)) * 1e-5
    values[:, 3:] = np.nan
    return diagnose(Task(load("scara"), replace(table, values=values)))


def test_the_way_of_a_slide_is_no_angle(found: Finding) -> None:
    law = found.last.law
    assert found.verdict == "unexplained"
    assert law is not None
    assert law.virtual_joint == "joint 3"
    text = law_text(found, law)
    assert "t·((q3 − " in text
    assert f"the law Δq = {text} explains" in sentence(found)
    page = render(found, {"code": CODE, "decide": None}, [])
    assert f'<p class="formula">Δq = {text}</p>' in page
    assert "Δθ" not in page[page.index('id="unnamed"') : page.index('id="candidates"')]


@pytest.mark.parametrize(
    ("joint", "told"),
    [(2, "(1.2·t^3) mrad with t = τ/(850 N·m)"), (3, "(1.2·t^3) mm with t = τ/(850 N)")],
)
def test_a_law_is_told_in_the_units_of_its_joint(found: Finding, joint: int, told: str) -> None:
    law = FittedLaw(f"joint {joint}", "0.0012*tau^3", 850.0, 0.9, 0.8, np.zeros(3))
    assert law_text(found, law) == told


def test_what_a_law_is_made_of_is_a_list(found: Finding) -> None:
    law = FittedLaw("joint 1", "0.0012*(tau + weight)*load_case", 850.0, 0.9, 0.8, np.zeros(3))
    assert law_text(found, law).endswith(
        "with t = τ/(850 N·m), load_case growing by 1 from the first load of a pose to the last and weight the load of "
        "the links' own weight in the unit of t"
    )


def test_a_sentence_holds_the_largest_terms_of_a_law(found: Finding) -> None:
    """One of nine terms was a sentence of 567 characters; what the terms shown do not hold is not explained either."""
    four_terms = "4.106e-05*time -2.048e-05*tau*sin(q2) -3.491e-05*tau1*cos(q2) -0.033*(tau1 - 0.2)"
    expression = f"{four_terms} +0.15*branch -1e-06*tau4"
    scales = {"tau1": 37.5, "tau4": 2.0}
    law = FittedLaw("joint 2", expression, 850.0, 0.9, 0.8, np.zeros(6), scales)
    short = "(150·branch − 33·(t1 − 0.2) + 0.0411·time and 3 smaller terms) mrad"
    text = law_in_short(found, law)
    assert text.startswith(f"{short} with t1 = τ1/(37.5 N·m), time running from 0 to 1")
    assert "τ4" not in text
    four = replace(law, expression=four_terms)
    assert law_in_short(found, four) == law_text(found, four)
    said = sentence(replace(found, last=replace(found.last, law=replace(law, virtual_joint="joint 3"))))
    assert "and 3 smaller terms) mm with" in said


@pytest.mark.parametrize(
    ("law", "told"),
    [
        ("tau*load_case", "load_case growing by 1 from the first load of a pose to the last"),
        ("branch*tau", "branch 1 where the load rises and −1 where it falls"),
        ("tau*order", "order running from 0 to 1 over the rows of the table"),
        ("late(tau,0.05)", "late(t, s) following t with the time constant s of the session"),
    ],
)
def test_the_words_of_a_law_are_told(found: Finding, law: str, told: str) -> None:
    text = law_text(found, FittedLaw("joint 2", f"0.0012*{law}", 850.0, 0.9, 0.8, np.zeros(3)))
    assert text.endswith(f" with t = τ/(850 N·m) and {told}")


def test_the_formula_of_a_slides_law_has_its_way_on_the_left() -> None:
    (slide,) = formulas(load("scara"), EffectInstance("backlash", {"joint": 3}, {"weights": 0.0}))
    (turn,) = formulas(load("scara"), EffectInstance("backlash", {"joint": 2}, {"weights": 0.0}))
    assert "<mi>q</mi>" in slide.mathml.partition("<mo>=</mo>")[0]
    assert "&#952;" in turn.mathml.partition("<mo>=</mo>")[0]


def test_rows_are_no_slips_where_a_law_is_told_that_is_still_in_what_is_left(found: Finding) -> None:
    last, view = found.last, found.assembly.situation.view
    residual = last.growth[-1].residual.copy()
    residual[3] = 1e3 * np.abs(residual).max()
    last = replace(last, growth=(*last.growth[:-1], replace(last.growth[-1], residual=residual)))
    assert last.law is not None
    assert _of_rows(view, last) == []
    assert len(_of_rows(view, replace(last, law=None, device_law=None))) == 1
