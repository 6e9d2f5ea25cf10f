"""What the model absorbs in one shape may be seen in another: sizes are told of that one, and the other is told."""

from __future__ import annotations

import re

import pytest

from symstiff.calibration.simulation import Effect, Truth, nominal_truth
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.registry import find
from symstiff.report import candidates
from symstiff.report.verdict import verdict_table
from symstiff.robot import load
from tests.diagnosis_data import ROBOT, measured
from tests.test_assemble import design
from tests.test_shaking import shaken


@pytest.fixture(scope="module")
def quiet() -> Finding:
    """Two parallel joints, whose compliances along the arm hold what a load on one turns at the other."""
    return diagnose(Task(load(ROBOT), measured()))


def test_sizes_of_a_coupling_that_the_model_holds_are_those_of_one_that_saturates(quiet: Finding) -> None:
    (coupling,) = (c for c in quiet.candidates if c.effect == "wrist_coupling")
    assert coupling.testable
    assert "plainest form" in coupling.reason
    assert set(coupling.seen_as) >= {"saturation"}
    (row,) = (r for r in candidates.sensitivity(quiet) if r[0].startswith("wrist coupling"))
    assert re.fullmatch(r"wrist coupling between joints 1, 2, saturating beyond .* N·m.*", row[0])
    assert any(
        "plainest form" in why and "wrist coupling" in names for why, names in candidates.untested(quiet)
    )
    (told,) = (c for c in verdict_table(quiet)["candidates"] if c["effect"] == "wrist_coupling")
    assert told["smallest_detectable"]["shape"] == dict(coupling.seen_as)


def test_what_is_seen_in_its_plainest_form_has_no_reason(quiet: Finding) -> None:
    plain = [c for c in quiet.candidates if c.testable and c.effect != "wrist_coupling"]
    assert plain
    assert not [c for c in plain if c.reason]


def test_the_arms_of_a_scara_are_coupled_too() -> None:
    places = [tuple(where["joints"]) for where in find("wrist_coupling").places(load("scara"))]  # type: ignore[arg-type]
    assert places == [(1, 2), (1, 4), (2, 4)]
    assert len(find("wrist_coupling").places(load("kuka_kr270"))) == 3


@pytest.mark.slow
def test_a_coupling_of_a_scaras_arms_that_saturates_is_named() -> None:
    robot = load("scara")
    coupling = Effect("wrist_coupling", {"joints": [1, 2]}, "saturating", {"c": 5e-5, "tau0": 8.0})
    table = design("scara", "deflection", 20, (0.25, 0.5, 0.75, 1.0))
    found = diagnose(Task(robot, shaken(table, Truth(robot, nominal_truth(robot), (coupling,)), 3, 0.0)))
    assert found.verdict == "named"
    assert [(e.effect, dict(e.where)) for e in found.effects] == [("wrist_coupling", {"joints": [1, 2]})]
