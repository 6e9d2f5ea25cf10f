"""Complete link matrices from a reduced set: same predictions, admissible, nearest, with honest bounds."""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.optimize
from hypothesis import example, given, settings
from hypothesis import strategies as st

from symstiff.calibration.complete import reconstruct_model
from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import nominal_truth
from symstiff.calibration.tables.measurements import measurements
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction.admissible import BEAM_RATIO, admissible_set, link_matrices, scales
from symstiff.reduction.complete import complete_map
from symstiff.reduction.conic import cone_vector, dual_matrix
from symstiff.reduction.nearest import Relation, cantilever_relations
from symstiff.reduction.reconstruction import reconstruct
from symstiff.reduction.reduce import reduce
from symstiff.robot import load
from tests.small_chain import names, observation, reduction, sample, truth

NAMES = names()
TRUE = truth(NAMES)
NOMINAL = dict(zip(NAMES, truth(NAMES, seed=1), strict=True))
CLASSES = {gravity: reduction(NAMES, np.abs(TRUE), gravity) for gravity in (False, True)}


@pytest.mark.parametrize(("gravity", "rank"), [(False, 32), (True, 26)])
@pytest.mark.parametrize("metric", ["relative", "logdet"])
def test_the_complete_set_is_admissible_and_predicts_what_the_reduced_one_did(gravity, rank, metric):
    P, kept = CLASSES[gravity]
    assert len(kept) == rank
    found = reconstruct(P, P @ TRUE, NAMES, NOMINAL, metric=metric, bounds=False)
    assert found.admissible
    assert found.distance == 0.0
    q, w = sample(30, 3, gravity)
    expected = observation(q, w, [NAMES[i] for i in kept]) @ (P @ TRUE)
    predicted = observation(q, w, NAMES) @ found.values
    np.testing.assert_allclose(predicted, expected, atol=1e-12 * np.max(np.abs(expected)))
    for K in found.links.values():
        np.testing.assert_array_equal(K, K.T)
        assert np.linalg.eigvalsh(K / np.sqrt(np.outer(np.diag(K), np.diag(K))))[0] > 0
    assert min(found.joints.values()) > 0


@pytest.mark.parametrize("metric", ["relative", "logdet"])
def test_a_nominal_model_that_fits_already_is_returned_as_it_is(metric):
    P, _ = CLASSES[True]
    own = dict(zip(NAMES, TRUE, strict=True))
    found = reconstruct(P, P @ TRUE, NAMES, own, metric=metric, bounds=False)
    np.testing.assert_allclose(found.values, TRUE, rtol=1e-6, atol=1e-6 * np.min(np.abs(TRUE)))
    assert found.metric_value == pytest.approx(0.0, abs=1e-9)


def small_problem(kept=None):
    """Two coupled links and a joint with a two-row mapping."""
    few = ["k1_22", "k1_66", "k1_26", "c2", "k2_66"]
    P = np.array([[1.0, 0.5, 2.0, 0.0, 0.0], [0.0, 1.0, 0.0, 1.0, 1.0]])
    return few, P, np.array([3.0, 4.0])


def test_the_nearest_set_in_the_relative_metric_agrees_with_a_general_solver():
    few, P, reduced = small_problem()
    nominal = dict(zip(few, [1.0, 2.0, 0.9, 0.5, 0.1], strict=True))
    found = reconstruct(P, reduced, few, nominal, bounds=False, margin=0.0)
    size = scales(few, nominal)

    def cost(v):
        return float(np.sum(((v - list(nominal.values())) / size) ** 2))

    conditions = [
        {"type": "eq", "fun": lambda v: P @ v - reduced},
        {"type": "ineq", "fun": lambda v: [v[0] * v[1] - v[2] ** 2, *v[[0, 1, 3, 4]]]},
    ]
    best = scipy.optimize.minimize(cost, [1.0, 1, 0.75, 1.5, 1.5], constraints=conditions, tol=1e-14)
    np.testing.assert_allclose(found.values, best.x, atol=1e-5)
    assert found.metric_value == pytest.approx(best.fun, abs=1e-7)


def test_the_nearest_set_in_the_logdet_metric_agrees_with_a_general_solver_in_any_units():
    few, P, reduced = small_problem()
    nominal = dict(zip(few, [1.0, 2.0, 0.9, 0.5, 0.1], strict=True))
    K0 = np.array([[1.0, 0.9], [0.9, 2.0]])

    def cost(v):
        K = np.array([[v[0], v[2]], [v[2], v[1]]])
        if min(v[3], v[4], np.linalg.eigvalsh(K)[0]) <= 0:
            return 1e6
        X = K @ np.linalg.inv(K0)
        scalars = np.array([v[3] / 0.5, v[4] / 0.1])
        return np.trace(X) - np.log(np.linalg.det(X)) - 2 + np.sum(scalars - np.log(scalars) - 1)

    N = np.linalg.svd(P)[2][2:].T
    start = np.array([2.0, 1.0, 0.25, 2.0, 1.0])
    start += np.linalg.lstsq(P, reduced - P @ start, rcond=None)[0]
    options = {"xatol": 1e-10, "fatol": 1e-14, "maxiter": 5000, "maxfev": 5000}
    best = scipy.optimize.minimize(
        lambda z: cost(start + N @ z), np.zeros(3), method="Nelder-Mead", options=options
    )
    found = reconstruct(P, reduced, few, nominal, metric="logdet", bounds=False)
    np.testing.assert_allclose(found.values, start + N @ best.x, atol=1e-5)
    assert found.metric_value == pytest.approx(best.fun, abs=1e-9)
    unit = np.array([1e-6, 1e-2, 1e-4, 1e-2, 1e-2])  # translations and rotations in other units
    other = dict(zip(few, unit * list(nominal.values()), strict=True))
    again = reconstruct(P / unit, reduced, few, other, metric="logdet", bounds=False)
    np.testing.assert_allclose(again.values / unit, found.values, rtol=1e-6)


def test_bounds_contain_the_truth_and_are_reached_by_no_sampled_admissible_set():
    P, _ = CLASSES[True]
    bounds = reconstruct(P, P @ TRUE, NAMES, NOMINAL).bounds
    assert bounds is not None
    assert not np.isnan(bounds.lower).any()
    assert not np.isnan(bounds.upper).any()
    slack = 1e-7 * bounds.scale
    assert np.all(bounds.lower - slack <= TRUE)
    assert np.all(bounds.upper + slack >= TRUE)
    assert bounds.pinned == ("k0_35",)
    # c1 and the springs along which a vertical load never works have no column at all.
    silent = {n for n, column in zip(NAMES, P.T, strict=True) if not column.any()}
    assert {"c1", "k0_11", "k1_33"} <= silent <= set(bounds.unbounded)
    rng, rules = np.random.default_rng(0), admissible_set(NAMES)
    null = np.linalg.svd(P * np.abs(TRUE))[2][len(P) :].T
    inside = 0
    for _ in range(1500):
        other = TRUE + np.abs(TRUE) * (null @ rng.normal(size=null.shape[1])) * rng.uniform(0, 0.3)
        if min(rules.smallest(other, bounds.scale).values()) >= 0:
            inside += 1
            assert np.all((bounds.lower - slack <= other) & (other <= bounds.upper + slack))
    assert inside > 20


def test_bounds_of_a_small_problem_are_those_of_pencil_and_paper():
    found = reconstruct(
        np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.array([2.0, 0.5]), ["k1_22", "k1_66", "k1_26"], {}
    ).bounds
    # k22 + k66 = 2 and k22·k66 ≥ 1/4
    root = np.sqrt(1 - 0.25)
    assert found is not None
    np.testing.assert_allclose(found.lower, [1 - root, 1 - root, 0.5], rtol=1e-6)
    np.testing.assert_allclose(found.upper, [1 + root, 1 + root, 0.5], rtol=1e-6)
    assert found.pinned == ("k1_26",)


def test_bounds_are_in_order_and_no_diagonal_term_is_negative_by_rounding():
    names, rng = ["k1_22", "k1_66", "k1_26", "c1"], np.random.default_rng(0)
    for share in (0.0, *rng.uniform(-0.8, 0.8, 12)):
        k22, k66 = rng.uniform(1e-8, 9e-8, 2)
        full = np.array([k22, k66, share * np.sqrt(k22 * k66), 0.0])
        for P in (np.eye(4), np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])):
            bounds = reconstruct(P, P @ full, names, {}).bounds
            assert bounds is not None
            assert np.all(bounds.lower <= bounds.upper)
            assert np.all(bounds.lower[[0, 1, 3]] >= 0.0)
            np.testing.assert_array_less(bounds.lower - 1e-7 * bounds.scale, full)
            np.testing.assert_array_less(full, bounds.upper + 1e-7 * bounds.scale)


def test_a_full_link_matrix_is_held_positive_definite():
    pairs = [(a, b) for a in range(1, 7) for b in range(a, 7)]
    full = [f"k1_{a}{b}" for a, b in pairs]
    rng = np.random.default_rng(1)
    half = rng.normal(size=(6, 6))
    K = half @ half.T
    values = np.array([K[a - 1, b - 1] for a, b in pairs])
    P = rng.normal(size=(9, 21))
    nominal = {f"k1_{a}{a}": 3.0 for a in range(1, 7)}
    for metric in ("relative", "logdet"):
        found = reconstruct(P, P @ values, full, nominal, metric=metric, bounds=False)
        assert found.admissible
        np.testing.assert_allclose(P @ found.values, P @ values, atol=1e-12)
        assert np.linalg.eigvalsh(found.links[1])[0] > 0
        K0 = 3 * np.eye(6)
        truth_cost = np.trace(K @ np.linalg.inv(K0)) - np.linalg.slogdet(K @ np.linalg.inv(K0))[1] - 6
        if metric == "logdet":
            assert found.metric_value < truth_cost


def test_noise_beyond_physics_is_said_so_with_its_distance_in_standard_deviations():
    few = ["k1_66", "c2"]
    P, covariance = np.array([[1.0, 1.0]]), np.array([[0.25]])
    found = reconstruct(
        P, np.array([-1.0]), few, {"k1_66": 1.0, "c2": 1.0}, covariance=covariance, margin=1e-6
    )
    assert not found.admissible
    assert found.distance == pytest.approx(2.0, rel=1e-4)
    assert found.shifts == pytest.approx([2.0], rel=1e-4)
    assert np.all(found.values >= 0)
    assert "2 standard deviations" in str(found)
    json.dumps(found.to_dict(), allow_nan=False)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
@example(89434)  # long steps end near the boundary
def test_the_nearest_admissible_reduced_set_satisfies_the_projection_inequality(seed):
    rng = np.random.default_rng(seed)
    few, P, _ = small_problem()
    half = rng.normal(size=(2, 2))
    covariance, reduced = half @ half.T + 0.1 * np.eye(2), rng.normal(size=2) - 1.0
    found = reconstruct(
        P, reduced, few, dict.fromkeys(few, 1.0), covariance=covariance, bounds=False, margin=1e-7
    )
    np.testing.assert_allclose(P @ found.values, found.reduced)
    assert min(found.smallest.values()) > -1e-7
    gap = np.linalg.solve(covariance, found.reduced - reduced)
    for _ in range(50):
        a, b, scalars = rng.normal(size=2), rng.normal(size=2), rng.exponential(size=2)
        K = np.outer(a, a) + np.outer(b, b) * rng.uniform()
        other = P @ [K[0, 0], K[1, 1], K[0, 1], *scalars]
        assert gap @ (other - found.reduced) > -1e-3 * (1 + np.linalg.norm(gap) * np.linalg.norm(other))
    length = np.sqrt((found.reduced - reduced) @ gap)
    assert found.distance == pytest.approx(length, rel=1e-6, abs=1e-9)


def test_noisy_identification_of_an_admissible_robot_stays_within_its_own_noise():
    P, kept = CLASSES[False]
    q, w = sample(30, 5)
    A = observation(q, w, [NAMES[i] for i in kept]) / np.tile([20e-6] * 3 + [10e-6] * 3, 30)[:, None]
    size = np.linalg.norm(A, axis=0)
    root = np.linalg.inv(np.linalg.qr(A / size, mode="r")) / size[:, None]
    noisy = P @ TRUE + root @ np.random.default_rng(6).normal(size=len(kept))
    found = reconstruct(P, noisy, NAMES, NOMINAL, covariance=root @ root.T)
    assert found.distance < np.sqrt(len(kept)) + 3
    assert min(found.smallest.values()) > 0


@pytest.mark.parametrize("variance", [0.0, np.nan, np.inf])
def test_a_covariance_that_tells_no_distance_is_refused_where_one_is_asked_for(variance):
    pair, P, given = (
        ["c1", "c2"],
        np.array([[1.0, 1.0]]),
        {"covariance": np.array([[variance]]), "bounds": False},
    )
    assert reconstruct(P, np.array([1e-6]), pair, {}, **given).distance == 0.0
    with pytest.raises(UserError, match="not positive definite"):
        reconstruct(P, np.array([-1e-6]), pair, {}, **given)


def test_as_many_readings_as_parameters_without_sigma_are_rebuilt_in_nominal_sizes():
    rng, q = np.random.default_rng(0), np.array([[0.3, -0.5], [-0.9, 0.2], [0.7, 0.8]])
    values = np.full((3, 6), np.nan)
    values[:, 2] = rng.normal(scale=1e-3, size=3)
    table = measurements(q, [0, 0, -100.0, 0, 0, 0], kind="deflection", values=values)
    result = identify(load("planar2r"), table)
    assert result.fit.dof == 0
    found = reconstruct_model(result, bounds=False)
    assert not found.admissible
    assert np.isnan(found.distance)
    assert min(found.smallest.values()) > -1e-7
    json.dumps(found.to_dict(), allow_nan=False)


@pytest.mark.parametrize(("deflects", "turns"), [(2, 6), (3, 5)])
def test_the_beam_ratio_holds_every_pair_to_the_cantilever_and_no_more(deflects, turns):
    few = [f"k1_{deflects}{deflects}", f"k1_{turns}{turns}", f"k1_{deflects}{turns}"]
    P, reduced = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.array([1.0, 0.5])
    for ratio in (1.0, BEAM_RATIO):
        rules = admissible_set(few, beam_ratio=ratio)
        found = reconstruct(P, reduced, few, {}, admissible=rules).bounds
        assert found is not None
        assert found.lower[0] == pytest.approx(0.25 * ratio, rel=1e-6)
    with pytest.raises(UserError, match="beam ratio"):
        admissible_set(few, beam_ratio=0.5)


def test_soft_beam_relations_draw_a_link_to_a_cantilever_of_its_length():
    few = [f"k1_{ab}" for ab in ("22", "66", "26", "33", "55", "35")]
    length, bend = 0.8, 1e-7
    tip = {
        "k1_66": bend,
        "k1_55": bend,
        "k1_26": length / 2 * bend,
        "k1_35": -length / 2 * bend,
        "k1_22": length**2 / 3 * bend,
        "k1_33": length**2 / 3 * bend,
    }
    P = np.eye(6)[[1, 4]]
    nominal = dict.fromkeys(("k1_22", "k1_33"), 3e-8) | dict.fromkeys(("k1_66", "k1_55"), 1e-7)
    soft = cantilever_relations(1, length, weight=1e3)
    found = reconstruct(P, np.array([bend, bend]), few, nominal, relations=soft, bounds=False)
    np.testing.assert_allclose(found.values, [tip[n] for n in few], rtol=1e-4)
    with pytest.raises(UserError, match="k9_11"):
        reconstruct(P, np.array([bend, bend]), few, nominal, relations=[Relation({"k9_11": 1.0})])


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 6), st.integers(0, 10**6))
def test_the_solvers_vectors_keep_inner_products_of_matrices(size, seed):
    rng = np.random.default_rng(seed)
    K, dual = rng.normal(size=(size, size)), rng.normal(size=len(cone_vector(np.eye(size))))
    K = K + K.T
    block = admissible_set([f"k1_{a}{b}" for a in range(1, size + 1) for b in range(a, size + 1)]).blocks[0]
    assert np.sum(dual_matrix(block, dual) * K) == pytest.approx(float(dual @ cone_vector(K)))


def test_blocks_follow_the_template_and_odd_sets_are_refused():
    labels = [
        block.label for block in admissible_set([*names(range(1)), "gain"], nonnegative=["gain"]).blocks
    ]
    assert labels[:3] == ["link 0 (k0_11)", "link 0 (k0_22, k0_26, k0_66)", "link 0 (k0_33, k0_35, k0_55)"]
    assert labels[-2:] == ["joint 6 (c6)", "gain"]
    with pytest.raises(UserError, match="k1_26 has no k1_22"):
        admissible_set(["k1_26", "k1_66"])
    assert link_matrices(["k3_35"], np.array([2.0]))[3][4, 2] == 2.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"P": np.ones((2, 3))}, "does not fit"),
        ({"P": np.ones((2, 5))}, "rank below 2"),
        ({"reduced": np.array([1.0, np.nan])}, "not finite"),
        ({"covariance": np.eye(3)}, "covariance of shape"),
        ({"metric": "euclid"}, "give one of relative, logdet"),
        ({"metric": "logdet", "relations": cantilever_relations(1, 0.5)}, "relations have no weight"),
    ],
)
def test_mappings_that_do_not_fit_are_refused_with_the_reason(change, words):
    few, P, reduced = small_problem()
    with pytest.raises(UserError, match=words):
        reconstruct(**({"P": P, "reduced": reduced, "names": few, "nominal": {}} | change))


def test_an_identified_model_is_rebuilt_in_the_metric_and_by_the_relations_asked_for():
    robot, q = load("planar2r"), np.random.default_rng(3).uniform(-1.0, 1.0, (9, 2))
    small, nominal = reduce(robot, "gravity", "position"), nominal_truth(robot)
    true = complete_map(small) @ [nominal.get(name, 0.0) for name in small.stages[2].names]
    model = StiffnessModel.of(small, dict(zip(small.parameters, true.tolist(), strict=True)))
    wrench = np.array([0, 0, -100.0, 0, 0, 0])
    values = model.deflection(q, np.tile(wrench, (9, 1)))
    values[:, 3:] = np.nan
    result = identify(robot, measurements(q, wrench, kind="deflection", values=values, sigma=1e-6))
    drawn = cantilever_relations(1, 0.1, weight=1e3)
    plain, burg, beam = (
        reconstruct_model(result, bounds=False, **options)
        for options in ({}, {"metric": "logdet"}, {"relations": drawn})
    )
    assert burg.metric.startswith("logdet")
    at = {n: k for k, n in enumerate(plain.names)}

    def off(found):
        return abs(found.values[at["k1_26"]] / found.values[at["k1_66"]] - 0.05)

    assert off(beam) < 0.1 * off(plain)


def test_the_seeds_robot_is_rebuilt_from_its_26_parameters_and_only_its_group_one_is_pinned():
    reduction_ = reduce(load("kuka_kr270"), loads="gravity", measure="pose")
    complete = reduction_.stages[2].names  # after M2: joints and links apart
    P = reduction_.projection @ reduction_.stages[3].matrix.T
    values = truth(list(complete))
    nominal = dict(zip(complete, truth(list(complete), seed=1), strict=True))
    found = reconstruct(P, P @ values, complete, nominal, reduced_names=reduction_.parameters)
    assert P.shape == (26, 62)
    assert found.admissible
    np.testing.assert_allclose(found.reduced, P @ values, rtol=1e-10)
    assert found.bounds is not None
    assert set(found.bounds.pinned) == set(reduction_.partition.g1)
    assert set(reduction_.partition.g2) <= set(found.bounds.unbounded)
