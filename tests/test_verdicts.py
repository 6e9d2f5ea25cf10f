"""What a verdict makes of sets that were judged, and of poses that were left out."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from symstiff.discrepancy.examine import doubted
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.search import verdict
from symstiff.discrepancy.search.judging import Judged
from symstiff.discrepancy.search.proof import HeldOut
from symstiff.discrepancy.search.rivals import Rival, Rivals
from symstiff.discrepancy.search.verdict import Outcome
from symstiff.discrepancy.search.workshop import Proposal
from tests.test_discrepancy_engine import QUICK


def judged(score: float, leads: tuple[float, ...], challenge: tuple[float, ...], bank: Any = None) -> Judged:
    """A set that suffices and needs all of its members, with what laws without a name do in their places."""
    members = tuple(range(len(challenge)))
    return cast(Judged, SimpleNamespace(
        members=members, entries=members, score=score, sufficient=True, p_members=(0.0,) * len(members), bank=bank,
        rivals=Rivals(tuple(Rival(9, lead) for lead in leads), challenge, None), missed_share=0.0,
    ))  # fmt: skip


def concluded(*tried: Judged, weighed: Sequence[Proposal] = ()) -> Outcome:
    """The verdict on sets, of tests that saw something."""
    shop = cast(Any, SimpleNamespace(options=QUICK))
    evidence = SimpleNamespace(entry=np.zeros(9), best_entry=np.arange(9), candidate=np.zeros(9))
    return verdict._conclude(shop, [*tried], [*weighed], cast(Any, (None, evidence, 0.0, 0.0)))


@pytest.mark.parametrize(("lead", "told"), [(2.0, "named_insufficient"), (4.0, "unexplained")])
def test_a_set_that_is_behind_one_that_a_law_without_a_name_matches_is_told_with_a_reservation(
    lead: float, told: str
) -> None:
    """What explains more is matched by such a law, or leaves something; far behind it nothing is named."""
    ahead = judged(65.5 + lead, (0.4,), (0.4,) * 3)
    behind = judged(65.5, (-2.1,), (-2.1,) * 2)
    found = concluded(ahead, behind)
    assert found.verdict == told
    assert told == "unexplained" or (found.because.why, found.chosen) == (Why.AS_WELL, behind)


@pytest.mark.parametrize(
    ("score", "together", "told"),
    [(0.2, -2.0, True), (0.2, -1.0, False), (9.0, -1.0, True), (9.0, -9.0, True)],
)
def test_what_is_faint_has_to_lead_the_laws_without_a_name_together(
    score: float, together: float, told: bool
) -> None:
    """Several hundred laws trail a little each: of an effect outside of the catalogue one name leads them all."""
    leads = (together - float(np.log(12.0)),) * 12
    faint = judged(score, leads, leads[:1])
    assert verdict._admissible(faint, QUICK) == told
    if not told:
        found = concluded(faint)
        assert (found.verdict, found.because.why) == ("unexplained", Why.FAINT)


@pytest.mark.parametrize(("lead", "told"), [(-0.4, Why.AS_WELL), (-2.0, Why.AHEAD)])
def test_a_name_is_ahead_of_a_law_without_one_only_by_more_than_what_counts_as_the_same(
    lead: float, told: Why
) -> None:
    """A joint that is softer at some angles was a base and a wrist coupling with 0.9, a tenth ahead."""
    bank = SimpleNamespace(
        twins=lambda entry: (entry,),
        place=("a1.joint",),
        candidates=[SimpleNamespace(shapes=((),), expected=False, where={"joint": 1})],
    )
    leader = judged(20.0, (lead,), (lead,), bank)
    found = concluded(leader, weighed=[Proposal((0,), (0,), 20.0)])
    assert found.because.why is told
    assert (found.verdict == "named") == (told is Why.AHEAD)
    assert found.confidence == (verdict.EVEN,) or found.verdict == "named"


@pytest.mark.parametrize(
    ("challenge", "expected", "told"),
    [
        ((1.1, -np.inf), False, True),
        ((1.1, -2.5), False, False),  # a law trails by little
        ((1.1, 1.1), False, False),
        ((1.1, -np.inf), True, False),  # theory alone has it there, whatever else is
    ],
)
def test_a_member_that_no_law_may_replace_is_told_where_the_rest_may_have_no_name(
    challenge: tuple[float, float], expected: bool, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    bank = SimpleNamespace(candidates=[SimpleNamespace(expected=False), SimpleNamespace(expected=expected)])
    both = judged(57.0, challenge[:1], challenge, bank)
    alone = SimpleNamespace(members=(1,), p_members=(0.0,))
    monkeypatch.setattr(verdict, "together", lambda shop, members: Proposal(tuple(members), (1,), 40.0))
    monkeypatch.setattr(verdict, "judge", lambda shop, proposal: alone if proposal.members == (1,) else None)
    found = concluded(both)
    sure = ("named_insufficient", Why.SURE, (alone,), (verdict.PARTLY,))
    assert found.chosen is both
    assert (found.verdict, found.because.why, found.admissible, found.confidence) == (
        sure if told else ("unexplained", Why.NOT_ALONE, (), ())
    )


@pytest.mark.parametrize(
    ("leader", "found", "lead"),
    [
        ((0,), (0, 1), verdict.CLOSE),  # one wave, and another one of the same gear
        ((2,), (0, 1), verdict.CLOSE),  # a law that bends, and two waves
        ((2,), (2, 0), verdict.CLEARLY),  # what it leaves passes for its shape
        ((0,), (3, 1), -verdict.CLOSE),  # another joint: an explanation of its own
        ((2, 3), (0, 1), -verdict.CLOSE),
    ],
)
def test_waves_of_one_gear_have_no_shape_that_bends_to_others(
    leader: tuple[int, ...], found: tuple[int, ...], lead: float
) -> None:
    """Two waves a turn were a gravity compensator with 0.96, and a second wave was left for the shape of the first."""
    none, several = SimpleNamespace(shapes=((),)), SimpleNamespace(shapes=((1.0,), (2.0,)))
    bank = SimpleNamespace(place=("a", "a", "a", "b"), candidates=[none, none, several, none])
    shop = cast(Any, SimpleNamespace(start=SimpleNamespace(bank=bank)))
    sets = [cast(Judged, SimpleNamespace(members=members)) for members in (found, leader)]
    assert verdict._lead_of(shop, *sets) == lead


@pytest.mark.parametrize(
    ("found", "lead", "after", "told"),
    [
        ("named", 2.3, 1.1, "named_insufficient"), ("named", 0.9, 1.1, "named"), ("named", None, 1.1, "named"),
        ("ambiguous", 2.3, 1.1, "ambiguous"), ("named", 2.3, 0.9, "named"),
    ],
)  # fmt: skip
def test_a_doubted_name_is_none_where_a_law_that_does_the_same_explains_more(
    found: str, lead: float | None, after: float, told: str
) -> None:
    """Poses that were left out do not confirm it: a gear that creeps was hysteresis with 0.67."""
    same = None if lead is None else Rival(3, lead)
    leader = cast(Judged, SimpleNamespace(rivals=Rivals((), (-np.inf,), same)))
    none = cast(Any, None)
    before = Outcome(found, Reason(Why.AHEAD), none, none, 0.0, 0.0, leader, (leader,), (0.9,), (leader,))
    after_all = doubted(before, HeldOut(1.0, after, (1.0, after), 0.8, (), 1.0))
    assert after_all.verdict == told
    assert after_all.confidence == ((0.5,) if told == "named_insufficient" else (0.9,))
