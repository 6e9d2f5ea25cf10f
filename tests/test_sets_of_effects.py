"""Sets of two effects: their evidence does not lean on the way they were found, and other sets are heard."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from symstiff.arrays import Array
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.examine import _as_single, beyond, examine
from symstiff.discrepancy.findings.result import Name
from symstiff.discrepancy.problem import ANGLE, CLOCK, Candidate, Parameter, Problem
from symstiff.discrepancy.search import judging, verdict, workshop
from symstiff.discrepancy.search.proposals import in_range, of_two, polish, proposals
from symstiff.discrepancy.search.workshop import Proposal, Workshop
from symstiff.discrepancy.statistics.bank import build
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.statistics.scan import Scan, coefficients
from tests.test_assemble import complete, truth_of
from tests.test_assemble import design as experiment
from tests.test_assemble import measured as exact
from tests.test_discrepancy_engine import QUICK, SIGMA, arm, catalogue, measured, saturating, scaled

UNIT = (Parameter("size", "rad"),)


def of_sign(problem: Problem, v: int) -> Array:
    assert problem.J is not None
    assert problem.tau is not None
    return np.asarray(problem.J[:, v] * np.sign(problem.tau[:, v]))


def of_branch(problem: Problem, v: int) -> Array:
    assert problem.branch is not None
    return of_sign(problem, v) * problem.branch


def lawful(name: str, *columns: Array) -> Candidate:
    """A candidate whose shapes have one column each."""
    shapes = tuple({"number": float(k)} for k in range(len(columns)))
    return Candidate(name, {"joint": 1}, UNIT, lambda s: columns[int(s["number"])][:, None], shapes)


def left_by(scan: Scan, problem: Problem, entries: tuple[int, ...]) -> float:
    """Sum of squares that the model and some entries leave, by least squares."""
    _, _, fitted = coefficients(scan, problem.A, problem.y, entries)
    return float(np.sum((problem.y - fitted) ** 2))


@pytest.mark.parametrize("size", [60.0, 200.0, 800.0])
def test_a_set_is_worth_what_its_shapes_are_worth_together_whichever_came_first(size: float) -> None:
    """Alone, the first effect would take another shape, which passes for both of them."""
    bare = arm().problem
    a, b, c = (scaled(bare, law, 1.0) for law in (of_sign(bare, 0), of_branch(bare, 1), of_branch(bare, 2)))
    problem = replace(measured(bare, np.sqrt(size) * (a + b)), sigma=np.full(bare.rows, SIGMA))
    candidates = (lawful("first", a, a + 0.9 * b + 0.3 * c), lawful("second", b), *catalogue(bare))
    scan = prepare(problem, candidates).scan
    shop = Workshop(scan, np.ones(len(scan.bank.candidates), bool), QUICK)
    alone = int(shop.evidence(()).best_entry[0])
    second = int(shop.evidence((alone,)).best_entry[1])
    found = polish(shop, Proposal((0, 1), (alone, second), -np.inf))
    own, other = found.entries
    assert own != alone
    likelier = 0.5 * scan.freedom * np.log(left_by(scan, problem, ()) / left_by(scan, problem, (own, other)))
    assert 0.5 * likelier < found.score < likelier


def test_a_single_effect_is_not_named_where_two_others_account_for_the_data_as_well() -> None:
    bare = arm(30).problem
    a, b, c = (scaled(bare, law, 1.0) for law in (of_sign(bare, 0), of_branch(bare, 1), of_branch(bare, 2)))
    problem = measured(bare, 14.0 * a + 12.0 * b)
    near = lawful("both", 12.0 * a + 12.0 * b + 3.0 * c)
    candidates = (near, lawful("one", a), lawful("other", b), *catalogue(bare))
    found = examine(problem, candidates, QUICK)
    sets = {n: {e.effect for e in found.effects if e.set_number == n} for n in (0, 1)}
    assert found.verdict == "ambiguous"
    assert {"both"} in sets.values()
    assert {"one", "other"} in sets.values()


def test_folds_select_two_effects_where_a_single_one_passes_for_both() -> None:
    """The one that explains most by itself is neither of them: with either of them it explains less than the two."""
    bare = arm(30).problem
    a, b, c = (scaled(bare, law, 1.0) for law in (of_sign(bare, 0), of_branch(bare, 1), of_branch(bare, 2)))
    candidates = (lawful("both", a + b + 0.5 * c), lawful("one", a), lawful("other", b))
    found = examine(measured(bare, 14.0 * (a + b)), candidates, replace(QUICK, held_out=True))
    assert found.candidates[0].effect == "both"
    assert {e.effect for e in found.effects if e.set_number == 0} == {"one", "other"}
    assert found.held_out is not None
    assert found.held_out.again > 0.8


@pytest.mark.parametrize("seed", range(5))
def test_two_effects_that_hide_each_other_are_seen_together(seed: int) -> None:
    """As a payload and the zero of the sensor that weighs it: their difference is a hundredth of what each is."""
    bare = arm(30).problem
    a, b = (scaled(bare, law, 1.0) for law in (of_sign(bare, 0), of_branch(bare, 1)))
    one, other = 10.0 * a + b, 10.0 * a - b
    candidates = (lawful("one", one), lawful("other", other))
    found = examine(measured(bare, 4.0 * (one - other), seed), candidates, QUICK)
    assert found.candidates[0].p_value > QUICK.alpha > found.p_missing
    assert {e.effect for e in found.effects} == {"one", "other"}
    assert found.verdict == "named"
    assert examine(measured(bare, 0.0 * a, seed), candidates, QUICK).verdict == "nothing_missing"


@pytest.mark.slow
def test_the_p_value_of_two_effects_in_noise_is_as_likely_small_as_large() -> None:
    bare = arm(30).problem
    found = np.zeros(40)
    for seed in range(len(found)):
        ready = prepare(measured(bare, np.zeros(bare.rows), seed), catalogue(bare))
        shop = Workshop(ready.scan, np.ones(len(ready.bank.candidates), bool), QUICK)
        found[seed] = shop.null((), ()).p_two(of_two(shop, lambda p: 0.0))
    assert np.sum(found < 0.1) <= 8
    assert 8 <= np.sum(found < 0.5) <= 28


@pytest.mark.parametrize(("poses", "seed"), [(20, 66), (40, 64)])
def test_a_law_without_a_name_that_is_less_believable_than_nothing_makes_no_name_insufficient(
    poses: int, seed: int
) -> None:
    """Two of three hundred draws in which noise looks like a law: a p-value below the level, evidence below none."""
    bare = arm(poses).problem
    gear = of_sign(bare, 1)
    found = examine(measured(bare, scaled(bare, gear, 60.0), seed), (lawful("gear", gear),), QUICK)
    assert found.verdict == "named"
    assert [e.effect for e in found.effects] == ["gear"]


@pytest.mark.parametrize(("at", "as_large"), [(2, True), (0, False)])
def test_sets_that_explain_more_than_the_leader_compete_with_the_leader_and_one_effect_more(
    at: int, as_large: bool
) -> None:
    """Two others may lead one that suffices: the one with an effect elsewhere is as large as they are.

    Another law of its own joint has to explain clearly more.
    """
    bare = arm(40).problem
    assert bare.tau is not None
    strong = scaled(bare, of_sign(bare, 0), 9000.0)
    more = scaled(bare, of_sign(bare, at) * bare.tau[:, at] ** 2, 60.0)
    ready = prepare(measured(bare, strong + more, 3), (lawful("strong", strong), lawful("more", more)))
    assert ready.bank.place[:2] == ("joint 1", f"joint {at + 1}")
    shop = Workshop(ready.scan, np.array([True] * len(ready.bank.candidates)), QUICK)
    score = float(shop.evidence(()).score[0])
    leader = judging.judge(shop, Proposal((0,), (int(shop.evidence(()).best_entry[0]),), score))

    def beside(best: float) -> list[list[int]]:
        return [sorted(j.members) for j in verdict._as_many(shop, leader, best, lambda p: 0.0)]

    assert beside(score + 1.0) == ([[0, 1]] if as_large else [])
    assert beside(score + 1000.0) == []


def test_a_search_keeps_few_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    a = arm(20)
    ready = prepare(measured(a.problem, scaled(a.problem, of_sign(a.problem, 0), 400.0)), a.candidates)
    monkeypatch.setattr(workshop, "_SCANS", 3)
    shop = Workshop(ready.scan, np.array([True] * len(ready.bank.candidates)), QUICK)
    for entry in range(6):
        judged = judging.judge(shop, Proposal((int(ready.bank.owner[entry]),), (entry,), 0.0))
        assert not any(isinstance(value, Scan) for value in vars(judged).values())
    assert len(shop.scans) == 3


@pytest.mark.parametrize(("second", "told"), [(28.0, 1), (200.0, 2)])
def test_what_is_less_than_a_hundredth_of_the_signal_is_no_effect_unless_it_is_beyond_doubt(
    second: float, told: int
) -> None:
    """No shape is exact: beside a strong effect a weak one at another place may be what its shape leaves."""
    bare = arm(40).problem
    strong = scaled(bare, of_sign(bare, 0) + 0.05 * of_branch(bare, 0), 9000.0)
    weak = scaled(bare, of_branch(bare, 2), second)
    found = examine(measured(bare, strong + weak, 2), (lawful("strong", strong), *catalogue(bare)), QUICK)
    assert found.verdict == "named"
    assert [e.effect for e in found.effects if e.set_number == 0] == ["strong", "loop"][:told]


def test_two_effects_that_are_at_one_place_without_being_laws_of_one_joint_are_two() -> None:
    """A frame that drifts may be turned as well: neither is what the other one's shape leaves."""
    bare = arm(40).problem
    tip = bare.y.reshape(-1, 2)
    moved = np.where(bare.axis == 0, 1.0, -0.5) * bare.pose
    turned = np.column_stack([-tip[:, 1], tip[:, 0]]).reshape(-1)
    frame = [
        replace(lawful(name, column), where={"measurement": "frame"})
        for name, column in (("drift", moved), ("turn", turned))
    ]
    signal = scaled(bare, moved, 2000.0) + scaled(bare, turned, 120.0)
    found = examine(measured(bare, signal, 4), (*frame, *catalogue(bare)), QUICK)
    assert found.verdict == "named"
    assert [e.effect for e in found.effects if e.set_number == 0] == ["drift", "turn"]


def test_a_given_effect_that_is_not_needed_leaves_the_set() -> None:
    """A first look may have taken it for what the first look's columns left."""
    bare = arm(40).problem
    gear, idle = (scaled(bare, law, 1.0) for law in (of_sign(bare, 0), of_branch(bare, 2)))
    candidates = (lawful("gear", gear), lawful("idle", idle), *catalogue(bare))
    given = [Name(c.effect, c.where) for c in candidates[:2]]
    found = examine(measured(bare, 15.0 * gear, 4), candidates, QUICK, given=given)
    assert found.verdict == "named"
    assert [e.effect for e in found.effects] == ["gear"]


def test_a_given_effect_that_the_model_absorbs_leaves_the_set() -> None:
    bare = arm(40).problem
    gear, absorbed = scaled(bare, of_sign(bare, 0), 1.0), bare.A[:, 0].copy()
    candidates = (lawful("gear", gear), lawful("absorbed", absorbed), *catalogue(bare))
    given = [Name("absorbed", candidates[1].where)]
    found = examine(measured(bare, 15.0 * gear, 4), candidates, QUICK, given=given)
    assert (found.verdict, [e.effect for e in found.effects]) == ("named", ["gear"])


def test_a_second_effect_is_as_believable_as_the_first_one() -> None:
    """A test sees it and it is more believable than nothing: one effect is no reason for there being no other."""
    bare = arm(40).problem
    a, b = (scaled(bare, law, 1.0) for law in (of_sign(bare, 0), of_branch(bare, 1)))
    problem = measured(bare, 10.0 * a + np.sqrt(17.0) * b, 8)
    found = examine(problem, (lawful("first", a), lawful("second", b), *catalogue(bare)), QUICK)
    assert [e.effect for e in found.effects if e.set_number == 0] == ["first", "second"]


def test_an_effect_divides_its_weight_among_kinds_of_places_and_each_among_its_own() -> None:
    """That a frame drifts is not one of seven things beside six links that may."""
    bare = arm().problem
    column = of_sign(bare, 0)
    where: tuple[dict[str, object], ...] = ({"measurement": "frame"}, {"link": 1}, {"link": 2}, {"link": 3})
    drifts = [replace(lawful("drift", column), where=w) for w in where]
    unnamed = [lawful(f"law {k}", column) for k in range(3)]
    weight = np.exp(build(bare, (*drifts, lawful("gear", column)), unnamed).log_prior)
    assert weight == pytest.approx([0.175, *[0.175 / 3.0] * 3, 0.35, *[0.1] * 3])


@pytest.mark.parametrize(("shapes", "verdict_"), [(1, "named"), (2, "ambiguous")])
def test_a_law_without_a_shape_is_the_limit_of_those_that_bend(shapes: int, verdict_: str) -> None:
    """A linear one is named where one that bends may be as straight; a law of few shapes has no such right."""
    bare = arm().problem
    assert bare.J is not None
    assert bare.tau is not None
    own = scaled(bare, of_branch(bare, 1), 1.0)
    straight = lawful("straight", *[own, scaled(bare, of_sign(bare, 1) * bare.tau[:, 1] ** 2, 1.0)][:shapes])
    nearly = own + 0.1 * scaled(bare, of_sign(bare, 1), 1.0)
    others = [scaled(bare, bare.J[:, 1] * bare.tau[:, 1] ** k, 1.0) for k in range(2, 20)]
    bends = lawful("bends", nearly, *others)
    problem = measured(bare, 15.0 * nearly, 4)
    found = examine(problem, (straight, bends, *catalogue(bare)), QUICK)
    assert found.verdict == verdict_
    assert found.effects[0].effect == "straight"


@pytest.mark.parametrize("off", [-3.0, 0.5, 1.0, 1.9, 2.1])
def test_a_size_out_of_its_range_costs_what_the_data_say_against_the_range(off: float) -> None:
    """The log likelihood that is lost by moving it there; from two standard deviations on the set is none."""
    a = arm()
    problem = measured(a.problem, scaled(a.problem, saturating(a.problem, 1), 200.0), 5)
    number = next(k for k, c in enumerate(a.candidates) if c.effect == "bend" and c.where["joint"] == 2)
    scan = prepare(problem, a.candidates).scan
    entry = int(scan.bank.first_entry[number])
    estimate, deviation, _ = coefficients(scan, problem.A, problem.y, (entry,))
    top = float(estimate[-1] - off * deviation[-1])
    limited = list(a.candidates)
    limited[number] = replace(limited[number], parameters=(Parameter("size", "rad", -np.inf, top),))
    ready = prepare(problem, limited)
    kept = in_range(Proposal((number,), (entry,), 10.0), lambda p: beyond(problem, ready, p))
    assert (kept is None) == (off > 2.0)
    assert kept is None or (kept.score, kept.lost) == pytest.approx(
        (10.0 - kept.lost, 0.5 * max(off, 0.0) ** 2)
    )


def test_the_furthest_of_several_sizes_may_be_out_of_range_by_more_than_one_size_alone() -> None:
    """Of six diagonal compliances that are nearly zero one is two deviations below it in every eighth table."""
    furthest = np.random.default_rng(5).normal(size=(40_000, 6)).max(axis=1)
    as_single = np.array([_as_single(z, 6) for z in furthest if z > 0])
    for deviations in (1.0, 2.0, 2.5):
        share = np.sum(as_single > deviations) / len(furthest)
        assert share == pytest.approx(0.5 * math.erfc(deviations / math.sqrt(2.0)), rel=0.12)
    assert _as_single(2.2, 1) == 2.2
    assert _as_single(50.0, 6) == 50.0


def test_another_shape_of_a_law_is_one_by_the_same_things() -> None:
    """A gear and a law of time at one joint are two; where it is not known what a law goes by, the joint decides."""
    bare = arm().problem
    column = of_sign(bare, 1)
    by: tuple[frozenset[str] | None, ...] = (frozenset(), frozenset({ANGLE}), frozenset({CLOCK}), None)
    laws = [
        replace(lawful(f"law {k}", column), at="joint 2", driven=lambda _, d=d: d) for k, d in enumerate(by)
    ]
    elsewhere = replace(lawful("elsewhere", column), at="joint 1")
    bank = prepare(bare, (*laws, elsewhere)).bank
    alike = [[bank.another_shape(k, of) for of in range(5)] for k in range(5)]
    assert alike[0] == [True, True, True, True, False]
    assert alike[1] == [False, True, False, True, False]
    assert alike[2] == [False, False, True, True, False]
    assert alike[3] == [True, True, True, True, False]
    assert alike[4] == [False, False, False, False, True]


def test_the_catalogues_laws_tell_what_they_go_by() -> None:
    truth, table = truth_of("kuka_kr270"), experiment("kuka_kr270", "deflection")
    found = assemble(complete("kuka_kr270"), exact(truth, table))
    by = {
        (c.effect, "mass" in s or "tapered_mass" in s): c.driven(s)
        for c in found.candidates
        if not c.unavailable and c.where.get("joint") == 2
        for s in c.shapes
    }
    assert by["backlash", False] == by["nonlinear_stiffness", False] == frozenset()
    assert by["backlash", True] == by["gravity_compensator", False] == frozenset({ANGLE})


def blocks(problem: Problem) -> tuple[Candidate, ...]:
    """A candidate of six columns, and two that have four and two of them."""
    assert problem.J is not None
    assert problem.q is not None
    angles = [np.cos(problem.q[:, (v + 1) % 3]) for v in range(3)]
    columns = np.stack(
        [of_sign(problem, v) * f for v in range(3) for f in (np.ones(problem.rows), angles[v])], axis=1
    )
    unit = tuple(Parameter(f"size {k}", "rad") for k in range(6))

    def block(name: str, chosen: slice) -> Candidate:
        return Candidate(name, {"link": 0}, unit[chosen], lambda s: columns[:, chosen])

    return block("whole", slice(0, 6)), block("most", slice(0, 4)), block("rest", slice(4, 6))


def test_blocks_that_together_are_another_one_are_no_other_explanation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bare = arm(30).problem
    candidates = (*blocks(bare), *catalogue(bare))
    whole = candidates[0].columns({})
    signal = sum(scaled(bare, whole[:, k], 900.0) for k in range(6))
    problem = measured(bare, signal, 2)
    found = examine(problem, candidates, QUICK)
    assert found.verdict == "named"
    assert [e.effect for e in found.effects] == ["whole"]
    monkeypatch.setattr(verdict, "_same_columns", lambda scan, one, other: False)
    assert {e.effect for e in examine(problem, candidates, QUICK).effects} == {"most", "rest"}


def weighed(problem: Problem, name: str, law: Any) -> Candidate:
    """A law of the second joint under one of three assumed weights, which add to its load."""
    assert problem.J is not None
    assert problem.tau is not None
    J, t, top = problem.J[:, 1], problem.tau[:, 1], np.max(np.abs(problem.tau[:, 1]))

    def columns(shape: Any) -> Array:
        own = shape["mass"] * top * np.cos(problem.q[:, 1])  # type: ignore[index]
        return np.asarray(J * (law((t + own) / top) - law(own / top)))[:, None]

    shapes = tuple({"mass": m} for m in (0.1, 0.4, 1.6))
    return Candidate(name, {"joint": 2}, UNIT, columns, shapes, assumed=frozenset({"mass"}))


def test_two_laws_of_one_joint_take_the_same_weight_for_granted() -> None:
    bare = arm(30, levels=(0.25, 0.5, 0.75, 1.0)).problem
    jump = weighed(bare, "jump", lambda x: np.tanh(x / 0.04))
    bow = weighed(bare, "bow", lambda x: x * np.abs(x))
    unlike = scaled(bare, jump.columns({"mass": 0.4})[:, 0], 900.0) + scaled(
        bare, bow.columns({"mass": 1.6})[:, 0], 300.0
    )
    alike = scaled(bare, jump.columns({"mass": 0.4})[:, 0], 900.0) + scaled(
        bare, bow.columns({"mass": 0.4})[:, 0], 900.0
    )
    scan = prepare(measured(bare, unlike, 1), (jump, bow)).scan
    entry = {(int(scan.bank.owner[e]), scan.bank.shape_of(e)["mass"]): e for e in range(6)}
    assert scan.bank.contradict(entry[1, 1.6], (entry[0, 0.4],))
    assert not scan.bank.contradict(entry[1, 0.4], (entry[0, 0.4],))
    shop = Workshop(scan, np.ones(len(scan.bank.candidates), bool), QUICK)
    base = Proposal((0,), (entry[0, 0.4],), 0.0)
    (both,) = [p for p in proposals(shop, [base]) if set(p.members) == {0, 1}]
    assert both.entries == (entry[0, 0.4], entry[1, 0.4])
    found = {
        name: examine(measured(bare, y, 1), (jump, bow), QUICK)
        for name, y in (("unlike", unlike), ("alike", alike))
    }
    for one in found.values():
        masses = {e.shape["mass"] for e in one.effects if e.set_number == 0}
        assert len(masses) <= 1
    assert found["alike"].verdict == "named"
    assert {e.effect for e in found["alike"].effects} == {"jump", "bow"}
    assert found["unlike"].verdict != "named"
