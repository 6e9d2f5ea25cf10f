"""Sizes in a report: the unit of what was measured, the gap on poses that were left out, the surety of a group."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.result import Rms
from symstiff.discrepancy.workflow import diagnose
from symstiff.report import naming, sizes
from symstiff.report.html import render
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured

CODE = {"folder": True, "compiled": True, "text": "compiled", "error": 1e-15}


@pytest.fixture(scope="module")
def found() -> Finding:
    return diagnose(Task(load(ROBOT), measured(HARDENING)))


def test_the_share_of_the_gap_closed_is_of_poses_that_were_left_out(found: Finding) -> None:
    told = Rms(before=1e-4, after=1e-5, held_out_before=2.1e-4, held_out_after=1.1e-4, noise=1e-5)
    page = render(replace(found, rms=told), {"code": CODE, "decide": None}, [])
    assert "50 %, on held-out poses" in page


@pytest.mark.parametrize(
    ("axes", "told"), [([0, 1, 2], "0.144 mm"), ([3, 4, 5], "0.144 mrad"), ([2, 3], "0.144 mm")]
)
def test_a_residual_is_told_in_the_unit_of_what_was_measured(
    found: Finding, axes: list[int], told: str
) -> None:
    values = np.full(found.table.values.shape, np.nan)
    values[:, axes] = 1e-4
    assert sizes.size(1.44e-4, replace(found, table=replace(found.table, values=values))) == told


def test_the_confidence_of_a_group_is_that_of_its_weakest_member(found: Finding) -> None:
    group = [replace(found.named[0], confidence=c) for c in (0.9, 0.6, 0.97)]
    assert naming.confidence(found, group) == "confidence in the name 60 %"


@pytest.mark.parametrize(
    ("least", "told"), [(0.75, "confidence in the name 75 %"), (0.5, "at most an even bet")]
)
def test_what_is_in_doubt_of_a_set_that_does_not_suffice_is_an_even_bet(
    found: Finding, least: float, told: str
) -> None:
    partly = replace(found, verdict="named_insufficient")
    assert naming.confidence(partly, [replace(found.named[0], confidence=c) for c in (0.75, least)]) == told
