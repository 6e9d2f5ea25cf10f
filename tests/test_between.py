"""Shapes between those of a profile: of what stands out, no more than a step away, and in every fold anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.arrays import Array
from symstiff.calibration.simulation import Effect, Truth, clean_response, nominal_truth
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.examine import examine
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.problem import Candidate, Options, Parameter, Problem, Shape
from symstiff.discrepancy.search import proof
from symstiff.discrepancy.statistics.between import between, with_shapes
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.base import Move, Scales
from symstiff.effects.registry import catalogue
from symstiff.robot import load
from symstiff.symbolic.terms import actuated_joint
from tests.test_discrepancy_engine import QUICK, arm, measured, scaled
from tests.test_unknown_weights import weighing

KNEES = (0.2, 0.6)
SIGMA = 2e-5


def bending(problem: Problem, knee: float, joint: int = 1) -> Array:
    """(M,) what joint's gear adds that saturates from a share of its largest load on."""
    assert problem.tau is not None
    assert problem.J is not None
    t = problem.tau[:, joint] / np.max(np.abs(problem.tau[:, joint]))
    return np.asarray(problem.J[:, joint] * np.clip(t, -knee, knee))


def bend(problem: Problem, moves: bool = True) -> Candidate:
    def columns(shape: Shape) -> Array:
        return bending(problem, shape["knee"])[:, None]

    shapes = tuple({"knee": k} for k in KNEES)
    return Candidate(
        "bend",
        {"joint": 2},
        (Parameter("size", "rad", -1e-1, 1e-1),),
        columns,
        shapes,
        moves=lambda shape: {"knee": Move(1.8)} if moves else {},
    )


def made(knee: float, noncentrality: float, moves: bool = True) -> tuple[Problem, Candidate]:
    problem = arm().problem
    problem = measured(problem, scaled(problem, bending(problem, knee), noncentrality))
    return problem, bend(problem, moves)


@pytest.mark.parametrize("knee", [0.34, 0.45])
def test_the_shape_that_the_data_ask_for_is_found_between_those_of_the_profile(knee: float) -> None:
    problem, candidate = made(knee, 2000.0)
    found = examine(problem, (candidate,), QUICK)
    assert found.verdict == "named"
    assert found.effects[0].shape["knee"] == pytest.approx(knee, rel=0.07)
    coarse = examine(problem, (replace(candidate, moves=lambda shape: {}),), QUICK)
    assert coarse.verdict != "named"
    assert found.rms.after < coarse.rms.after
    # the table of candidates has it as tested, by the shape that was found
    (row,) = found.candidates
    assert row.testable
    assert row.p_value < 1e-3
    assert row.shape == found.effects[0].shape


def test_nothing_lies_between_where_the_profile_holds_the_truth_or_nothing_stands_out() -> None:
    for knee, size in ((0.6, 300.0), (0.34, 0.0)):
        problem, candidate = made(knee, size)
        assert all(c.between == 0 for c in prepare(problem, (candidate,)).bank.candidates)


@pytest.mark.parametrize(
    ("shapes", "end"), [(({"knee": 0.6},), 0.6 / 1.8), (({"knee": 0.6}, {"knee": 0.45}), 0.45)]
)
def test_no_value_goes_further_than_a_step_or_out_of_its_profile(
    shapes: tuple[Shape, ...], end: float
) -> None:
    problem, candidate = made(0.05, 3000.0)
    bank = prepare(problem, (replace(candidate, shapes=shapes),)).bank
    assert min(s["knee"] for s in bank.candidates[0].shapes) == pytest.approx(end, rel=0.01)


def test_an_angle_has_no_ends() -> None:
    problem, candidate = made(0.05, 3000.0)
    around = replace(candidate, moves=lambda shape: {"knee": Move(0.2, added=True, around=True)})
    bank = prepare(problem, (around,)).bank
    assert min(s["knee"] for s in bank.candidates[0].shapes) < 0.1 < min(KNEES)


def test_a_shape_between_is_as_likely_as_the_one_that_it_came_from_and_the_shares_sum_to_one() -> None:
    problem, candidate = made(0.34, 2000.0)
    bank = prepare(problem, (replace(candidate, weights=(1.0, 3.0)),)).bank
    grown = bank.candidates[0]
    assert grown.between > 0
    origin = {shape["knee"]: weight for shape, weight in zip(grown.shapes, grown.weights, strict=True)}
    for shape, weight in list(zip(grown.shapes, grown.weights, strict=True))[-grown.between :]:
        assert weight == origin[min(KNEES, key=lambda k: abs(np.log(k / shape["knee"])))]
    own = bank.share[bank.owner == 0]
    assert own.sum() == pytest.approx(1.0)


def test_a_shape_that_the_bank_has_is_not_added_again() -> None:
    problem, candidate = made(0.34, 2000.0)
    scan = prepare(problem, (replace(candidate, moves=lambda shape: {}),)).scan
    again = with_shapes(problem, scan.bank, {0: [({"knee": KNEES[0]}, 1), ({"knee": 0.3}, 1)]})
    assert again.candidates[0].shapes == (*({"knee": k} for k in KNEES), {"knee": 0.3})
    assert again.candidates[0].between == 1
    assert between(scan) == {}


def test_the_folds_of_the_proof_do_not_know_the_shape_that_all_data_ask_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, candidate = made(0.34, 2000.0)
    seen = []
    own = proof._select

    def watched(problem: Problem, bank: object, *rest: object) -> object:
        seen.append([dict(bank.shape_of(e)) for e in range(len(bank.start))])  # type: ignore[attr-defined]
        return own(problem, bank, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(proof, "_select", watched)
    found = examine(problem, (candidate,), Options(draws=150))
    assert found.effects[0].shape["knee"] not in KNEES
    assert seen
    assert all(shapes == [{"knee": k} for k in KNEES] for shapes in seen)
    assert found.held_out is not None
    assert found.held_out.closure > 0.97  # each fold finds a shape between for itself
    fixed = examine(problem, (bend(problem, moves=False),), Options(draws=150)).held_out
    assert fixed is not None
    assert fixed.after > 1.1 * found.held_out.after


@settings(max_examples=50, deadline=None)
@given(st.floats(1e-3, 1e4), st.floats(-1, 1), st.floats(1.1, 3.0), st.booleans())
def test_steps_there_and_back_are_none(value: float, steps: float, step: float, added: bool) -> None:
    move = Move(step, added)
    assert move(move(value, steps), -steps) == pytest.approx(value, rel=0.02, abs=0.02)
    assert move(value, 0.0) == pytest.approx(value, rel=5e-3)


def test_whatever_moves_is_in_a_shape_of_its_effect_and_leaves_a_shape_of_it() -> None:
    robot = load("kuka_kr270")
    scales = Scales(
        "deflection",
        {actuated_joint(j): 900.0 for j in range(1, 7)},
        (),
        {"time": 3600.0, "temperature": 4.0},
    )
    moving = set()
    for effect in catalogue().values():
        for where in effect.places(robot) if effect.places_in is None else ():
            for shape in effect.shapes(robot, where, scales):
                moves = effect.moves(robot, shape)
                for key in moves.keys() & shape.keys():
                    moving.add((effect.identifier, key))
                    after = {**shape, key: moves[key](shape[key], 0.5)}
                    assert after[key] != shape[key] or shape[key] == 0.0
                    assert effect.realise(robot, where, after).parameters
    assert {e for e, _ in moving} >= {"backlash", "nonlinear_stiffness", "hysteresis", "thermal_drift"}
    assert ("nonlinear_stiffness", "towards") in moving


def two_slopes(knee: float, size: float) -> Measurements:
    """Deflections of a KR 270 with a ton of weights that its file does not tell, and a gear of two slopes."""
    robot, rng = load("kuka_kr270"), np.random.default_rng(5)
    heavy = weighing(
        robot,
        {1: (250.0, (0, 0, 0)), 2: (250.0, (-0.5, 0, 0)), 3: (150.0, (0, 0, 0.1)), 4: (60.0, (0, 0.05, 0.1))},
    )
    low, high = np.array([j.range for j in robot.joint]).T
    q = np.repeat(rng.uniform(low, high, (40, 6)), 3, axis=0)
    force = rng.normal(size=(40, 3))
    force *= 2000.0 / np.linalg.norm(force, axis=1)[:, None]
    w = np.array([np.r_[f * level, 0, 0, 0] for f in force for level in (1 / 3, 2 / 3, 1.0)])
    gear = Effect("nonlinear_stiffness", {"joint": 2}, "two_slope", {"c": size, "knee": knee})
    read = clean_response(Truth(heavy, nominal_truth(robot), (gear,)), q, w, {"kind": "deflection"})
    read[:, :3] += SIGMA * rng.normal(size=(len(w), 3))
    read[:, 3:] = np.nan
    return measurements(
        q, w, values=read, sigma=np.where(np.isnan(read), np.nan, SIGMA), pose=np.repeat(np.arange(40), 3),
        kind="deflection", joint_units=["rad"] * 6,
    )  # fmt: skip


@pytest.mark.slow
def test_a_gear_of_which_much_is_seen_is_named_though_no_shape_of_the_profile_is_near() -> None:
    found = diagnose(Task(load("kuka_kr270"), two_slopes(2900.0, 1e-7)))
    assert found.verdict == "named"
    assert (found.named[0].effect, found.named[0].where) == ("nonlinear_stiffness", {"joint": 2})
    assert {e.effect for e in found.named[1:]} <= {
        "large_deflection"
    }  # a ton that sags is in these data as well
    assert found.named[0].shape["load"] == pytest.approx(2900.0, rel=0.2)
    assert found.rms.noise == pytest.approx(SIGMA, rel=0.15)  # a third more by the profile alone
