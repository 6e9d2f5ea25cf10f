"""What a person sees of a report: pictures for any labels, formulas that one reads, tables that tell."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from html import unescape
from unittest.mock import patch

import pytest

from symstiff.calibration.identify import identify
from symstiff.calibration.plan import Goal, plan
from symstiff.calibration.planning.frames import geometry
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.laws.speech import law_place
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.report.code import formulas
from symstiff.report.figures import draw_plan
from symstiff.report.html import _bound, _breakable, _remark, render
from symstiff.report.naming import places
from symstiff.report.plots import _short, draw_gap, draw_map
from symstiff.report.residuals import draw_residuals
from symstiff.report.words import what
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured

CODE = {"folder": True, "compiled": True, "text": "compiled", "error": 1e-15}
LABELS = ("left, at the very back of the hall, number ", "<b>$x_1$^</b> ", "工位三号机械臂右侧 ")


@pytest.fixture(scope="module")
def found() -> Finding:
    """A diagnosis of poses with long labels, of wide letters, and of what elsewhere are formulas and tags."""
    table = measured(HARDENING)
    return diagnose(
        Task(
            load(ROBOT), replace(table, labels=tuple(f"{LABELS[k % 3]}{k}" for k in range(len(table.labels))))
        )
    )


@pytest.fixture
def strict() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def page_of(finding: Finding) -> str:
    return render(finding, {"code": CODE, "decide": None}, [])


@pytest.mark.usefixtures("strict")
def test_a_map_has_room_for_long_labels_and_takes_them_as_they_are(found: Finding) -> None:
    svg = unescape(draw_map(found).svg)
    assert "left, …umber 0" in svg
    assert "<b>$x_…" in svg
    size = re.search(r'height="([\d.]+)pt"', svg)
    assert size is not None
    assert float(size.group(1)) > 72 * 2.85 + 30  # two maps of three axes with short labels have 2.85 in


def test_a_label_keeps_its_end_where_numbers_stand() -> None:
    assert _short("p12") == "p12"
    assert _short("station 4, arm 17, pose 23") == "statio…pose 23"


def test_every_picture_has_words_for_who_does_not_see_it(found: Finding) -> None:
    page = page_of(found)
    assert page.count("<svg") == page.count('<svg role="img" aria-label="') == page.count("<figcaption>")
    assert not re.search(r"<th(?! scope|ead)", page)


def test_the_bars_have_their_unit_and_the_digits_of_the_sentence(found: Finding) -> None:
    svg = draw_gap(replace(found, rms=replace(found.rms, before=1.41e-5, after=9.4e-6, noise=9.6e-6))).svg
    for told in ("0.0141 mm", "0.0094 mm", "noise 0.0096 mm"):
        assert told in svg


def test_where_nothing_was_added_parameters_have_one_value() -> None:
    page = page_of(diagnose(Task(load(ROBOT), measured())))
    part = page[page.index('id="compliances"') : page.index('id="code"')]
    assert "<h2>The parameters</h2>" in part
    assert "fitted to these data" in part
    for spare in ("before", "after", "change"):
        assert f">{spare}" not in part
    assert "everything found" not in page


@pytest.mark.parametrize(
    ("effect", "shape", "told"),
    [
        ("backlash", {"width": 3.88}, "<mfrac><msub><mi>&#964;</mi><mi>3</mi></msub><mn>3.88</mn></mfrac>"),
        ("hysteresis", {"width": 3.69}, "<mi>branch</mi><mo>&#xB7;</mo>"),
        ("nonlinear_stiffness", {"load": 1220.0, "saturation": 1.0}, "<mn>1220</mn></mfrac>"),
        ("nonlinear_stiffness", {"load": 19.6, "knee": 1.0}, "<mn>19.6</mn></mfrac>"),
        ("nonlinear_stiffness", {"load": 19.5, "saturation": 1.0}, "<mn>19.5</mn><mo>&#xB7;</mo>"),
    ],
)
def test_a_formula_has_numbers_that_one_reads_and_signs_between_its_factors(
    effect: str, shape: dict[str, float], told: str
) -> None:
    (formula,) = formulas(load("kuka_kr270"), EffectInstance(effect, {"joint": 3}, shape))
    assert told in formula.mathml
    for strange in ("InvisibleTimes", "<mo>-</mo>", "·</mo><mo>", "<mn>97</mn>", "<mn>1.0</mn>"):
        assert strange not in formula.mathml
    assert ("branch: 1 where the load rises" in formula.letters) == (effect == "hysteresis")


def test_quantities_do_not_break_and_long_names_do() -> None:
    assert _bound("within ± 3.88 N·m, 7.9 % left") == "within\u00a0±\u00a03.88\u00a0N·m, 7.9\u00a0% left"
    assert _bound("joint 2 moves 3 mm more") == "joint 2 moves 3\u00a0mm more"
    assert _breakable("force_sensor_bias_force_sensor_fx").startswith("force_<wbr>sensor_<wbr>bias_<wbr>")
    assert _breakable("nonlinear_stiffness_3_c") == "nonlinear_stiffness_3_c"
    assert _breakable(f"<b>_{'0' * 30}").startswith("&lt;b&gt;_<wbr>")


def test_a_remark_begins_as_a_sentence_unless_a_name_begins_it() -> None:
    assert _remark("large deflection: it has") == "Large deflection: it has"
    assert _remark("k3_11, k4_22: below zero") == "k3_11, k4_22: below zero"
    assert _remark("model.toml is old") == "model.toml is old"


def test_a_thing_among_places_is_told_with_them() -> None:
    assert (
        places([{"link": 1}, {"link": 2}, {"measurement": "frame"}])
        == "at links 1, 2 and of the measuring frame"
    )
    assert places([{"measurement": "frame"}]) == "(measuring frame)"


def test_an_axis_of_a_sensor_is_told_as_one_says_it() -> None:
    assert law_place("force sensor axis 1") == "axis 1 of the force sensor"
    assert law_place("force sensor") == "the force sensor"
    assert law_place("link 2 axis 6") == "link 2 axis 6"


def test_pairs_of_joints_are_told_apart() -> None:
    pairs = [{"joints": [4, 5]}, {"joints": [4, 6]}]
    assert places(pairs) == "between joints 4 and 5, 4 and 6"
    assert places([{"joint": 2}, *pairs]) == "at joint 2, between joints 4 and 5, 4 and 6"


def test_a_heading_tells_what_is_missing_from_what_has_another_shape(found: Finding) -> None:
    assert what(found) == "What is missing"
    (gear,) = found.named
    known = EffectInstance(gear.effect, gear.where, {"load": 5.0, "saturation": 1.0})
    with patch.object(Finding, "reshaped", (known,)):
        assert what(found) == "What has another shape"
        assert "<h2>What has another shape</h2>" in page_of(found)
    assert what(replace(found, verdict="ambiguous")) == "What could be missing"


def test_what_holds_for_several_laws_is_said_once(found: Finding) -> None:
    drift = EffectInstance("thermal_drift", {"link": 2}, {"time": 400.0, "T": 60.0})
    assert len({law.letters for law in formulas(load(ROBOT), drift)}) == 1
    page = page_of(found)
    assert page.count("written out below") <= 1


def test_residuals_of_an_identification_are_told_by_the_names_of_their_poses() -> None:
    table = measured()
    figure = draw_residuals(identify(load(ROBOT), replace(table, labels=tuple("abcdefghij"))))
    last = figure.axes[3]
    assert [t.get_text() for t in last.get_xticklabels()] == list("abcdefghij")
    assert list(last.get_xticks()) == list(range(10))
    assert not last.get_legend()
    assert figure.legends


def test_poses_of_a_plan_have_numbers() -> None:
    robot = load(ROBOT)
    made = plan(StiffnessModel.of(reduce(robot, loads="force", measure="position")), Goal(7))
    assert [t.get_text().strip() for t in draw_plan(made, geometry(robot)).axes[0].texts] == list("1234567")
