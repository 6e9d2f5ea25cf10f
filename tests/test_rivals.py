"""Laws without a name that may take the place of what was named."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.problem import DeviceLaw, Parameter
from symstiff.discrepancy.reasons import Why
from symstiff.discrepancy.search import rivals
from symstiff.discrepancy.search.verdict import EVEN
from symstiff.discrepancy.search.workshop import Proposal, Workshop
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load
from tests.diagnosis_data import ROBOT
from tests.diagnosis_data import measured as readings
from tests.test_discrepancy_engine import arm, measured, scaled


def shop_of(kept: tuple[int, ...], score: float, shape: bool = False, at: str = "joint 6") -> Workshop:
    """Two members and a law without a name that scores something beside those that are ``kept``."""
    none = np.full(3, -np.inf)
    bank = SimpleNamespace(
        another_shape=lambda law, entry: shape, owner=np.arange(3), place=("joint 2", "joint 3", ""),
        parameters=lambda entry: (),
        candidates=(*[SimpleNamespace(where={})] * 2, SimpleNamespace(where={"at": at})),
    )  # fmt: skip
    return cast(Workshop, SimpleNamespace(
        start=SimpleNamespace(bank=bank),
        evidence=lambda entries: SimpleNamespace(score=np.array([8.0, 9.0, 0.0]), best_entry=np.arange(3)),
        own=lambda member, entries: SimpleNamespace(score=8.0 + member),
        score=lambda members, entries, generic: np.where(np.arange(3) == 2, score, none) if members == kept else none,
        scan=lambda entries: SimpleNamespace(bank=bank, best=None),
    ))  # fmt: skip


@pytest.mark.parametrize(
    ("kept", "score", "challenged"),
    [((1,), 6.5, (True, False)), ((0,), 7.5, (False, True)), ((), 18.5, (True, True))],
)
def test_a_law_without_a_name_may_take_the_place_of_one_member_or_of_all(
    kept: tuple[int, ...], score: float, challenged: tuple[bool, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wherever it comes closest it is the set's rival, and of whom it replaces: here it trails a set of two by 1.5."""
    monkeypatch.setattr(rivals, "_inside", lambda *_: (0.0, True))
    found = rivals.rivals(shop_of(kept, score), Proposal((0, 1), (0, 1), 20.0))
    assert (found.found, found.alike) == ((rivals.Rival(2, pytest.approx(-1.5)),), None)
    assert found.best == pytest.approx(-1.5)
    assert [c == pytest.approx(-1.5) for c in found.challenge] == [*challenged]


@pytest.mark.parametrize(
    ("lead", "share", "narrow", "shape", "rival", "alike"),
    [
        (2.9, 0.9, True, False, False, True),  # the same thing, seen elsewhere
        (4.0, 0.9, True, False, True, True),  # and far better
        (4.0, 0.9, False, False, True, False),  # a large space holds anything
        (2.9, 0.6, True, True, False, False),  # the shape of the member's own law
        (4.0, 0.6, True, True, True, False),  # and far better: an encoder's scale is no wave
        (4.0, 0.6, True, False, True, False),
    ],
)
def test_a_law_that_describes_what_a_member_does_is_a_rival_where_it_does_so_far_better(
    lead: float, share: float, narrow: bool, shape: bool, rival: bool, alike: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(rivals, "_inside", lambda *_: (share, narrow))
    found = rivals.rivals(shop_of((), 20.0 + lead, shape), Proposal((0,), (0,), 20.0))
    assert found.found == ((rivals.Rival(2, pytest.approx(lead)),) if rival else ())
    assert (found.alike is not None and found.alike.lead == pytest.approx(lead)) == alike


@pytest.mark.parametrize(
    ("at", "off", "alike"), [("joint 2", 0.0, False), ("joint 2", 0.1, True), ("joint 3", 0.0, True)]
)
def test_the_law_that_a_named_effect_has_is_no_other_thing(
    at: str, off: float, alike: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Effects from elsewhere may have any law: one that is tried without a name too, at their joint, is theirs."""
    own, other = np.eye(4)[:, :2], np.eye(4)[:, :2] @ [[0.6, -0.8], [0.8, 0.6]]
    other[2, 0] = off
    spaces = {0: own, 2: np.linalg.qr(other)[0]}
    monkeypatch.setattr(rivals, "_inside", lambda *_: (0.99, True))
    monkeypatch.setattr(rivals, "basis_of", lambda scan, layer, entry: spaces[entry])
    found = rivals.rivals(shop_of((), 20.0, at=at), Proposal((0,), (0,), 20.0))
    assert (found.alike is not None) == alike


@pytest.mark.parametrize(
    ("size", "usual", "lost"), [(0.3, 0.02, np.log1p(225.0)), (0.002, 0.02, 0.01), (0.3, 0.0, 0.0)]
)
def test_a_correction_of_the_file_that_nobody_would_overlook_is_the_less_likely(
    size: float, usual: float, lost: float
) -> None:
    bare = arm(30).problem
    column = scaled(bare, np.sin(3.0 * np.arange(bare.rows)), 400.0)[:, None] / size
    law = DeviceLaw("robot file's joint 2", "correction of d", (Parameter("d", "m", typical=usual),), column)
    problem = measured(replace(bare, devices=(law,)), size * column[:, 0])
    scan = prepare(problem, ()).scan
    place = [dict(scan.bank.candidates[int(c)].where).get("at") for c in scan.bank.owner]
    found = rivals._unusual(scan, (), place.index("robot file's joint 2"))
    assert found == pytest.approx(lost, abs=0.25)


def test_what_does_as_well_as_a_name_is_told_beside_it_and_lowers_its_confidence() -> None:
    """Friction in the rig, 5 % of the load, under forces of one plane: a joint's hysteresis looks the same."""
    told = readings(poses=12, levels=(0.3, 0.6, 1.0, 0.6, 0.3), seed=2)
    branch = np.repeat([1.0, 1.0, 1.0, -1.0, -1.0] * 12, 3)
    found = diagnose(
        Task(load(ROBOT), replace(told, branch=branch, w=told.w / (1.0 - 0.05 * branch)[:, None]))
    )
    assert (found.verdict, found.because.why) == ("named_insufficient", Why.AS_WELL)
    remark = next(r for r in found.remarks if "may be another thing" in r)
    assert "friction in the rig" in remark
    assert "(force sensor)" in remark
    assert found.last.alike is not None
    assert -2.0 < found.last.alike.lead < 3.0
    assert found.effects[0].confidence == EVEN
