"""How sure a verdict is of its names: what takes confidence off, and which sets keep their weight."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from symstiff.discrepancy.problem import Options
from symstiff.discrepancy.search.rivals import Rival, Rivals
from symstiff.discrepancy.search.verdict import _named, _nearly, decide
from symstiff.discrepancy.search.workshop import Proposal, Workshop
from symstiff.discrepancy.statistics.prepare import prepare
from tests.test_discrepancy_engine import QUICK, arm, measured, saturating, scaled


def test_a_name_that_hardly_passes_its_test_is_told_with_less_confidence() -> None:
    """Five times the chance that noise does as well is taken off, up to all of it."""
    a = arm()
    problem = measured(a.problem, scaled(a.problem, saturating(a.problem, 0), 120.0))
    ready = prepare(problem, a.candidates)
    every = np.ones(len(ready.bank.candidates), dtype=bool)
    found = decide(ready.scan, every, QUICK, lambda _: 0.0, (), lambda _: None)
    assert found.chosen is not None
    shop = Workshop(ready.scan, every, QUICK)
    sure = []
    for p in (0.0, 0.02, 0.1, 0.2, 0.5):
        leader = replace(found.chosen, p_members=(p,))
        alone = Proposal(leader.members, leader.entries, leader.score)
        tests = (found.null, found.found, found.p_named, found.p_unnamed)
        sure += _named(shop, [leader], [leader], [alone], tests).confidence
    assert sure[0] > 0.9
    assert np.array(sure) / sure[0] == pytest.approx([1.0, 0.9, 0.5, 0.0, 0.0])


@pytest.mark.parametrize(
    ("sufficient", "p", "rival", "nearly"),
    [
        (True, 0.0, 0.04, True),
        (True, 0.0, 1.5, False),
        (True, 0.0, -2.0, False),
        (False, 0.0, 0.04, False),
        (True, 0.1, 0.04, False),
    ],
)
def test_a_set_that_a_law_without_a_name_equals_keeps_its_weight_beside_one_that_it_does_not(
    sufficient: bool, p: float, rival: float, nearly: bool
) -> None:
    """Refused for that law alone it is still an explanation; behind it, or insufficient, or idle, it is none."""
    judged = SimpleNamespace(
        sufficient=sufficient, p_members=(p,), rivals=Rivals((Rival(9, rival),), (rival,), None), score=20.0
    )
    assert _nearly(cast(Any, judged), Options()) == nearly
