"""What a plan's score stands for, and what a map of the workspace shows."""

from __future__ import annotations

import numpy as np
import pytest
from planning_chain import ChainObservation

from symstiff.calibration.planning import (
    Geometry,
    Goal,
    Load,
    Plan,
    Region,
    Search,
    Space,
    above_floor,
    plan_poses,
    workspace_map,
)
from symstiff.calibration.planning.frames import origins
from symstiff.report.figures import draw_map

ARM = ChainObservation(
    rows=((0, 0.5, 0.1, -np.pi / 2), (0, 0, 0.6, 0), (0, 0, 0.5, 0)),
    base_z=0.0,
    tool=(0.05, 0.0, 0.02),
    terms=((1, 0, 0), (2, 0, 0), (3, 0, 0), (1, 4, 4), (3, 5, 5), (2, 5, 5)),
)
THREE = Geometry(
    "three",
    (),
    tuple((False, theta, d, a, alpha) for theta, d, a, alpha in ARM.rows),
    tuple(zip(("tx", "ty", "tz"), ARM.tool, strict=True)),
    ((-2.0, 2.0), (-2.5, 0.5), (-2.0, 2.0)),
)
DOWN = np.array([0.0, 0.0, -500.0, 0.0, 0.0, 0.0])


def planned(goal: Goal) -> Plan:
    search = Search(candidates=300, starts=2, refine=False)
    return plan_poses(Space(THREE, Load("force", 500.0)), ARM, ARM.names, goal, search=search)


def test_the_score_of_a_plan_for_parameters_is_minus_their_mean_variance_in_units_of_the_scale():
    scale = np.array([1e-7, 3e-7, 1e-6, 1e-8, 2e-8, 5e-8])
    plan = planned(Goal(5, "A", scale))
    assert plan.score == pytest.approx(-float(np.mean((plan.std / scale) ** 2)), rel=1e-9)


def test_the_expected_error_is_the_root_mean_square_of_a_whole_position():
    test_q = np.random.default_rng(2).uniform(-1.0, 0.5, (7, 3))
    test_w = np.tile(DOWN, (7, 1))
    plan = planned(Goal(5, "test", None, test_q, test_w))
    A = ARM(plan.q, plan.w)
    weights = np.array([1 / 30e-6] * 3 + [1 / 100e-6] * 3)[:, None]
    rows = (A * weights).reshape(-1, len(ARM.names))
    covariance = np.linalg.pinv(rows.T @ rows, rcond=1e-18, hermitian=True)
    at = ARM(test_q, test_w)[:, :3]
    squares = np.einsum("ncp,pq,ncq->n", at, covariance, at)  # of x, y and z together
    assert plan.expected_error == pytest.approx(float(np.sqrt(squares.mean())), rel=1e-6)


def test_a_map_is_empty_where_the_region_is_left_and_shows_newtons_a_micrometre():
    compliance = 2e-6  # m/N, straight down

    def sinks(q: np.ndarray, w: np.ndarray) -> np.ndarray:
        return np.hstack([compliance * w[:, :3], np.zeros((len(q), 3))])

    found = workspace_map(sinks, THREE, DOWN, counts=(9, 9), region=Region((), (above_floor(0.4),)))
    low = origins(THREE, found.q.reshape(-1, 3))[:, 1:, 2].min(axis=1).reshape(9, 9) < 0.4
    assert low.any()
    assert not low.all()
    np.testing.assert_array_equal(np.isnan(found.magnitude), low)
    np.testing.assert_array_equal(np.isnan(found.stiffness), low)
    assert np.nanmax(found.stiffness) == pytest.approx(1 / compliance)
    mesh = draw_map(found, "stiffness").axes[0].collections[0]
    assert float(np.ma.max(mesh.get_array())) == pytest.approx(0.5)  # N/µm
    mesh = draw_map(found).axes[0].collections[0]
    assert float(np.ma.max(mesh.get_array())) == pytest.approx(1.0)  # mm
