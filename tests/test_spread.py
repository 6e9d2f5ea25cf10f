"""Sizes of laws whose shape the data hardly tell: the least of them stands, and the others are told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.arrays import Array
from symstiff.discrepancy.examine import examine
from symstiff.discrepancy.findings.numbers import quantity
from symstiff.discrepancy.findings.result import Found, Quantity
from symstiff.discrepancy.findings.spread import _deviation
from symstiff.discrepancy.problem import Candidate, Parameter, Problem, Shape
from symstiff.discrepancy.statistics.between import Alternative
from symstiff.effects.base import Move
from tests.test_discrepancy_engine import QUICK, arm, measured, scaled

WIDTHS = (0.04, 0.08, 0.16, 0.32)


def step(problem: Problem, at: float, width: float) -> Array:
    """(M,) what joint 2 adds that turns over at a share of its largest load, to either side, within a width."""
    assert problem.tau is not None
    assert problem.J is not None
    t = problem.tau[:, 1] / np.max(np.abs(problem.tau[:, 1]))
    return np.asarray(problem.J[:, 1] * np.sign(t) / (1.0 + np.exp((at - np.abs(t)) / width)))


def found(at: float, width: float, unit: str = "rad", noncentrality: float = 250.0) -> tuple[Found, float]:
    """The effect that a diagnosis names, with the size that it was made with."""
    bare = arm(40).problem
    signal = step(bare, at, width)
    made = scaled(bare, signal, noncentrality)

    def columns(shape: Shape) -> Array:
        return step(bare, at, shape["width"])[:, None]

    candidate = Candidate(
        "step", {"joint": 2}, (Parameter("gap", unit, 0.0, 1.0),), columns,
        tuple({"width": w} for w in WIDTHS), moves=lambda shape: {"width": Move(2.0)},
    )  # fmt: skip
    finding = examine(measured(bare, made, 2), (candidate,), QUICK)
    assert finding.verdict == "named"
    (effect,) = finding.effects
    return effect, float(np.linalg.norm(made) / np.linalg.norm(signal))


def test_of_a_step_whose_foot_alone_is_seen_the_least_gap_stands_and_the_range_is_told() -> None:
    effect, true = found(1.2, 0.08)
    size = effect.parameters["gap"]
    assert size.across is not None
    low, high = size.across
    assert low == pytest.approx(size.value, rel=0.5)
    assert low < true < high
    assert high > 2.0 * low
    assert effect.shape["width"] > min(WIDTHS)


def test_a_profile_whose_shapes_differ_by_what_they_hold_is_walked_along_what_each_holds() -> None:
    """An arm that weighs nothing, or some mass."""
    bare = arm(40).problem

    def columns(shape: Shape) -> Array:
        return step(bare, 0.5, shape.get("mass", 0.08))[:, None]

    candidate = Candidate(
        "sag", {"joint": 2}, (Parameter("share", "1"),), columns,
        ({}, {"mass": 0.1}, {"mass": 0.3}), moves=lambda shape: {"mass": Move(2.0)},
    )  # fmt: skip
    for width in (0.08, 0.14):
        problem = measured(bare, scaled(bare, step(bare, 0.5, width), 400.0), 2)
        assert examine(problem, (candidate,), QUICK).verdict == "named"


def test_shapes_that_are_likelier_beyond_all_numbers_leave_a_deviation() -> None:
    """Of what is seen a thousandfold, a shape between two explains more by hundreds."""
    found = [
        Alternative({}, value, 1e-6, likelihood) for value, likelihood in ((1e-3, 0.0), (1.1e-3, 2000.0))
    ]
    assert _deviation(found, found[0]) == pytest.approx(1e-4)
    assert _deviation(found, found[1]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("least", "carried"), [(0.02, True), (0.6, False), (0.0, False)])
def test_that_one_pose_shows_nearly_all_is_told_where_others_could(least: float, carried: bool) -> None:
    bare = arm(40).problem
    column = step(bare, 0.5, 0.08) * np.where(bare.pose == 7, 1.0, least)
    candidate = Candidate("step", {"joint": 2}, (Parameter("gap", "rad"),), lambda shape: column[:, None])
    finding = examine(measured(bare, scaled(bare, column, 400.0), 2), (candidate,), QUICK)
    (effect,) = finding.effects
    assert (effect.carried is not None) == carried
    if effect.carried is not None:
        assert effect.carried[0] == 7
        assert 0.75 < effect.carried[1] <= 1.0


def test_of_a_step_that_the_loads_run_over_the_size_is_one() -> None:
    effect, true = found(0.5, 0.08, noncentrality=2000.0)
    size = effect.parameters["gap"]
    assert size.across is None
    assert size.value == pytest.approx(true, abs=4.0 * size.std)


def test_a_size_that_is_no_distance_keeps_the_likeliest_shape() -> None:
    effect, _ = found(1.2, 0.08, unit="rad/(N*m)")
    distance, _ = found(1.2, 0.08)
    assert abs(effect.parameters["gap"].value) >= abs(distance.parameters["gap"].value)


@pytest.mark.parametrize(
    ("across", "told"),
    [
        ((0.9e-3, 4e-3), "up to 4"),
        ((0.2e-3, 1.1e-3), "down to 0.2"),
        ((0.2e-3, 4e-3), "0.2 to 4"),
    ],
)
def test_the_range_is_told_beside_the_size(across: tuple[float, float], told: str) -> None:
    alone = Quantity(1e-3, 2e-4, "rad")
    size = replace(alone, across=across)
    assert quantity(size) == f"{quantity(alone)}, {told} in other shapes that fit as well"
