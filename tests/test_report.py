"""report.html: everything that was found is in it, and it needs nothing from outside."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from symstiff.calibration.tables.table import read_poses
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.numbers import p_equals
from symstiff.discrepancy.findings.result import Found, Name, Quantity, RivalLaw
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance
from symstiff.report.code import _abridged, core, difference, formulas
from symstiff.report.deciding import separation_text
from symstiff.report.folder import write_deciding_poses
from symstiff.report.html import render
from symstiff.report.law_plots import left_with
from symstiff.report.unnamed import law_text
from symstiff.report.verdict import verdict_table
from symstiff.report.words import headline, sentence
from symstiff.robot import load
from symstiff.symbolic.terms import actuated_joint, tau
from tests.diagnosis_data import HARDENING, ROBOT, measured

CODE = {"folder": True, "compiled": True, "text": "compiled", "error": 1e-15}


@pytest.fixture(scope="module")
def named() -> Finding:
    return diagnose(Task(load(ROBOT), measured(HARDENING)))


@pytest.fixture(scope="module")
def unexplained() -> Finding:
    """A deflection that follows the second joint's angle and load in a way that no effect of the catalogue has."""
    table = measured()
    lever = 0.7 * np.hypot(table.w[:, 0], table.w[:, 1]) * np.sin(5 * table.q[:, 1])
    values = table.values.copy()
    values[:, 0] += 3e-6 * lever
    values[:, 1] -= 2e-6 * np.abs(lever)
    return diagnose(Task(load(ROBOT), replace(table, values=values)))


@pytest.fixture(scope="module")
def page(named: Finding) -> str:
    changes = difference(core(named.start.model), core(named.grown.model))
    return render(named, {"code": CODE, "decide": None}, changes)


class Outline(HTMLParser):
    """Sections, resources and whether every element that opens closes."""

    def __init__(self) -> None:
        super().__init__()
        self.sections: list[str] = []
        self.resources: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if tag == "section":
            self.sections.append(found.get("id") or "")
        self.resources += [v or "" for k, v in attrs if k in ("src", "href", "xlink:href", "srcset", "data")]
        if tag not in ("meta", "link", "br", "img", "wbr"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in ("meta", "link", "br", "img", "wbr"):
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def outline(page: str) -> Outline:
    parser = Outline()
    parser.feed(page)
    return parser


def test_the_page_has_every_section(page: str) -> None:
    wanted = {
        "effects", "gap", "steps", "histograms", "map", "laws", "candidates", "untested", "detectable",
        "compliances", "code",
    }  # fmt: skip
    assert wanted <= set(outline(page).sections)


def test_the_page_is_well_formed_and_needs_nothing_from_outside(page: str) -> None:
    found = outline(page)
    assert found.open == []
    assert all(r.startswith(("#", "data:")) for r in found.resources)
    assert not re.search(r"https?://|url\((?!#)|@import|<script|<link|<iframe", page)


def test_every_id_of_the_page_is_there_once_and_what_points_at_one_finds_it(
    page: str, unexplained: Finding
) -> None:
    for text in (page, render(unexplained, {"code": CODE, "decide": None}, [])):
        ids = re.findall(r'\bid="([^"]*)"', text)
        assert len(ids) == len(set(ids))
        assert len(ids) > 20
        assert set(re.findall(r'(?:href="|url\()#([^")]*)', text)) <= set(ids)


def test_the_verdict_is_a_sentence_with_size_unit_and_confidence(page: str) -> None:
    text = re.search(r'id="verdict">(.*?)</p>', page, re.S)
    assert text is not None
    for part in ("nonlinear stiffness at joint 2", "±", "rad/(N·m)", "confidence", "mm"):
        assert part in text.group(1)


def test_the_lack_of_fit_is_the_verdict_files(page: str, named: Finding) -> None:
    told = verdict_table(named)
    assert told["strata"]
    section = page[page.index("Lack of fit by kind") :]
    section = section[: section.index("</table>")]
    for before, after in zip(told["strata"], told["strata_left"], strict=True):
        row = next(r for r in section.split("<tr>") if unescape(r).startswith(f"<td>{before['name']}</td>"))
        assert row.index(f">{before['ratio']:.3g} (") < row.rindex(f">{after['ratio']:.3g} (")


def test_the_step_table_has_max_and_rms_of_every_axis_and_of_positions(page: str, named: Finding) -> None:
    table = page[page.index('id="steps"') : page.index('id="histograms"')]
    for name in (
        "x [mm]",
        "y [mm]",
        "z [mm]",
        "position [mm]",
        "MAX",
        "RMS",
        "no compensation",
        "start model",
    ):
        assert name in table
    last = named.steps[-1].residual * 1e3
    view = named.assembly.situation.view
    z = last[view.component == 2]
    assert f"{np.abs(z).max():.3f}" in table
    assert f"{np.sqrt(np.mean(z**2)):.3f}" in table


def test_the_law_is_shown_as_formula_and_as_text(page: str) -> None:
    laws = page[page.index('id="laws"') : page.index('id="candidates"')]
    assert "<math" in laws
    assert "nonlinear_stiffness_2_c*" in laws
    assert "tau_joint2" in laws
    assert "<svg" in laws


def test_a_law_under_an_arms_weight_is_read_with_letters_and_means_the_same() -> None:
    """The letters, put in their places, give the law: compared in random numbers."""
    robot, rng = load("ur10"), np.random.default_rng(0)
    for effect, shape in (
        ("backlash", {"width": 80.0}),
        ("nonlinear_stiffness", {"load": 100.0, "power": 2.0}),
    ):
        instance = EffectInstance(effect, {"joint": 2}, shape)
        law = instance.realise(robot).terms[0].factor
        letters: dict[sp.Expr, sp.Symbol] = {}
        short = _abridged(law, letters)
        numbers = {s: rng.uniform() for s in law.free_symbols}
        whole = short.xreplace({letter: own for own, letter in letters.items()})
        assert float(whole.xreplace(numbers)) == pytest.approx(float(law.xreplace(numbers)), rel=1e-9)
        assert short.free_symbols == {tau(actuated_joint(2)), *letters.values()}
        assert len(letters) == 1
        (formula,) = formulas(robot, instance)
        assert formula.letters == "a: a function of q2, q3, q4, q5 alone, written out below"
        assert "\na = " in formula.text
        assert len(formula.mathml) < 2000
        told = dict(line.split(" = ") for line in formula.text.splitlines()[1:])
        written = sp.sympify(formula.text.splitlines()[0].split(" += ")[1], {"Abs": sp.Abs}).xreplace(
            {sp.Symbol(letter): sp.sympify(own) for letter, own in told.items()}
        )
        value = float(
            written.xreplace({sp.Symbol(s.name): x for s, x in numbers.items()}).subs(
                f"{effect}_2_{'gap' if effect == 'backlash' else 'c'}", 1
            )
        )
        assert value == pytest.approx(float(law.xreplace(numbers)), rel=1e-4)
        assert max(map(len, re.findall(r"[\d.]+", formula.text))) <= len("0.0012345") + 1
    plain = EffectInstance("gravity_compensator", {"joint": 2}, {})
    assert formulas(load("kuka_kr270"), plain)[0].letters == ""


def test_the_law_of_a_weight_is_a_load_on_its_link_and_no_deflection() -> None:
    for instance in (
        EffectInstance("link_weight", {"link": 4}),
        EffectInstance("force_sensor_bias", {"load": "force_sensor"}, {"tool": 1.0}),
    ):
        laws = formulas(load("kuka_kr270"), instance)
        assert laws
        for law in laws:
            left = law.mathml.split("<mo>=</mo>")[0]
            assert "<mi>W</mi>" in left
            assert "θ" not in left
            assert "&#952;" not in left


def test_the_difference_in_the_code_shows_the_new_parameter(page: str) -> None:
    code = page[page.index('id="code"') :]
    added = re.findall(r'<span class="add">(.*?)</span>', code, re.S)
    assert any("nonlinear_stiffness_2_c;" in line for line in added)  # in the struct
    assert any("p-&gt;nonlinear_stiffness_2_c" in line for line in added)  # in the recursion


def test_a_difference_does_not_mind_how_temporaries_are_numbered() -> None:
    before = ["const double t0 = a*b;", "const double t1 = t0 + c;", "x = t1;"]
    after = [
        "const double t0 = d*d;",
        "const double t1 = a*b;",
        "const double t2 = t1 + c;",
        "x = t2;",
        "y = t0;",
    ]
    changed = [(line.kind, line.text) for line in difference(before, after) if line.kind in "+-"]
    assert changed == [("+", "const double t0 = d*d;"), ("+", "y = t0;")]


def test_what_has_no_name_is_shown_where_it_sits_with_a_fitted_expression(unexplained: Finding) -> None:
    assert unexplained.verdict == "unexplained"
    page = render(unexplained, {"code": CODE, "decide": None}, [])
    part = page[page.index('id="unnamed"') : page.index('id="candidates"')]
    assert "The evidence is strongest at" in part
    assert "<svg" in part
    law = unexplained.last.law
    assert law is not None
    assert law.expression in part
    assert law_text(unexplained, law) in part
    assert "Δθ/τ" in part  # stiffness against the angle: what a person recognises


def test_what_is_left_is_what_the_last_model_leaves(unexplained: Finding) -> None:
    """A joints-only start that the complete model took the place of left more."""
    climbed = replace(unexplained, rms=replace(unexplained.rms, before=100 * unexplained.rms.before))
    assert sentence(climbed) == sentence(unexplained)


def test_a_law_elsewhere_is_said_to_be_elsewhere(unexplained: Finding) -> None:
    law, where = unexplained.last.law, unexplained.last.localisation
    assert law is not None
    assert where is not None
    last = replace(unexplained.last, device_law=None)
    here = replace(last, localisation=replace(where, accused=law.virtual_joint))
    there = replace(last, localisation=replace(where, accused="joint 1 or so"))
    assert f"strongest at {law.virtual_joint}, where the law" in sentence(replace(unexplained, last=here))
    text = sentence(replace(unexplained, last=there))
    assert f"joint 1 or so, without a law there; at {law.virtual_joint} the law" in text


def test_what_has_no_name_is_told_with_how_sure_it_is_and_what_to_do(unexplained: Finding) -> None:
    last, where = unexplained.last, unexplained.last.localisation
    assert where is not None
    text = sentence(unexplained)
    assert f"; noise alone shows as much: {p_equals(min(last.p_missing, last.p_unnamed))})." in text
    for accused, told in (
        ("joint 2", "Look at joint 2 for what gives way so"), ("", "would tell where it sits."),
        ("force sensor", "Check the force sensor, and measure again"),
    ):  # fmt: skip
        at = replace(last, localisation=replace(where, accused=accused), device_law=None)
        assert told in sentence(replace(unexplained, last=at))
    at = replace(last, localisation=replace(where, accused="joint 2"), device_law=None)
    table = replace(unexplained.table, w=np.zeros_like(unexplained.table.w))
    assert "for what moves or measures it so" in sentence(replace(unexplained, last=at, table=table))
    law = last.law
    assert law is not None
    for share in (0.5, -0.1):
        left = replace(last, device_law=None, law=replace(law, cross_validated=share))
        told = "and nothing on poses that were left out" in sentence(replace(unexplained, last=left))
        assert told == (share < 0)


def test_nothing_is_accused_where_nothing_is_missing(unexplained: Finding) -> None:
    assert verdict_table(unexplained)["accused"] == unexplained.accused
    assert verdict_table(replace(unexplained, verdict="nothing_missing"))["accused"] is None


def test_a_law_that_explains_little_is_told_with_its_size_in_standard_deviations(
    unexplained: Finding,
) -> None:
    law, where = unexplained.last.law, unexplained.last.localisation
    assert law is not None
    assert where is not None

    def told(**changes: float) -> str:
        last = replace(unexplained.last, device_law=None, law=replace(law, **changes))
        return sentence(replace(unexplained, last=last))

    little = "explains 2 % of what the model leaves: a size of 4.9 standard deviations, and "
    assert little in told(explained=0.02, deviations=4.93)
    assert "standard deviations" not in told(explained=0.2, deviations=4.93)
    table = unexplained.assembly.problem
    assert law.deviations == pytest.approx(
        np.sqrt(law.explained / (1 - law.explained) * (table.rows - table.A.shape[1])), rel=0.1
    )


def test_the_points_of_an_unnamed_law_are_the_deflections_that_the_data_ask_for(unexplained: Finding) -> None:
    law, problem = unexplained.last.law, unexplained.assembly.problem
    assert law is not None
    assert problem.J is not None
    v = problem.virtual_joints.index(law.virtual_joint)
    signal = problem.J[:, v] * law.values
    grown = np.column_stack([problem.A / np.linalg.norm(problem.A, axis=0), signal / np.linalg.norm(signal)])
    fitted = grown @ np.linalg.lstsq(grown, problem.y, rcond=1e-10)[0]
    left = problem.y - fitted
    found = left_with(unexplained, signal)
    assert np.sqrt(np.mean((found - left) ** 2)) < 0.15 * np.sqrt(np.mean(left**2))
    assert np.mean(found**2) < 0.9 * unexplained.rms.before**2


def test_where_nothing_was_added_there_is_one_state() -> None:
    page = render(diagnose(Task(load(ROBOT), measured())), {"code": CODE, "decide": None}, [])
    assert "<h2>Residuals</h2>" in page
    assert "→" not in page[page.index("<dl") : page.index("</dl>")]


def test_before_after_and_noise_of_the_page_have_the_digits_of_the_sentence(named: Finding) -> None:
    near = replace(named.rms, before=2.59e-5, after=2.51e-5, noise=2.57e-5)
    page = render(replace(named, rms=near), {"code": CODE, "decide": None}, [])
    facts = page[page.index("<dl") : page.index("</dl>")]
    assert "0.0259 mm → 0.0251 mm" in facts
    assert "0.0257 mm" in facts


def test_what_is_less_likely_and_not_excluded_is_in_the_sentence(named: Finding) -> None:
    rival = Found("backlash", {"joint": 2}, {}, {}, 0.01, 0.1, (), 1)
    text = sentence(replace(named, alternatives=(rival,)))
    assert text.startswith("What is missing: nonlinear stiffness at joint 2")
    assert text.endswith("Less likely, but not excluded: backlash at joint 2.")
    assert "Less likely" not in sentence(replace(named, alternatives=()))
    both = (*named.effects, Found("base_compliance", {"link": 0}, {}, {}, 0.01, 0.8, ()))
    other = Found("link_asymmetry", {"link": 0}, {}, {}, 0.01, 0.1, (), 1)
    again = replace(named.effects[0], set_number=1)
    text = sentence(replace(named, effects=both, alternatives=(again, other)))
    assert text.endswith("not excluded: link asymmetry at link 0 instead of base compliance at link 0.")


def test_what_is_sure_is_told_apart_from_what_may_have_no_name(named: Finding) -> None:
    both = (*named.last.leading, (Name("payload_error", {"load": "payload"}), {}, {}))
    partly = replace(
        named, verdict="named_insufficient", because=Reason(Why.SURE),
        last=replace(named.last, leading=both, rival=RivalLaw("force sensor axis 3", "gain*load", 1.1)),
        effects=tuple(replace(e, confidence=0.75) for e in named.effects),
    )  # fmt: skip
    assert headline(partly) == "Missing, but not all of it: nonlinear stiffness at joint 2"
    text = sentence(partly)
    assert text.startswith("What is missing is sure in part: nonlinear stiffness at joint 2 (")
    assert "confidence in the name 75 %" in text
    assert (
        "for the rest, payload error (payload) accounts for the data, but a law without a name does so"
        in text
    )
    assert "as well: a gain error that grows with the load (force sensor axis 3); the residual" in text
    assert "an even bet" not in text + render(partly, {"code": CODE, "decide": None}, [])


def test_what_a_law_without_a_name_outdoes_is_told_to_come_nearest(named: Finding) -> None:
    """The table of candidates tells of it that it accounts for the data."""
    last = replace(named.last, rival=RivalLaw("force sensor axis 3", "gain*load", 7.1))
    outdone = replace(named, verdict="unexplained", because=Reason(Why.NO_SET), effects=(), last=last)
    nearest = "as well as a law without a name does, and nonlinear stiffness at joint 2 comes nearest"
    assert nearest in sentence(outdone)
    assert "nearest" not in sentence(replace(outdone, last=replace(last, rival=None)))


def test_an_ambiguous_verdict_leaves_poses_that_decide(named: Finding, tmp_path: Path) -> None:
    gap = {"backlash_2_gap": Quantity(1e-3, 1e-5, "rad")}
    rival = Found("backlash", {"joint": 2}, {}, gap, 0.01, 0.4, (), 1)
    finding = replace(named, verdict="ambiguous", effects=(*named.effects, rival))
    decide = write_deciding_poses(finding, tmp_path, lambda stage: None)
    table = read_poses(tmp_path / "decide.csv")
    assert decide is not None
    assert [p["pose"] for p in decide["poses"]] == list(table.labels)
    assert set(table.points) == {"p1", "p2", "p3"}
    assert np.abs(table.w).max() > 0
    page = render(finding, {"code": CODE, "decide": decide}, [])
    assert "What would decide" in page
    assert "backlash at joint 2" in page
    reached = f"a separation of {separation_text(decide['poses'][-1]['separation'])} (9 decides)"
    assert f"These poses reach {reached}." in page
    assert verdict_table(finding, decide)["sentence"].endswith(
        f"that tell them apart best; they reach {reached}."
    )


def test_where_no_pose_decides_no_file_is_named(named: Finding, tmp_path: Path) -> None:
    """Coaxial joints turn the tool alike: here the two explanations are the same one."""
    finding = replace(
        named, verdict="ambiguous", effects=(*named.effects, replace(named.effects[0], set_number=1))
    )
    decide = write_deciding_poses(finding, tmp_path, lambda stage: None)
    assert decide is not None
    assert (decide["file"], decide["taken"], decide["poses"]) == (None, None, [])
    assert not list(tmp_path.iterdir())
    assert "others may, unless both are the same to the tool" in verdict_table(finding, decide)["sentence"]


def test_text_from_the_user_is_escaped(named: Finding) -> None:
    robot = named.task.robot.model_copy(update={"title": "<script>alert(1)</script>"})
    page = render(replace(named, task=replace(named.task, robot=robot)), {"code": CODE, "decide": None}, [])
    assert "<script" not in page
