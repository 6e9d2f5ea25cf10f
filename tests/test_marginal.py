"""The evidence of a group of columns against dense linear algebra, and the laws without a name it is weighed with."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.arrays import Array
from symstiff.calibration.fits.decomposition import column_space
from symstiff.calibration.simulation import Effect, Truth, clean_response, nominal_truth
from symstiff.calibration.tables.measurements import measurements
from symstiff.discrepancy.bridge.assemble import Assembly, assemble
from symstiff.discrepancy.laws.unnamed import unnamed_laws
from symstiff.discrepancy.noise.scales import start
from symstiff.discrepancy.noise.sharing import Split
from symstiff.discrepancy.problem import Candidate, Parameter
from symstiff.discrepancy.statistics.bank import build
from symstiff.discrepancy.statistics.design import effective_rank
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.marginal import EXPECTED, log_bayes, of_ranks, of_sizes
from symstiff.discrepancy.statistics.null import null, simulated_scores
from symstiff.discrepancy.statistics.scan import extend, open_scan
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.robot import load
from tests.test_discrepancy_engine import arm


def by_covariance(y: Array, Q: Array, variance: Array, expected: float) -> float:
    """log of p(y | effect)/p(y | none), the scale integrated under 1/σ: determinants and solves of (M, M)."""
    V = np.eye(len(y)) + Q @ np.diag(expected * variance) @ Q.T
    return -0.5 * np.linalg.slogdet(V)[1] - 0.5 * len(y) * float(np.log(y @ np.linalg.solve(V, y) / (y @ y)))


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 6), st.integers(0, 10_000))
def test_the_evidence_of_usual_sizes_is_that_of_a_normal_prior_with_their_covariance(
    k: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    M = 30
    Q = np.linalg.qr(rng.normal(size=(M, k)))[0]
    variance = rng.dirichlet(np.ones(k))
    y = rng.normal(size=M) + 3.0 * Q @ rng.normal(size=k)
    shares = ((Q.T @ y) ** 2 / (y @ y))[:, None]
    found = float(of_sizes(shares, variance, np.array([0]), M)[0, 0])
    dense = [by_covariance(y, Q, variance, e) for e in EXPECTED]
    assert found == pytest.approx(
        float(np.logaddexp.reduce(dense)) - np.log(len(EXPECTED)), rel=1e-9, abs=1e-9
    )


@given(st.integers(1, 8), st.floats(0.0, 0.9))
def test_with_equal_sizes_both_beliefs_agree(k: int, share: float) -> None:
    shares = np.full((k, 1), share / k)
    sized = of_sizes(shares, np.full(k, 1.0 / k), np.array([0]), 50)[0, 0]
    flat = log_bayes(np.array(share), np.array(1.0), np.array(float(k)), 50)
    assert sized == pytest.approx(float(flat), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("precision", "error"), [(np.float64, 1e-3), (np.float32, 2e-3)])
def test_the_evidence_of_many_shares_is_read_from_tables(precision: type, error: float) -> None:
    rng = np.random.default_rng(2)
    share = np.concatenate(
        [rng.beta(0.5, 60.0, (40, 150)), rng.uniform(0.0, 0.999, (40, 150)), np.ones((1, 150))]
    )
    rank = rng.integers(0, 7, len(share)).astype(float)
    read = of_ranks(share.astype(precision), rank, 600)
    exact = log_bayes(share, np.ones_like(share), rank[:, None], 600)
    assert np.any(rank == 0)
    np.testing.assert_array_equal(np.isfinite(read), np.isfinite(exact))
    finite = np.isfinite(exact) & (share < 1.0)
    np.testing.assert_allclose(read[finite], exact[finite], atol=error, rtol=1e-5)


def test_simulated_residuals_have_the_scores_of_data_that_read_like_them() -> None:
    """Draws are scored in single precision and from tables, data are not."""
    problem = arm().problem
    rng = np.random.default_rng(11)
    given_data = replace(problem, sigma=np.full(problem.rows, 1e-4))
    bank = build(given_data, arm().candidates, unnamed_laws(given_data))
    noise = start(given_data, Split())
    scan = open_scan(bank, noise, given_data.y, given_data.A)
    errors = rng.normal(size=(problem.rows, 3)) + 0.4 * bank.columns[:, [3]] * np.sqrt(problem.rows)
    found = simulated_scores(scan, np.tile(errors, 50))
    for k in range(3):
        data = open_scan(bank, noise, noise.spread * errors[:, k], given_data.A)
        assert found[:, k] == pytest.approx(evidence(data).score, abs=5e-3)


def test_a_block_whose_usual_sizes_lie_in_one_direction_is_seen_like_one_parameter() -> None:
    problem = arm().problem
    rng = np.random.default_rng(3)
    block = rng.normal(size=(problem.rows, 6))
    parameters = tuple(Parameter(f"k{i}", typical=1.0 if i == 0 else 1e-3) for i in range(6))
    known = Candidate("block", {"link": 1}, parameters, lambda shape: block)
    unknown = replace(known, parameters=tuple(replace(p, typical=0.0) for p in parameters))
    basis = column_space(problem.A)
    usual, odd = (
        column[:, None] - basis @ (basis.T @ column[:, None]) for column in (block[:, 0], block[:, 3])
    )

    def scored(candidate: Candidate, signal: Array, seed: int) -> tuple[float, float]:
        noise = np.random.default_rng(seed).normal(size=problem.rows)
        y = problem.y + 7.0 * signal[:, 0] / np.linalg.norm(signal) + noise
        given_data = replace(problem, y=y, sigma=np.ones(problem.rows))
        scan = open_scan(build(given_data, [candidate], ()), start(given_data, Split()), y, problem.A)
        return float(evidence(scan).candidate[0]), effective_rank(scan, 0)

    gain = [scored(known, usual, s)[0] - scored(unknown, usual, s)[0] for s in range(20)]
    cost = [scored(known, odd, s)[0] - scored(unknown, odd, s)[0] for s in range(20)]
    assert np.mean(gain) > 2.0  # five directions fewer to pay for
    assert np.median(cost) == pytest.approx(
        -np.log(2.0), abs=0.3
    )  # unusual sizes are seen, at half the belief
    assert scored(known, usual, 0)[1] < 1.1
    assert 4.0 < scored(unknown, usual, 0)[1] <= 6.0


def of_hidden(effect: Effect, robot_name: str = "ur10", *known: str) -> tuple[Assembly, Array]:
    """A noise-free experiment on a robot with masses, and what a hidden effect adds to its rows.

    The assembly has the candidates of the ``known`` effects.
    """
    robot = load(robot_name)
    rng = np.random.default_rng(5)
    poses, steps = 20, (0.4, 0.7, 1.0, 0.7, 0.4)
    limits = np.array([j.range for j in robot.joint])
    q = np.repeat(rng.uniform(limits[:, 0], limits[:, 1], (poses, robot.dof)), len(steps), axis=0)
    wrench = np.repeat(rng.normal(size=(poses, 6)) * [60, 60, 60, 8, 8, 8], len(steps), axis=0)
    wrench *= np.tile(steps, poses)[:, None]
    pose = np.repeat(np.arange(poses), len(steps))
    branch = np.tile([1.0, 1.0, 1.0, -1.0, -1.0], poses)
    table = measurements(q, wrench, pose=pose, kind="deflection", branch=branch)
    values = {n: v * 1e-3 for n, v in nominal_truth(robot).items()}  # stiff: no second-order geometry
    context = {"kind": table.kind, **{n: getattr(table, n) for n in (
        "points", "point", "labels", "pose", "time", "temperature", "branch")}}  # fmt: skip
    without = clean_response(Truth(robot, values, ()), q, wrench, context)
    signal = clean_response(Truth(robot, values, (effect,)), q, wrench, context) - without
    without[:, 3:], signal[:, 3:] = np.nan, np.nan
    model = StiffnessModel.of(reduce(robot, "wrench"))
    assembly = assemble(model, replace(table, values=without), [find(name) for name in known])
    view = assembly.situation.view
    return assembly, signal[view.state, view.component]


@pytest.mark.parametrize(
    ("effect", "law"),
    [
        (Effect("load_product", {"joints": [2, 3]}, "product", {"c": 1e-9}), "tau*tau3"),
        (Effect("load_product", {"joints": [2, 3]}, "magnitude", {"c": 1e-9}), "tau*|tau3|"),
        (Effect("force_sensor_gain", None, "axes", {"gain": [0.01, 0, 0, 0, 0, 0]}), "gain"),
        (Effect("device_scale", None, "axes", {"scale": [0.0, 0.01, 0.0]}), "gain"),
    ],
)  # fmt: skip
def test_what_the_catalogue_lacks_is_described_by_a_law_without_a_name(effect: Effect, law: str) -> None:
    assembly, signal = of_hidden(effect)
    problem = assembly.problem
    basis = column_space(problem.A)
    signal = signal - basis @ (basis.T @ signal)
    left = {}
    for candidate in unnamed_laws(problem):
        block = candidate.columns({})
        own = column_space(block - basis @ (basis.T @ block), 1e-7)
        share = float(np.sum((signal - own @ (own.T @ signal)) ** 2) / (signal @ signal))
        if share < 1e-3:  # wider laws may hold it too
            left[candidate.where["law"]] = (own.shape[1], share)
    assert min(left, key=lambda key: left[key]) == law


def test_a_law_of_a_link_that_turns_about_a_joints_axis_has_the_joints_place() -> None:
    assembly, _ = of_hidden(Effect("device_scale", None, "axes", {"scale": [0.0, 0.01, 0.0]}), "kuka_kr270")
    bank = build(assembly.problem, (), unnamed_laws(assembly.problem))
    places = {
        str(c.where["at"]): place
        for c, place in zip(bank.candidates, bank.place, strict=True)
        if c.where["law"] == "tau*|tau|"
    }
    assert {at: p for at, p in places.items() if at.startswith("link") and p} != {}
    assert all(places[f"joint {j}"] == f"joint {j}" for j in range(1, 7))
    crossed = [
        p
        for c, p in zip(bank.candidates, bank.place, strict=True)
        if re.search(r"tau\d", str(c.where["law"]))
    ]
    assert crossed
    assert not any(crossed)


def test_a_soft_spot_is_one_law_that_averages_over_where_it_is() -> None:
    assembly, _ = of_hidden(Effect("device_scale", None, "axes", {"scale": [0.0, 0.01, 0.0]}))
    spots = [c for c in unnamed_laws(assembly.problem) if c.where["law"] == "tau near one q2"]
    assert [c.where["at"] for c in spots] == ["joint 2"]
    assert len(spots[0].shapes) > 3
    for shape in spots[0].shapes:
        assert spots[0].columns(shape).shape == (assembly.problem.rows, 1)
        assert spots[0].parameters_at(shape)[0].name.startswith("tau*exp(-((q2")


def test_a_column_of_rounding_is_no_direction_of_a_block() -> None:
    problem = arm().problem
    rng = np.random.default_rng(8)
    block = rng.normal(size=(problem.rows, 3)) * [1.0, 1.0, 1e-15]
    parameters = tuple(Parameter(f"k{i}", typical=1.0) for i in range(3))
    bank = build(problem, [Candidate("block", {"link": 1}, parameters, lambda shape: block)], ())
    scan = open_scan(bank, start(problem, Split()), problem.y, problem.A)
    assert scan.best.bases.rank[0] == 2
    assert not np.any(bank.columns[:, 2])
    assert np.all(np.isfinite(null(scan, 200, 0).named))


def test_the_evidence_beside_a_set_is_that_of_the_scan_that_holds_it() -> None:
    problem = arm().problem
    rng = np.random.default_rng(4)
    given_data = replace(
        problem, y=problem.y + 1e-4 * rng.normal(size=problem.rows), sigma=np.full(problem.rows, 1e-4)
    )
    wide = rng.normal(size=(problem.rows, 5))
    wide[:, 4] = wide[:, 0] + wide[:, 1]
    block = Candidate(
        "block", {"link": 1}, tuple(Parameter(f"k{i}", typical=0.5**i) for i in range(5)), lambda s: wide
    )
    bank = build(given_data, [*arm().candidates, block], unnamed_laws(given_data))
    scan = open_scan(bank, start(given_data, Split()), given_data.y, given_data.A)
    for entries in ((0,), (1, 5), (len(arm().candidates) + 2, 2)):
        A = np.hstack([problem.A, *(bank.columns[:, bank.slice(e)] for e in entries)])
        quick, whole = (
            extend(scan, entries),
            open_scan(bank, start(given_data, Split()), given_data.y, A),
        )
        assert [la.rss for la in quick.layers] == pytest.approx([la.rss for la in whole.layers], rel=1e-9)
        away = ~np.isin(bank.owner, bank.owner[list(entries)])
        assert np.count_nonzero(away) > 0.8 * len(away)
        np.testing.assert_array_equal(quick.best.bases.rank[away], whole.best.bases.rank[away])
        assert evidence(quick).entry[away] == pytest.approx(evidence(whole).entry[away], abs=1e-6)


def test_hysteresis_follows_the_total_load_where_the_robot_has_masses() -> None:
    hidden = Effect("hysteresis", {"joint": 2}, "constant", {"width": 1e-4, "knee": 2.0})
    assembly, signal = of_hidden(hidden, "ur10", "hysteresis")
    problem = assembly.problem
    basis = column_space(problem.A)
    signal = signal - basis @ (basis.T @ signal)
    candidate = next(c for c in assembly.candidates if c.where == {"joint": 2})
    left = {0.0: 1.0, 1.0: 1.0}
    for shape in candidate.shapes:
        block = candidate.columns(shape)
        own = column_space(block - basis @ (basis.T @ block), 1e-7)
        rest = signal - own @ (own.T @ signal)
        reading = float(shape.get("weights", 0.0))
        left[reading] = min(left[reading], float(rest @ rest / (signal @ signal)))
    assert left[1.0] < 0.05
    assert left[0.0] > 0.2
    without_masses, _ = of_hidden(hidden, "kuka_kr270", "hysteresis")
    assert {s.get("weights") for c in without_masses.candidates for s in c.shapes} == {None}
