"""What an experiment can tell, by its design: what candidates leave of each other, poses that decide, sizes seen."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.discrepancy.apart.separation import Hypotheses, deciding_poses
from symstiff.discrepancy.statistics.design import confusability, detectable_noncentrality
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.null import tail
from symstiff.discrepancy.statistics.prepare import prepare
from tests.test_discrepancy_engine import arm, measured, saturating, scaled


def test_what_two_candidates_leave_of_each_other_is_at_most_what_the_model_leaves() -> None:
    a = arm(10)
    ready = prepare(measured(a.problem, scaled(a.problem, saturating(a.problem, 0), 100.0)), a.candidates)
    D = confusability(ready.scan, [int(e) for e in evidence(ready.scan).best_entry[:6]])
    assert np.all(np.diag(D)[:, None] >= D - 1e-9)


def test_deciding_poses_are_those_where_the_rivals_differ() -> None:
    rng = np.random.default_rng(0)
    pose = np.repeat(np.arange(6), 4)
    model = rng.normal(size=(24, 2))
    first = rng.normal(size=(24, 1))
    second = np.array(first)
    second[pose == 4] = rng.normal(size=(4, 1))
    both = np.hstack([first, second])
    rivals = Hypotheses(model, both, both, ((np.array([0]),), (np.array([1]),)))
    chosen = deciding_poses(rivals, pose, 0.1, 3)
    assert 4 in chosen.poses
    assert chosen.separation[-1] > 0
    assert all(b >= a - 1e-9 for a, b in zip(chosen.separation, chosen.separation[1:], strict=False))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-5, 5), min_size=60, max_size=80), st.floats(-6, 20), st.floats(0, 5))
def test_a_higher_score_never_has_a_larger_p_value(sample: list[float], value: float, more: float) -> None:
    null = np.sort(np.array(sample))
    assert 0 < tail(null, value + more) <= tail(null, value) + 1e-12 <= 1 + 1e-12


@settings(max_examples=25, deadline=None)
@given(st.floats(-1, 6), st.integers(1, 6), st.integers(40, 400))
def test_more_columns_or_a_higher_bar_need_a_larger_effect(score: float, rank: int, freedom: int) -> None:
    base = detectable_noncentrality(score, -4.0, float(rank), freedom)
    assert detectable_noncentrality(score + 1.0, -4.0, float(rank), freedom) > base
    assert base > 0


def test_of_few_degrees_of_freedom_no_signal_stands_out() -> None:
    assert detectable_noncentrality(2.0, -7.0, 6.0, 7) == np.inf
    assert detectable_noncentrality(2.0, -7.0, 1.0, 60) < 60.0
