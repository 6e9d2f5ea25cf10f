"""Poses that were not used: what they do not confirm, and what they refute."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from symstiff.discrepancy import examine as engine
from symstiff.discrepancy.examine import doubted
from symstiff.discrepancy.findings.result import Rms
from symstiff.discrepancy.noise.scales import start
from symstiff.discrepancy.noise.sharing import Split
from symstiff.discrepancy.problem import Candidate, Options, Parameter
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.search.judging import Judged
from symstiff.discrepancy.search.localise import _validated
from symstiff.discrepancy.search.proof import HeldOut, held_out
from symstiff.discrepancy.search.rivals import Rivals
from symstiff.discrepancy.search.verdict import Outcome
from symstiff.discrepancy.statistics.bank import build
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.statistics.scan import open_scan
from symstiff.report import words
from tests.diagnosis_data import HARDENING, measured
from tests.test_discrepancy_engine import SIGMA, arm, scaled
from tests.test_discrepancy_engine import measured as measured_rows
from tests.test_unnamed import _diagnosed, hardening


def test_what_unused_poses_predict_no_better_is_unconfirmed() -> None:
    told = {
        Rms(4.0, 3.0, 4.0, 4.1, 3.0): False,
        Rms(4.0, 3.0, 4.0, 3.5, 3.0): True,
        Rms(4.0, 4.0, 4.0, 4.0, 3.0): None,
        Rms(4.0, 3.0, None, None, 3.0): None,
    }
    for rms, confirmed in told.items():
        assert rms.confirmed is confirmed
        assert rms.unconfirmed == (confirmed is False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("after", "again", "verdict"),
    [
        (2.2e-5, 0.2, "named_insufficient"),
        (2.2e-5, 0.6, "named"),
        (2e-5, 0.2, "named"),
    ],
)
def test_what_unused_poses_refute_is_not_named(
    after: float, again: float, verdict: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Most folds have to select something else, and what they select must not predict the poses left out."""
    proof = HeldOut(2.1e-5, after, (2.1e-5, after), 2e-5, (), again)
    monkeypatch.setattr(engine, "held_out", lambda *_: proof)
    found = _diagnosed(measured(HARDENING, poses=16))
    assert found.verdict == verdict
    assert [e.effect for e in found.named] == ["nonlinear_stiffness"]
    assert (found.named[0].confidence <= 0.5) == (after > 2.1e-5)
    perhaps = words.headline(found).startswith(
        "Something is missing, perhaps: nonlinear stiffness at joint 2"
    )
    assert perhaps == (after > 2.1e-5)
    assert ("What is missing, perhaps: " in words.sentence(found)) == (perhaps and verdict == "named")
    assert ("another effect is in front" in words.sentence(found)) == (verdict != "named")


@pytest.mark.slow
def test_the_folds_that_select_what_all_data_do_are_counted() -> None:
    found = _diagnosed(measured(HARDENING, poses=16)).last.held_out
    assert found is not None
    agree = [fold == ("nonlinear_stiffness@joint=2",) for fold in found.selected]
    assert found.again == np.mean(agree) > 0.8
    assert not found.refutes


def test_the_gap_closed_is_a_share_of_what_noise_does_not_explain_and_unknown_where_that_is_little() -> None:
    assert HeldOut(3.0, 1.5, (3.0, 1.5), 1.0, (), 1.0).closure == pytest.approx(0.75)
    assert HeldOut(3.0, 3.5, (3.0, 3.5), 1.0, (), 1.0).closure == pytest.approx(-0.25)
    for before in (1.04, 1.0, 0.9):  # of a gap that is hardly there, chance closes any share
        assert np.isnan(HeldOut(before, 0.9, (before, 0.9), 1.0, (), 1.0).closure)


def test_poses_left_out_speak_against_a_name_where_most_folds_select_another_that_predicts_worse() -> None:
    """Rows weighed alike before and after: the best of both weights says nothing of what was selected."""
    assert HeldOut(2.1, 2.0, (2.1, 2.2), 2.0, (), 0.2).refutes
    assert not HeldOut(2.1, 2.2, (2.2, 2.1), 2.0, (), 0.2).refutes
    assert not HeldOut(2.1, 2.2, (2.1, 2.2), 2.0, (), 0.6).refutes


def test_a_law_is_judged_on_poses_that_the_model_has_not_seen_either() -> None:
    """By hand: plain least squares of model and law on the other poses, and what that misses in those left out."""
    problem = hardening()
    scan = open_scan(build(problem, (), ()), start(problem, Split()), problem.y, problem.A)
    layer = next(la for la in scan.layers if la.sharing.ratio == 0.0)
    sigma = scan.noise.spread
    law = np.tanh(np.arange(problem.rows) / 40.0)[:, None]
    white = law / sigma[:, None]
    outside = white - layer.basis @ (layer.basis.T @ white)
    fold = np.unique(problem.pose, return_inverse=True)[1].reshape(-1) % 5
    left = whole = 0.0
    for k in range(5):
        train = fold != k
        for columns in (problem.A, np.hstack([problem.A, law])):
            length = np.linalg.norm(columns, axis=0)
            X = columns / sigma[:, None] / np.where(length > 0, length, 1.0)
            beta = np.linalg.lstsq(X[train], (problem.y / sigma)[train], rcond=1e-9)[0]
            missed = float(np.sum(((problem.y / sigma)[~train] - X[~train] @ beta) ** 2))
            left, whole = (left, whole + missed) if columns is problem.A else (left + missed, whole)
    assert _validated(layer, [outside], fold) == pytest.approx(1.0 - left / whole, abs=1e-6)


def test_a_member_without_which_poses_left_out_are_better_predicted_is_an_even_bet() -> None:
    """Beside a gear that bends forty columns of chance: they take what is left, and predict nothing."""
    a = arm(9)
    problem = measured_rows(
        a.problem, scaled(a.problem, a.problem.J[:, 1] * a.problem.tau[:, 1] ** 3, 900.0), 3
    )
    chance = np.random.default_rng(4).normal(size=(problem.rows, 40)) * 1e-5
    block = Candidate(
        "chance", {"at": "all"}, tuple(Parameter(f"k{i}", "m") for i in range(40)), lambda _: chance
    )
    ready = prepare(problem, (*a.candidates, block))
    bank = ready.bank
    entries = tuple(bank.entries_of(bank.named[key]).start for key in ("bend@joint=2", "chance@at=all"))
    allowed = np.ones(len(bank.candidates), dtype=bool)
    proof = held_out(problem, bank, ready.scan.noise.alone, SIGMA, [entries], allowed, Options())
    assert proof is not None
    assert proof.without[0].ratio > 1.2
    assert proof.without[0].deviations > 2.0
    assert proof.without[1].ratio < 0.95
    assert proof.without[1].deviations < -1.0
    assert proof.spoken_against == (False, True)
    leader = cast(Judged, SimpleNamespace(rivals=Rivals((), (-np.inf, -np.inf), None)))
    none = cast(Any, None)
    told = Outcome("named", Reason(Why.AHEAD), none, none, 0.0, 0.0, leader, (leader,), (0.9, 0.8), (leader,))
    assert doubted(told, replace(proof, again=1.0)).confidence == (0.9, 0.5)
    assert doubted(told, replace(proof, again=1.0)).verdict == "named"
    alone = held_out(problem, bank, ready.scan.noise.alone, SIGMA, [entries[:1]], allowed, Options())
    assert alone is not None
    assert alone.without == ()
