"""What the sentence and the remarks of a verdict say where names, places or the code are not all of it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.rows import predict
from symstiff.calibration.simulation.experiment import simulate
from symstiff.calibration.simulation.truth import truth_from_table
from symstiff.discrepancy.conclusion import _beyond_code
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.result import Instead, Name, Quantity
from symstiff.discrepancy.laws.speech import law_at
from symstiff.discrepancy.search.verdict import AMBIGUOUS
from symstiff.discrepancy.statistics.strata import Stratum
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.report import candidates, sizes, words
from symstiff.report.folder import write_report
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, design, measured


@pytest.fixture(scope="module")
def found() -> Finding:
    return diagnose(Task(load(ROBOT), measured(HARDENING)))


@pytest.mark.parametrize(("p_time", "alone"), [(7e-4, True), (0.02, False)])
def test_no_place_is_accused_where_one_stratum_alone_rejects(
    p_time: float, alone: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As noise that follows itself makes it: tests of laws see nothing, and no law is fitted to what is none."""
    strata = (Stratum("time", 18, 50.0, 2.8, p_time), Stratum("nonlinear in load", 40, 41.0, 1.0, 0.6))
    for module in ("examine", "findings.tables"):
        monkeypatch.setattr(f"symstiff.discrepancy.{module}.strata", lambda *_: strata)
    said = diagnose(Task(load(ROBOT), measured()))
    assert said.verdict == ("unexplained" if alone else "nothing_missing")
    assert words.headline(said).startswith("More is left than independent noise") == alone
    assert ("holds more than noise (time: p = 0.0007" in words.sentence(said)) == alone
    if alone:
        assert (said.last.law, said.last.device_law) == (None, None)
        verdict = write_report(said, tmp_path / "out").verdict
        assert verdict["accused"] is None
        assert verdict["strata"][0]["p_value"] == p_time  # what decided is what the table holds
        assert "strongest" not in verdict["sentence"] + (tmp_path / "out" / "report.html").read_text()


def _beside(found: Finding, *others: Instead) -> str:
    (gear,) = found.named
    return words.sentence(replace(found, effects=(replace(gear, instead=others),), alternatives=()))


def test_what_fits_nearly_as_well_is_told_with_how_little_it_trails(found: Finding) -> None:
    """By the evidence: e^3.24 is 26. Beside a confidence of 95 % nothing is said that speaks against it."""
    like = Instead(Name("backlash", {"joint": 2}), 3.24, 4.8, 1, 1)
    told = (
        " Backlash at joint 2 would fit nearly as well: these data favour nonlinear stiffness at joint 2 by "
    )
    assert _beside(found, like).endswith(f"{told}26 to 1.")
    assert _beside(found, replace(like, behind=0.4)).endswith(f"{told}less than 3 to 1.")
    assert "Backlash" not in _beside(found, replace(like, behind=7.4))  # it trails clearly
    same = _beside(found, replace(like, behind=np.log(7.0), worse=0.0))
    assert same.endswith(" would fit these data as well: it is only less likely beforehand, 7 to 1.")
    assert "as well, and is refused" in _beside(found, replace(like, behind=-1.0))
    (gear,) = found.named
    other = replace(gear, effect="backlash", where={"joint": 2}, set_number=1)
    beside = replace(found, effects=(replace(gear, instead=(like,)),), alternatives=(other,))
    assert "nearly as well" not in words.sentence(beside)
    assert "not excluded: backlash at joint 2" in words.sentence(beside)


@pytest.mark.parametrize(("factor", "other"), [(1.0, False), (-1.0, True)])
def test_a_size_that_every_explanation_has_otherwise_is_told_to_be_of_the_first(
    found: Finding, factor: float, other: bool
) -> None:
    (gear,) = found.named
    sizes = {n: replace(size, value=factor * size.value) for n, size in gear.parameters.items()}
    second = replace(gear, parameters=sizes, set_number=1)
    more = [replace(gear, effect="backlash", where={"joint": 4 + k}, set_number=k) for k in (0, 1)]
    told = words.sentence(replace(found, verdict="ambiguous", effects=(gear, more[0], second, more[1])))
    assert told.startswith("Beside nonlinear stiffness at joint 2 (")
    said = "The size of nonlinear stiffness at joint 2 is that with the first; with another explanation it is another."
    assert (said in told) == other


def test_what_fits_as_well_by_more_parameters_is_told_with_their_number(found: Finding) -> None:
    links = [Instead(Name("geometric_error", {"link": k}), 7.0, -1.6, 1, 4 + k) for k in (1, 2)]
    assert _beside(found, *links).endswith(
        " Nonlinear stiffness at joint 2 is named for being simpler: geometric error at link 1 (5 parameters instead "
        "of 1) or geometric error at link 2 (6) would fit these data as well."
    )
    assert "simpler" not in _beside(found, replace(links[0], worse=2.5))


def test_another_effect_in_the_place_of_the_only_one_trails_as_it_does_alone(found: Finding) -> None:
    (gear,) = found.named
    assert gear.instead
    assert tuple(o.name for o in gear.instead) == gear.confounded_with
    alone = {(c.effect, str(c.where)): c.score for c in found.candidates}
    for other in gear.instead:
        own = alone[(gear.effect, str(gear.where))] - alone[(other.name.effect, str(other.name.where))]
        assert other.behind == pytest.approx(own, abs=1e-6)
        assert other.worse == pytest.approx(
            own, abs=3.0
        )  # one parameter each: their shapes are all that differs


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (2.59e-5, 2.51e-5, "falls from 0.0259 mm to 0.0251 mm rms"),
        (1.0374e-5, 1.0052e-5, "falls from 0.0104 mm to 0.0101 mm rms"),
        (3.1e-4, 2e-5, "falls from 0.310 mm to 0.020 mm rms"),
        (2e-5, 2.00001e-5, "stays at 0.02000 mm rms"),
    ],
)
def test_what_is_gained_near_the_noise_is_told_with_digits_that_show_it(
    found: Finding, before: float, after: float, told: str
) -> None:
    sizes = replace(found.rms, before=before, after=after, noise=2.6e-5)
    text = words.gap(replace(found, rms=sizes))
    assert f"the residual {told}" in text
    noise = re.findall(r"\(noise ([\d.]+) mm\)", text)[0]
    assert len(noise) == len(told.split(" mm")[0].split()[-1])  # as many digits: they are compared
    far = replace(found.rms, before=12.3, after=11.0, noise=2.6e-5)
    assert "from 12300 mm to 11000 mm" in words.gap(replace(found, rms=far))
    assert "(noise 0.026 mm)" in words.gap(replace(found, rms=far))


def test_what_the_code_leaves_of_a_large_deflection_is_told_in_millimetres() -> None:
    """The model's deflections are those of the unloaded pose: what they miss is in the data, whatever was found."""
    model = StiffnessModel.of(reduce(load(ROBOT), "wrench", "pose"))
    model = model.with_values(dict.fromkeys(model.parameters, 2e-4))
    grown = model.with_effect(EffectInstance("large_deflection", {"robot": "all"}))
    table = simulate(
        truth_from_table({"format": 1, "robot": ROBOT, "noise": {"sigma_mm": 0.02}}), design(), 1
    )
    missed = (table.values - predict(model, table))[:, :3]
    (told,) = _beyond_code(grown, table, 2e-5)
    size = 1e3 * np.sqrt(np.mean(missed[table.measured[:, :3]] ** 2))
    assert float(re.findall(r"leave ([\d.]+) mm rms", told)[0]) == pytest.approx(size, rel=1e-3)
    assert _beyond_code(grown, table, 1e-3 * size) == []  # it leaves no more than with it
    assert _beyond_code(model, table, 2e-5) == []


def test_laws_of_loads_are_told_in_words_where_they_have_some() -> None:
    assert (
        law_at("tau, late", "joint 2") == "a load that is followed late, as what creeps follows it (joint 2)"
    )
    assert law_at("tau*sin(q2)", "link 3 axis 5") == "a law of tau·sin(q2) (link 3 axis 5)"
    assert law_at("gain*load", "force sensor axis 3") == (
        "a gain error that grows with the load (force sensor axis 3)"
    )
    assert law_at("order", "measurement axis 1") == "a term in the order of the rows (measurement axis 1)"


def test_loads_that_the_start_model_was_not_reduced_for_are_in_the_headline(found: Finding) -> None:
    """What they do to the robot is nowhere in the model, and may be named instead: a remark says which they are."""
    assert "leaves out" not in words.headline(found)
    narrow = replace(found.start, model=replace(found.start.model, loads="gravity"))
    beyond = words.headline(replace(found, start=narrow))
    assert beyond == f"{words.headline(found)}, beside loads that the start model leaves out"


def test_where_no_explanation_is_likely_that_is_told(found: Finding) -> None:
    lead = found.named[0]
    other = replace(lead, effect="backlash", set_number=1)

    def told(first: float, second: float) -> str:
        sets = (replace(lead, confidence=first), replace(other, confidence=second))
        return words.sentence(replace(found, verdict=AMBIGUOUS, effects=sets, alternatives=()))

    assert (
        "backlash at joint 2 (confidence in the name 24 %), or none of these (63 %); with the first"
        in told(0.13, 0.24)
    )
    assert "none of these" not in told(0.5, 0.4)


def test_the_noise_says_where_it_holds_what_a_poses_rows_share(found: Finding) -> None:
    noise = found.last.noise

    def told(approach: float, p: float) -> str:
        report = replace(noise, approach=approach, approach_p=p)
        return sizes.noise(replace(found, last=replace(found.last, noise=report)))

    assert "share" not in told(0.0, 0.9)
    assert told(noise.sigma / 3, 1e-5).endswith(" mm, what a pose's rows share included")
    assert told(2.0 * noise.sigma, 1e-5).endswith(" mm that a pose's rows share")


def test_a_size_that_is_known_and_below_what_would_be_seen_is_no_testable_one(found: Finding) -> None:
    """A share of a large deflection is 1: a limit of 2 says that it cannot be seen."""
    known = next(c for c in found.candidates if c.testable)

    def answer(least: float) -> str:
        share = {"large_deflection_all_share": Quantity(least, 0.0, "1")}
        one = replace(
            known, effect="large_deflection", where={"robot": "all"}, shape={}, smallest_detectable=share
        )
        last, first = (replace(d, candidates=(one,)) for d in (found.last, found.first))
        return candidates.sensitivity(replace(found, first=first, last=last))[0][-1]

    assert answer(2.2) == "no"
    assert answer(0.4) == "yes"
