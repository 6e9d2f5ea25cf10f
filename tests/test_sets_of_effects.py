"""Sets of two effects: their evidence does not lean on the way they were found, and other sets are heard."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.discrepancy.diagnose import diagnose
from symstiff.discrepancy.prepare import prepare
from symstiff.discrepancy.problem import Array, Candidate, Parameter, Problem
from symstiff.discrepancy.scan import Scan, coefficients
from symstiff.discrepancy.search import Proposal, Workshop, polish
from tests.test_discrepancy_engine import QUICK, SIGMA, arm, catalogue, measured, scaled

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
    found = diagnose(problem, candidates, QUICK)
    sets = {n: {e.effect for e in found.effects if e.set_number == n} for n in (0, 1)}
    assert found.verdict == "ambiguous"
    assert {"both"} in sets.values()
    assert {"one", "other"} in sets.values()
