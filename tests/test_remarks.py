"""Remarks beside a verdict: said where the numbers call for them, and not short of that."""

from __future__ import annotations

from dataclasses import replace

import pytest

from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.out_of_range import astray, out_of_range
from symstiff.discrepancy.findings.remarks import remarked
from symstiff.discrepancy.findings.result import Diagnosis, Found, Quantity
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured


@pytest.fixture(scope="module")
def found() -> Finding:
    return diagnose(Task(load(ROBOT), measured(HARDENING)))


def said(found: Finding, last: Diagnosis, words: str) -> bool:
    return any(words in r for r in remarked(found.assembly.situation.view, last))


@pytest.mark.parametrize(
    ("times", "verdict", "told"),
    [(3.0, "named", True), (2.0, "named", False), (3.0, "unexplained", False)],
)
def test_a_model_that_predicts_unused_poses_badly_is_not_to_be_relied_on(
    found: Finding, times: float, verdict: str, told: bool
) -> None:
    rms = replace(found.last.rms, held_out_after=times * found.last.rms.noise)
    last = replace(found.last, rms=rms, verdict=verdict)  # type: ignore[arg-type]
    assert said(found, last, f"{times:.1f} times the noise: these poses are too few") is told


@pytest.mark.parametrize(
    ("p_value", "plausible", "told"), [(1e-6, False, True), (0.01, False, False), (1e-6, True, False)]
)
def test_signs_are_asked_about_where_only_the_sign_keeps_what_is_sure_from_leading(
    found: Finding, p_value: float, plausible: bool, told: bool
) -> None:
    size = {"backlash_2_gap": Quantity(-2e-4, 1e-5, "rad")}
    lead = replace(
        next(c for c in found.last.candidates if c.testable),
        effect="backlash", where={"joint": 2}, shape={}, parameters=size, p_value=p_value, plausible=plausible,
    )  # fmt: skip
    last = replace(found.last, verdict="unexplained", candidates=(lead,))
    assert said(found, last, "look at the signs of loads and readings") is told


def test_a_size_that_is_known_beforehand_is_told_beside_what_the_data_say(found: Finding) -> None:
    share = {"large_deflection_all_share": Quantity(1.4, 0.3, "1")}
    effect = Found("large_deflection", {"robot": "all"}, {}, share, 1e-4, 0.9, (), 0)
    words = "share has to be 1 by theory, and model.toml holds that; these data alone give 1.40 ± 0.30"
    assert said(found, replace(found.last, effects=(effect,)), words)
    assert not said(found, replace(found.last, effects=(replace(effect, set_number=1),)), "by theory")
    assert not said(found, replace(found.last, effects=(effect,)), "enter masses")
    beside = replace(effect, parameters={"large_deflection_all_share": Quantity(1.9, 0.3, "1")})
    last = replace(found.last, effects=(beside,))
    assert said(
        found, last, "give 1.90 ± 0.30, 3.0 standard deviations beside it: the weight of the arm may be in it"
    )
    assert not said(found, found.last, "by theory")


def test_a_size_that_the_data_hardly_tell_is_neither_astray_nor_odd() -> None:
    robot = load(ROBOT)

    def gap(std: float) -> list[Found]:
        size = Quantity(20e-3, std, "rad")  # physical up to 5 mrad
        return [Found("backlash", {"joint": 2}, {}, {"backlash_2_gap": size}, 0.0, 0.9, ())]

    assert astray(gap(1e-3), robot)
    assert not astray(gap(8e-3), robot)
    assert out_of_range(gap(8e-3), robot)
    assert not out_of_range(gap(float("inf")), robot)


@pytest.mark.parametrize(
    ("deviation", "told"),
    [
        (
            float("inf"),
            "is physical for it alone: here it is a sum with k2_26, which these data do not tell from it",
        ),
        (1e-9, "is physical: what these data do not tell from it may be in it"),
    ],
)
def test_a_compliance_that_bears_another_one_is_a_sum_and_may_be_below_zero(
    deviation: float, told: str
) -> None:
    """k2_22 - a·k2_26 of a beam is negative whatever is measured."""
    robot = load("kuka_kr270")
    instance = EffectInstance("link_compliance", {"link": 2})
    sizes = {p.name: Quantity(1e-7, 1e-9, p.unit) for p in instance.realise(robot).parameters}
    sizes |= {"k2_22": Quantity(-1.7e-7, 2e-8, "m/N"), "k2_26": Quantity(0.0, deviation, "rad/N")}
    (remark,) = out_of_range([Found("link_compliance", {"link": 2}, {}, sizes, 0.0, 0.9, ())], robot)
    assert "k2_22 is (−1.70 ± 0.20)·10⁻⁷ m/N, where at least 0 m/N" in remark
    assert told in remark
