"""The noise on arrays: what poses share, axes and units, stated and found; the lack of fit by strata."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.discrepancy.examine import examine
from symstiff.discrepancy.noise.scales import homogeneity
from symstiff.discrepancy.problem import Candidate, Options, Parameter, Problem
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.prepare import noise_told_anew, prepare
from symstiff.discrepancy.statistics.scan import extend, likeliest
from symstiff.discrepancy.statistics.strata import strata
from tests.test_discrepancy_engine import QUICK, SIGMA, arm, catalogue, measured, saturating, scaled


@pytest.mark.slow
@pytest.mark.parametrize("size", [2.0, 12.0])
def test_an_approach_error_common_to_a_poses_load_cases_raises_no_alarm(size: float) -> None:
    a = arm(12)
    found = [examine(measured(a.problem, 0.0, s, size * SIGMA), a.candidates, QUICK) for s in range(10)]
    assert [d.verdict for d in found].count("nothing_missing") >= 9
    assert np.median([d.noise.approach for d in found]) == pytest.approx(size * SIGMA, rel=0.5)


def repeated(problem: Problem, times: int) -> Problem:
    """Every row measured several times."""
    names = ("y", "A", "pose", "case", "channel", "axis", "load", "J", "tau", "q", "time", "branch")
    more = {name: np.concatenate([getattr(problem, name)] * times) for name in names}
    return replace(problem, **more, turn=np.repeat(np.arange(times), problem.rows))


def approached(problem: Problem, size: float, seed: int, anew: bool) -> Problem:
    """The repeats with noise and an error of every approach, or of every pose, by ``size`` [m]."""
    assert problem.turn is not None
    rng = np.random.default_rng(300 + seed)
    shared = size * rng.normal(size=(problem.poses, problem.turn.max() + 1, 2))
    error = shared[problem.pose, problem.turn if anew else 0, problem.axis]
    return replace(problem, y=problem.y + error + SIGMA * rng.normal(size=problem.rows))


@pytest.mark.slow
@pytest.mark.parametrize("anew", [True, False])
def test_a_robot_that_comes_back_for_every_repeat_or_stays_raises_no_alarm(anew: bool) -> None:
    a = arm(12, levels=(0.5, 1.0))
    again = repeated(a.problem, 3)
    candidates = catalogue(again)
    found = [examine(approached(again, 3.0 * SIGMA, s, anew), candidates, QUICK) for s in range(8)]
    assert [d.verdict for d in found].count("nothing_missing") >= 7
    assert np.median([d.noise.sigma for d in found]) == pytest.approx(SIGMA, rel=0.1)
    assert np.median([d.noise.approach for d in found]) == pytest.approx(3.0 * SIGMA, rel=0.25)
    assert {d.noise.source for d in found} == {"repeats"}
    assert [d.noise.misstated for d in found].count(True) <= 1


@pytest.mark.parametrize("axes", [(0, 1, 2), (0, 1, 2, 3, 4, 5)])
def test_axes_of_one_noise_are_called_unlike_no_more_often_than_is_said(axes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    axis = np.tile(axes, 60)
    rows = np.arange(len(axis))
    problem = Problem(np.zeros(len(axis)), np.zeros((len(axis), 0)), rows, rows, axis, axis)
    p = np.array([homogeneity(problem, rng.normal(size=len(axis)), len(axis)) for _ in range(1500)])
    for level in (0.05, 0.01):
        assert np.mean(p < level) < level + 3.0 * np.sqrt(level / len(p))
        assert np.mean(p < level) > level / 3.0


@pytest.mark.parametrize("size", [0.0, 3.0])
def test_a_lack_of_fit_is_seen_where_every_repeat_is_an_approach(size: float) -> None:
    again = repeated(arm(12, levels=(0.25, 0.5, 0.75, 1.0)).problem, 3)
    assert again.load is not None
    each = 6.0 * SIGMA * np.random.default_rng(5).normal(size=(again.poses, 2))[again.pose, again.axis]
    table = approached(replace(again, y=again.y + each * again.load**2), size * SIGMA, 2, True)
    parts = {s.name: s for s in strata(table, prepare(table, ()).scan)}
    assert parts["repeats"].degrees_of_freedom > 100
    assert parts["proportional to load, by pose"].p_value < 1e-3  # type: ignore[operator]
    clean = approached(again, size * SIGMA, 3, True)
    for s in strata(clean, prepare(clean, ()).scan):
        assert s.ratio == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / s.degrees_of_freedom))


def drifting(problem: Problem) -> Candidate:
    """The frame, over the session."""
    assert problem.time is not None
    columns = (problem.axis[:, None] == np.unique(problem.axis)) * problem.time[:, None]
    sizes = (Parameter("x", "m"), Parameter("y", "m"))
    return Candidate("drift", {"measurement": "frame"}, sizes, lambda shape: columns)


def test_a_drift_between_repeats_is_no_noise_once_it_is_in_the_model() -> None:
    again = repeated(arm(12, levels=(0.5, 1.0)).problem, 3)
    again = replace(again, time=np.arange(again.rows, dtype=float) / again.rows)
    drift = 6.0 * SIGMA * again.time * (again.axis == 0)
    noise = SIGMA * np.random.default_rng(8).normal(size=again.rows)
    table = replace(again, y=again.y + drift + noise, sigma=np.full(again.rows, SIGMA))
    found = examine(table, (*catalogue(table), drifting(table)), QUICK)
    assert [e.effect for e in found.effects] == ["drift"]
    assert found.noise.sigma == pytest.approx(SIGMA, rel=0.15)
    assert not found.noise.misstated
    assert found.rms.after == pytest.approx(found.rms.noise, rel=0.1)
    assert all(s.degrees_of_freedom > 0 for step in found.growth for s in step.strata)
    for s in found.growth[-1].strata:
        assert s.ratio == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / s.degrees_of_freedom))


def test_too_few_rows_say_nothing_of_a_shared_error() -> None:
    a = arm(2, levels=(0.5, 1.0))
    assert prepare(measured(a.problem, 0.0, 1), ()).report.approach_p == 1.0


def test_what_is_missing_is_named_where_every_repeat_is_an_approach() -> None:
    again = repeated(arm(12, levels=(0.33, 0.67, 1.0)).problem, 3)
    signal = scaled(again, saturating(again, 1), 900.0)
    found = examine(
        approached(replace(again, y=again.y + signal), 2.0 * SIGMA, 1, True), catalogue(again), QUICK
    )
    assert found.verdict == "named"
    assert [(e.effect, e.where) for e in found.effects] == [("bend", {"joint": 2})]


def test_the_reading_without_load_that_a_poses_load_cases_share_is_found() -> None:
    a = arm(60)
    found = [prepare(measured(a.problem, 0.0, s, 0.35 * SIGMA), a.candidates) for s in range(6)]
    assert np.median([f.report.approach for f in found]) == pytest.approx(0.35 * SIGMA, rel=0.3)
    assert np.median([f.report.sigma for f in found]) == pytest.approx(SIGMA, rel=0.03)


@pytest.mark.parametrize(("own", "size"), [(0.0, 0.7), (1.0, 0.7), (1.0, 0.4), (0.0, 0.0)])
def test_the_approach_error_is_found_whether_the_markers_share_it_or_not(own: float, size: float) -> None:
    poses, cases, markers = 40, 3, 3
    pose, case, channel = (g.ravel() for g in np.indices((poses, cases, 3 * markers)))
    rng = np.random.default_rng(3)
    shared = rng.normal(size=(poses, 3))[pose, channel % 3]
    alone = rng.normal(size=(poses, 3 * markers))[pose, channel]
    error = rng.normal(size=len(pose)) + size * (np.sqrt(1 - own) * shared + np.sqrt(own) * alone)
    problem = Problem(
        SIGMA * error, np.ones((len(pose), 1)), pose, case, channel, channel % 3,
        sigma=np.full(len(pose), SIGMA), load=(1.0 + case) / cases,
    )  # fmt: skip
    report = prepare(problem, ()).report
    assert report.approach == pytest.approx(size * SIGMA, abs=0.3 * SIGMA)
    assert report.sigma == pytest.approx(SIGMA, rel=0.06)


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_misstated_sigma_is_noticed_and_changes_no_p_value(factor: float) -> None:
    a = arm(20)
    problem = measured(a.problem, scaled(a.problem, saturating(a.problem, 0), 60.0), 6)
    right = examine(replace(problem, sigma=np.full(problem.rows, SIGMA)), a.candidates, QUICK)
    wrong = examine(replace(problem, sigma=np.full(problem.rows, SIGMA * factor)), a.candidates, QUICK)
    assert wrong.noise.misstated
    assert not right.noise.misstated
    assert wrong.noise.ratio == pytest.approx(1 / factor, rel=0.1)
    assert wrong.p_missing == pytest.approx(right.p_missing, rel=1e-3)
    assert wrong.verdict == right.verdict


@pytest.mark.parametrize(
    ("factor", "differences", "wrong"),
    [(1.0, True, False), (1.0, False, False), (1.41, True, False), (1.41, False, True), (2.2, True, True)],
)
def test_a_stated_sigma_of_differences_may_count_the_reading_without_load(
    factor: float, differences: bool, wrong: bool
) -> None:
    """That reading is what a pose's rows share, as noisy as one of the others: together √2 of it."""
    problem = measured(arm(20).problem, 0.0, 6, SIGMA)
    told = replace(problem, sigma=np.full(problem.rows, factor * SIGMA), differences=differences)
    assert prepare(told, ()).report.misstated == wrong


@pytest.mark.parametrize(("factor", "verdict"), [(1.77, "nothing_missing"), (2.4, "unexplained")])
def test_a_residual_far_above_the_stated_sigma_is_not_called_explained(factor: float, verdict: str) -> None:
    """A sigma of one reading that is a fifth too small is misstated, and what is left is still noise."""
    a = arm(20)
    found = examine(
        replace(measured(a.problem, 0.0, 6), sigma=np.full(a.problem.rows, SIGMA / factor)),
        a.candidates,
        QUICK,
    )
    assert (found.verdict, found.effects) == (verdict, ())
    assert found.noise.misstated
    assert ("2.4 times the stated sigma" in found.reason) == (verdict == "unexplained")


@pytest.mark.parametrize(("factor", "verdict"), [(3.0, "nothing_missing"), (8.0, "unexplained")])
def test_single_readings_hold_how_the_robot_misses_its_poses(factor: float, verdict: str) -> None:
    a = arm(60, (1.0,))
    table = replace(measured(a.problem, 0.0, 7), sigma=np.full(a.problem.rows, SIGMA / factor))
    found = examine(table, a.candidates, QUICK)
    assert found.noise.single
    assert found.noise.misstated
    assert found.verdict == verdict
    assert not examine(measured(arm(20).problem, 0.0, 7), arm(20).candidates, QUICK).noise.single


def test_noise_that_grows_with_distance_is_found() -> None:
    a = arm(30)
    distance = np.linspace(1.0, 4.0, a.problem.rows)
    rng = np.random.default_rng(8)
    y = a.problem.y + rng.normal(size=a.problem.rows) * SIGMA * distance
    d = examine(replace(a.problem, y=y, spread={"distance": distance}), a.candidates, QUICK)
    assert d.noise.growth["distance"] == pytest.approx(1.0, abs=0.4)
    assert d.verdict == "nothing_missing"


def test_noise_of_positions_and_of_rotations_is_not_mixed() -> None:
    """Axis 1 of the arm stands for a rotation, twenty times as noisy in its unit."""
    a = arm()
    turning = a.problem.axis == 1
    size = np.where(turning, 20.0 * SIGMA, SIGMA)
    rng = np.random.default_rng(9)
    shared = rng.normal(size=(a.problem.poses, 2))[a.problem.pose, a.problem.axis]
    problem = replace(a.problem, axis=np.where(turning, 3, 0), sigma=size)
    for approach in (0.0, 2.0):
        y = a.problem.y + size * (rng.normal(size=a.problem.rows) + approach * shared)
        noise = examine(replace(problem, y=y), a.candidates, QUICK).noise
        assert noise.sigma == pytest.approx(SIGMA, rel=0.15)
        assert noise.stated == pytest.approx(SIGMA)
        assert noise.ratio == pytest.approx(1.0, abs=0.15)
        assert (noise.approach_p < 0.01) == bool(approach)
        if approach:
            assert noise.approach == pytest.approx(approach * SIGMA, rel=0.4)


def test_what_is_missing_does_not_make_the_start_model_worse_than_it_is() -> None:
    """Before an effect is in the model it passes for a shared error, by which the start model must not be fitted."""
    a = arm(20)
    problem = measured(a.problem, scaled(a.problem, saturating(a.problem, 1), 6000.0), 5)
    found = examine(problem, a.candidates, QUICK)
    left = problem.y - problem.A @ np.linalg.lstsq(problem.A, problem.y, rcond=None)[0]
    assert found.rms.before == pytest.approx(float(np.sqrt(np.mean(left**2))), rel=0.02)
    ready = prepare(problem, a.candidates)
    score = np.where(ready.bank.generic, -np.inf, evidence(ready.scan).score)
    entry = int(evidence(ready.scan).best_entry[int(np.argmax(score))])
    alone, with_it = ready.scan.best.sharing, likeliest(ready.scan, (entry,)).sharing
    assert alone.ratio > 1.0
    assert with_it.ratio < 0.2


@pytest.mark.parametrize("poses", [8, 12])
def test_the_gap_starts_at_what_the_start_model_leaves_when_it_is_identified_by_itself(poses: int) -> None:
    """Weighed by the error that poses share it would leave 8 to 19 % more, which no effect then closes."""
    a = arm(poses)
    problem = measured(a.problem, scaled(a.problem, saturating(a.problem, 1), 200.0), 0, 2.0 * SIGMA)
    found = examine(problem, a.candidates, Options(draws=150))
    left = problem.y - problem.A @ np.linalg.lstsq(problem.A, problem.y, rcond=None)[0]
    assert found.verdict == "named"
    assert found.noise.approach > SIGMA
    assert found.rms.before == pytest.approx(float(np.sqrt(np.mean(left**2))), rel=2e-3)
    assert found.held_out is not None
    assert found.rms.held_out_before == found.held_out.before <= found.held_out.alike[0]
    assert found.held_out.after < found.held_out.before
    assert found.held_out.after <= found.held_out.alike[1]


def test_a_shift_of_two_poses_is_no_error_that_all_poses_share_once_it_is_named() -> None:
    a = arm(12)
    rng = np.random.default_rng(4)
    slipped = {p: rng.normal(size=2) for p in (3, 8)}
    shift = np.array(
        [slipped.get(int(p), np.zeros(2))[k] for p, k in zip(a.problem.pose, a.problem.axis, strict=True)]
    )
    problem = measured(a.problem, scaled(a.problem, shift, 60.0), 1)

    def of_pose(p: int) -> Candidate:
        columns = np.stack([(a.problem.pose == p) & (a.problem.axis == k) for k in (0, 1)], axis=1)
        return Candidate(
            "bad", {"pose": p}, (Parameter("x", "m"), Parameter("y", "m")), lambda _: 1.0 * columns
        )

    ready = prepare(problem, [of_pose(p) for p in range(12)])
    entries = tuple(
        int(np.flatnonzero(ready.bank.owner == ready.bank.named[f"bad@pose={p}"])[0]) for p in (3, 8)
    )
    before, after = (
        noise_told_anew(problem, ready, ()).report,
        noise_told_anew(problem, ready, entries).report,
    )
    assert before.approach_p < 1e-3
    assert before.approach > 0.5 * SIGMA
    assert after.approach_p > 0.1
    assert after.approach < 0.3 * SIGMA
    assert after.sigma == pytest.approx(SIGMA, rel=0.15)


def test_a_scan_holds_the_columns_once_and_not_at_every_sharing() -> None:
    """Of a large table they are most of the memory."""
    a = arm()
    scan = prepare(measured(a.problem, scaled(a.problem, saturating(a.problem, 1), 400.0)), a.candidates).scan
    assert len(scan.layers) > 2
    for held in (scan, extend(scan, (1, 4))):
        mixes = [array for la in held.layers for pair in la.bases.of_several for array in pair]
        arrays = [v for la in held.layers for part in (la, la.bases) for v in vars(part).values()]
        held_by_layers = sum(x.nbytes for x in (*arrays, *mixes) if isinstance(x, np.ndarray))
        assert held_by_layers < 0.5 * scan.columns.nbytes
        assert held.columns is scan.columns


def test_the_noise_of_the_axes_is_not_what_a_model_of_many_parameters_leaves() -> None:
    a = arm(12)
    wide = np.random.default_rng(0).normal(size=(a.problem.rows, a.problem.rows // 2))
    found = []
    for seed in range(6):
        problem = measured(a.problem, 0.0, seed)
        problem = replace(problem, A=np.hstack([problem.A, wide]))
        found.append(list(prepare(problem, ()).report.by_axis.values()))
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(SIGMA, rel=0.1)
