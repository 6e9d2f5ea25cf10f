"""The statistical engine of the discrepancy workflow on a planar arm, with laws that its candidates only resemble."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from symstiff.arrays import Array
from symstiff.discrepancy.examine import examine
from symstiff.discrepancy.noise.scales import Noise
from symstiff.discrepancy.noise.sharing import AXES, JOINTS, Sharing
from symstiff.discrepancy.problem import Candidate, Options, Parameter, Problem
from symstiff.discrepancy.statistics.design import share_left
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.statistics.scan import explained, open_scan
from symstiff.errors import UserError
from tests.blind import baselines

SIGMA = 3e-5
QUICK = Options(draws=150, held_out=False)


@dataclass(frozen=True)
class Arm:
    """A planar arm of three joints under tip forces: J (M, 3), tau (M, 3) and what a problem needs."""

    problem: Problem
    candidates: tuple[Candidate, ...]


def arm(poses: int = 20, levels: tuple[float, ...] = (0.3, 0.65, 1.0, 0.6, 0.3), seed: int = 1) -> Arm:
    rng = np.random.default_rng(seed)
    length = np.array([1.0, 0.8, 0.5])
    rows: dict[str, list[object]] = {
        k: [] for k in ("pose", "case", "axis", "J", "tau", "q", "load", "branch", "t")
    }
    for p in range(poses):
        q = rng.uniform(-1.3, 1.3, 3)
        force = rng.normal(size=2)
        force *= 800.0 / np.linalg.norm(force)
        heading = np.cumsum(q)
        link = np.column_stack([length * np.cos(heading), length * np.sin(heading)])
        arm_of = np.array([link[j:].sum(axis=0) for j in range(3)])
        J = np.column_stack([-arm_of[:, 1], arm_of[:, 0]]).T
        for c, level in enumerate(levels):
            for axis in range(2):
                rows["pose"].append(p)
                rows["case"].append(c)
                rows["axis"].append(axis)
                rows["J"].append(J[axis])
                rows["tau"].append(J.T @ force * level)
                rows["q"].append(q)
                rows["load"].append(level)
                rows["branch"].append(-1.0 if c > int(np.argmax(levels)) else 1.0)
                rows["t"].append(p + c / len(levels))
    number = {k: np.array(rows[k], dtype=np.intp) for k in ("pose", "case", "axis")}
    value = {k: np.array(rows[k], dtype=float) for k in ("J", "tau", "q", "load", "branch", "t")}
    A = value["J"] * value["tau"]
    problem = Problem(
        A @ np.array([1e-6, 2e-6, 3e-6]), A, number["pose"], number["case"], number["axis"], number["axis"],
        load=value["load"], J=value["J"], tau=value["tau"], q=value["q"], time=value["t"], branch=value["branch"],
        virtual_joints=("joint 1", "joint 2", "joint 3"), joint_of=(0, 1, 2),
    )  # fmt: skip
    return Arm(problem, catalogue(problem))


def catalogue(problem: Problem) -> tuple[Candidate, ...]:
    J, tau = problem.J, problem.tau
    assert J is not None
    assert tau is not None
    out = []
    for v in range(3):
        t, peak, where = tau[:, v], np.max(np.abs(tau[:, v])), {"joint": v + 1}

        def bend(shape: dict[str, float], v: int = v, t: Array = t, peak: float = peak) -> Array:
            return (J[:, v] * np.sign(t) * np.abs(t / peak) ** shape["power"])[:, None]

        def gap(shape: dict[str, float], v: int = v, t: Array = t, peak: float = peak) -> Array:
            return (J[:, v] * np.tanh(t / (0.05 * peak)))[:, None]

        def loop(shape: dict[str, float], v: int = v, t: Array = t, peak: float = peak) -> Array:
            return (J[:, v] * problem.branch * np.tanh(t / (0.05 * peak)))[:, None]

        def slack(shape: dict[str, float], v: int = v, t: Array = t) -> Array:
            return (J[:, v] * t)[:, None]

        shapes = ({"power": 2.0}, {"power": 3.0})
        unit = (Parameter("size", "rad", -1e-2, 1e-2),)
        out.append(Candidate("bend", where, unit, bend, shapes))
        out.append(Candidate("gap", where, unit, gap))
        out.append(Candidate("loop", where, unit, loop))
        out.append(Candidate("slack", where, unit, slack))
    drift = (Parameter("x", "m"), Parameter("y", "m"))

    def drifting(shape: dict[str, float]) -> Array:
        return np.stack([(problem.axis == a) * problem.time for a in (0, 1)], axis=1)

    out.append(Candidate("drift", {"measurement": "frame"}, drift, drifting))
    return tuple(out)


def scaled(problem: Problem, signal: Array, noncentrality: float) -> Array:
    """The signal at a size that leaves this much outside the model, by plain least squares."""
    left = signal - problem.A @ np.linalg.lstsq(problem.A, signal, rcond=None)[0]
    return signal * SIGMA * np.sqrt(noncentrality / (left @ left))


def measured(problem: Problem, signal: Array | float = 0.0, seed: int = 0, approach: float = 0.0) -> Problem:
    rng = np.random.default_rng(100 + seed)
    shared = rng.normal(size=(problem.poses, 2)) * approach
    noise = rng.normal(size=problem.rows) * SIGMA + shared[problem.pose, problem.axis]
    return replace(problem, y=problem.y + signal + noise)


def saturating(problem: Problem, v: int) -> Array:
    t = problem.tau[:, v] / np.max(np.abs(problem.tau[:, v]))
    return np.asarray(problem.J[:, v] * np.tanh(2.5 * t))


@pytest.mark.parametrize("way", [AXES, JOINTS])
def test_explained_squares_are_the_drop_of_a_generalised_least_squares_residual(way: str) -> None:
    a = arm(6)
    problem = measured(a.problem)
    ready = prepare(problem, a.candidates)
    scan = open_scan(
        ready.bank,
        Noise(np.full(problem.rows, SIGMA), (Sharing(way, 0.7),), ready.scan.noise.ways),
        problem.y,
        problem.A,
    )
    V = np.eye(problem.rows)
    for rows, U, value in scan.noise.ways[way]:
        for r, u, v in zip(rows, U, value, strict=True):
            V[np.ix_(r, r)] += 0.7 * (u * v) @ u.T
    L = np.linalg.inv(np.linalg.cholesky(V)) / SIGMA

    def residual(X: Array) -> float:
        y, W = L @ problem.y, L @ X
        return float(np.sum((y - W @ np.linalg.lstsq(W, y, rcond=None)[0]) ** 2))

    found = explained(scan)[0]
    for entry in range(0, len(ready.bank.start), 17):
        C = ready.bank.columns[:, ready.bank.slice(entry)]
        if share_left(scan, entry) > 1e-6:
            drop = residual(problem.A) - residual(np.hstack([problem.A, C]))
            assert found[entry] == pytest.approx(drop, rel=1e-5, abs=1e-5)


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing() -> None:
    a = arm(12)
    verdicts = [examine(measured(a.problem, seed=s), a.candidates, QUICK).verdict for s in range(20)]
    assert verdicts.count("nothing_missing") >= 18


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_a_softening_joint_is_named_though_the_candidates_shapes_only_resemble_it(joint: int) -> None:
    a = arm()
    signal = scaled(a.problem, saturating(a.problem, joint - 1), 120.0)
    d = examine(measured(a.problem, signal, joint, 0.5 * SIGMA), a.candidates, QUICK)
    assert d.verdict == "named"
    assert [(e.effect, e.where) for e in d.effects] == [("bend", {"joint": joint})]
    assert d.effects[0].p_value < 1e-3
    assert d.effects[0].confidence > 0.8
    assert len(d.growth) == 2
    assert d.rms.after < d.rms.before


def test_of_shapes_that_fit_almost_alike_the_one_told_beforehand_is_taken() -> None:
    a = arm(10)
    problem = measured(a.problem, scaled(a.problem, saturating(a.problem, 0), 100.0))
    bend = next(c for c in a.candidates if c.effect == "bend")
    found = []
    for weights in ((), (1.0, 1e-9), (1e-9, 1.0)):
        ready = prepare(problem, (replace(bend, weights=weights),))
        k = ready.bank.candidates.index(next(c for c in ready.bank.candidates if c.effect == "bend"))
        found.append(int(ready.bank.shape[evidence(ready.scan).best_entry[k]]))
    assert found[1:] == [0, 1]


def test_two_effects_are_both_named_and_the_growth_path_has_both_steps() -> None:
    a = arm()
    problem = a.problem
    loop = problem.J[:, 1] * problem.branch * np.sign(problem.tau[:, 1]) * np.sqrt(np.abs(problem.tau[:, 1]))
    signal = scaled(problem, saturating(problem, 2), 150.0) + scaled(problem, loop, 150.0)
    d = examine(measured(problem, signal, 3), a.candidates, QUICK)
    assert d.verdict == "named"
    assert {(e.effect, e.where["joint"]) for e in d.effects} == {("bend", 3), ("loop", 2)}
    assert [s.rms for s in d.growth] == sorted((s.rms for s in d.growth), reverse=True)
    assert len(d.growth) == 3
    assert [s.gained for s in d.growth] == [0, 1, 2]


def test_a_step_counts_what_the_data_tell_apart() -> None:
    """Of three parameters two move the data alike, and one as the model does: the step adds one."""
    a = arm()
    t = a.problem.tau[:, 1] / np.max(np.abs(a.problem.tau[:, 1]))
    law = a.problem.J[:, 1] * np.tanh(2.5 * t)
    block = np.stack([law, 2.0 * law, a.problem.A[:, 0]], axis=1)
    names = tuple(Parameter(n, "rad") for n in "abc")
    d = examine(
        measured(a.problem, scaled(a.problem, law, 300.0), 2),
        (Candidate("block", {"joint": 2}, names, lambda _: block),),
        QUICK,
    )
    assert [e.effect for e in d.effects] == ["block"]
    assert [s.gained for s in d.growth] == [0, 1]


def test_a_further_effect_must_be_more_believable_than_none() -> None:
    """However lightly it is tested: here every further effect passes its test."""
    a = arm(30)
    signal = scaled(a.problem, saturating(a.problem, 2), 400.0) + scaled(
        a.problem, saturating(a.problem, 0), 16.0
    )
    problem = measured(a.problem, signal, 5)
    found = examine(problem, a.candidates, replace(QUICK, alpha_further=1.0, alpha_notable=1.0))
    assert found.verdict == "named"
    assert [(e.effect, e.where["joint"]) for e in found.effects] == [("bend", 3)]


@pytest.mark.parametrize("strong", [0, 2])
def test_the_stronger_of_two_effects_is_told_first(strong: int) -> None:
    a = arm(40)
    sizes = {strong: 1500.0, 2 - strong: 120.0}
    signal = sum(scaled(a.problem, saturating(a.problem, v), size) for v, size in sizes.items())
    found = examine(measured(a.problem, np.asarray(signal), 3), a.candidates, QUICK)
    assert [e.where["joint"] for e in found.effects if e.set_number == 0] == [strong + 1, 3 - strong]


def test_a_law_that_the_catalogue_does_not_hold_is_not_given_a_name() -> None:
    a = arm()
    problem = a.problem
    signal = scaled(problem, problem.J[:, 1] * problem.tau[:, 1] * np.sin(3 * problem.q[:, 1] + 0.4), 200.0)
    d = examine(measured(problem, signal, 4), a.candidates, QUICK)
    assert d.verdict == "unexplained"
    assert d.effects == ()
    assert d.localisation is not None
    assert d.localisation.accused == "joint 2"
    assert d.law is not None
    assert "3*q2" in d.law.expression
    assert d.law.cross_validated > 0.2


def test_a_candidate_inside_the_model_is_called_untestable_with_its_reason() -> None:
    a = arm(12)
    d = examine(measured(a.problem), a.candidates, QUICK)
    slack = [c for c in d.candidates if c.effect == "slack"]
    assert len(slack) == 3
    assert all(not c.testable and "absorbs" in c.reason for c in slack)
    assert all(c.testable for c in d.candidates if c.effect in ("bend", "loop"))


def test_what_would_fit_anything_proportional_to_the_load_is_not_tested() -> None:
    """A block of eight parameters where the model leaves nine directions, though two of the eight are usually large."""
    bare = arm(6).problem
    rng = np.random.default_rng(2)
    slope = rng.normal(size=(6, 2, 8))
    assert bare.load is not None
    columns = slope[bare.pose, bare.axis] * bare.load[:, None]
    sizes = tuple(Parameter(f"k{i}", typical=1.0 if i < 2 else 0.02) for i in range(8))
    block = Candidate("block", {"link": 1}, sizes, lambda shape: columns)
    unknown = rng.normal(size=(6, 2))[bare.pose, bare.axis] * bare.load
    found = examine(measured(bare, scaled(bare, unknown, 600.0)), (block, *catalogue(bare)), QUICK)
    row = next(c for c in found.candidates if c.effect == "block")
    assert found.verdict == "unexplained"
    assert not row.testable
    assert "anything proportional to the load" in row.reason


def test_a_candidate_whose_data_are_missing_is_listed_with_the_reason_it_gave() -> None:
    a = arm(8)
    closed = replace(a.candidates[0], unavailable="needs temperature")
    d = examine(measured(a.problem), (closed, *a.candidates[1:]), QUICK)
    (row,) = [c for c in d.candidates if c.effect == "bend" and c.where == {"joint": 1}]
    assert not row.testable
    assert row.reason == "needs temperature"


def test_one_pose_without_sigma_or_repeats_gives_a_verdict_that_says_so() -> None:
    a = arm(1)
    d = examine(measured(a.problem), a.candidates, QUICK)
    assert d.verdict == "untestable"
    assert "one pose" in d.reason
    stated = examine(replace(measured(a.problem), sigma=np.full(a.problem.rows, SIGMA)), a.candidates, QUICK)
    assert stated.verdict == "untestable"
    assert "no place on the robot can be told from another" in stated.reason
    assert not any(c.testable for c in d.candidates)


def test_an_implausible_size_is_not_named() -> None:
    a = arm()
    signal = scaled(a.problem, saturating(a.problem, 1), 200.0)
    small = tuple(
        replace(c, parameters=(Parameter("size", "rad", 0.0, np.inf),)) if c.effect == "bend" else c
        for c in a.candidates
    )
    names = [
        {
            (e.effect, e.where["joint"])
            for e in examine(measured(a.problem, s * signal, 5), small, QUICK).effects
        }
        for s in (1.0, -1.0)
    ]
    assert sorted([("bend", 2) in n for n in names]) == [False, True]


def test_held_out_poses_show_the_gap_shrink_and_select_the_effect_in_every_fold() -> None:
    a = arm()
    signal = scaled(a.problem, saturating(a.problem, 1), 400.0)
    d = examine(measured(a.problem, signal, 7), a.candidates, replace(QUICK, held_out=True))
    assert d.held_out is not None
    assert d.held_out.after < d.held_out.before
    assert d.held_out.closure > 0.7
    assert all("bend@joint=2" in fold for fold in d.held_out.selected)


def test_the_numbers_of_the_poses_do_not_move_what_is_held_out() -> None:
    a = arm(10)
    problem = measured(a.problem, scaled(a.problem, saturating(a.problem, 2), 80.0))
    renumbered = replace(problem, pose=np.random.default_rng(1).permutation(problem.poses)[problem.pose])
    one, two = (
        examine(p, a.candidates, replace(QUICK, held_out=True, folds=4)).held_out
        for p in (problem, renumbered)
    )
    assert one is not None
    assert two is not None
    assert (one.before, one.after) == pytest.approx((two.before, two.after), rel=1e-9)


def test_the_same_data_give_the_same_diagnosis() -> None:
    a = arm(10)
    problem = measured(a.problem, scaled(a.problem, saturating(a.problem, 2), 80.0))
    one, two = (examine(problem, a.candidates, QUICK) for _ in range(2))
    assert one.candidates == two.candidates
    assert one.effects == two.effects
    assert one.p_missing == two.p_missing


def test_competing_methods_find_a_strong_effect_too() -> None:
    a = arm()
    problem = measured(a.problem, scaled(a.problem, saturating(a.problem, 1), 300.0), 9)
    ready = prepare(problem, a.candidates)

    def names(chosen: tuple[int, ...]) -> set[str]:
        return {ready.bank.candidates[c].key for c in chosen}

    assert "bend@joint=2" in names(baselines.aic(ready.scan))
    assert "bend@joint=2" in names(baselines.bic(ready.scan))
    assert names(baselines.cross_validation(ready.scan, problem))
    assert names(baselines.lasso(ready.scan, problem))


def test_data_that_cannot_be_used_are_refused_in_one_line() -> None:
    p = arm(3).problem
    with pytest.raises(UserError, match="finite"):
        replace(p, y=np.full(p.rows, np.nan))
    with pytest.raises(UserError, match="sigma"):
        replace(p, sigma=np.zeros(p.rows))
    with pytest.raises(UserError, match="rows"):
        replace(p, A=p.A[:-1])


def test_what_a_set_misses_is_judged_under_the_shared_error_that_is_left_with_it() -> None:
    """Beside one effect a second passes for joints that stand elsewhere; with it in the model they do not."""
    problem = arm().problem
    J, q = problem.J, problem.q
    assert J is not None
    assert q is not None

    def turning(v: int) -> Array:
        return np.asarray(J[:, v] * np.sin(3 * q[:, v]))

    unit = (Parameter("size", "rad", -1e-2, 1e-2),)
    angles = [
        Candidate("angle", {"joint": v + 1}, unit, lambda _, v=v: turning(v)[:, None]) for v in range(3)
    ]
    both = scaled(problem, saturating(problem, 1), 400.0) + scaled(problem, turning(0), 100.0)
    d = examine(measured(problem, both), (*catalogue(problem), *angles), QUICK)
    assert d.verdict == "named"
    found = {(name.effect, name.where["joint"]) for name, _, _ in d.leading}
    assert found == {("bend", 2), ("angle", 1)}
