"""Laws that count the links' weight, as a picture shows them: a step at no load, and not where the weight puts it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp

from symstiff.discrepancy.findings.result import Found
from symstiff.effects.arm import weight_load
from symstiff.report.whole_load import WholeLoad, whole_load
from symstiff.robot import load
from symstiff.symbolic.terms import q

GAP, WIDTH = 4e-4, 3.0
ROBOT = load("ur10")
ANGLES = np.random.default_rng(0).uniform(-2.0, 2.0, (30, 6))
LOADS = np.random.default_rng(1).uniform(-60.0, 60.0, 30)


def shown(effect: str, shape: dict[str, Any]) -> WholeLoad | None:
    found = Found(effect, {"joint": 2}, shape, {}, 0.0, 1.0, ())
    (term,) = found.instance.realise(ROBOT).terms
    return whole_load(ROBOT, found, sp.Float(GAP) * term.factor, LOADS, ANGLES)


def test_a_gap_is_a_step_of_the_weight_and_the_load_together() -> None:
    found = shown("backlash", {"width": WIDTH})
    assert found is not None
    weigh = sp.lambdify([q(j) for j in range(1, 7)], weight_load(ROBOT, 2))
    weight = np.array([float(weigh(*row)) for row in ANGLES])
    assert np.ptp(weight) > 50.0
    np.testing.assert_allclose(found.weight, weight, rtol=1e-9)
    np.testing.assert_allclose(found.start, GAP / 2 * np.tanh(weight / WIDTH), rtol=1e-9, atol=1e-15)
    whole, along = found.curve
    assert whole[0] == pytest.approx((weight + LOADS).min())
    np.testing.assert_allclose(along, GAP / 2 * np.tanh(whole / WIDTH), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    ("effect", "shape"),
    [
        ("backlash", {"width": WIDTH, "weights": 0.0}),
        ("hysteresis", {"width": WIDTH}),
        ("joint_compliance", {}),
    ],
)
def test_a_law_that_takes_the_load_as_it_comes_is_shown_against_that(
    effect: str, shape: dict[str, Any]
) -> None:
    assert shown(effect, shape) is None
