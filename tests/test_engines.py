"""Both engines of M4 and M5, on the library's robots, on odd robots, with joints that stand still."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from definition import observation, samples
from numerics import assert_couplings_hold, columns, rank, raw_columns, scaled

from symstiff.errors import UserError
from symstiff.reduction import Reduction, reduce
from symstiff.reduction.physical import physical_stages, terms_of
from symstiff.reduction.prime import PRIMES, PrimeAlgebra, echelon, rational
from symstiff.reduction.reduce import preference
from symstiff.reduction.structural import LOADS, MEASURES, ExactEngine, Experiment, Partition
from symstiff.reduction.svd import NumericRank, numeric_partition, numeric_rank
from symstiff.robot import Robot, from_table, library, load, parse_exact
from symstiff.robot.table import to_table
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.programs import observation_program

KR270 = load("kuka_kr270")

# --- functions that no field knows -----------------------------------------------------------------------


@pytest.mark.parametrize(("function", "sign"), [("tanh", -1), ("sign", -1), ("Abs", 1), ("cos", 1)])
def test_an_oracle_has_its_functions_symmetry_and_value_at_zero(function: str, sign: int) -> None:
    algebra, p = PrimeAlgebra(PRIMES[0]), PRIMES[0]
    x = np.random.default_rng(1).integers(1, p, 50)
    values, mirrored = algebra.call(function, [x]), algebra.call(function, [p - x])
    assert np.array_equal(mirrored, sign * values % p)
    assert len(set(values.tolist())) == 50
    assert algebra.call(function, [0]) == {"cos": 1}.get(function, 0)
    assert algebra.call(function, [int(x[0])]) == values[0]


# --- agreement -------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", library())
def test_exact_and_numeric_engine_agree_on_random_configurations(name: str) -> None:
    robot = load(name)
    chain, full = ElasticChain(robot), physical_stages(robot)[-1].parameters
    names, order = tuple(p.name for p in full), preference(ElasticChain(robot), full)
    program = observation_program(chain, terms_of(full), names)
    for loads in LOADS:
        q, w = samples(robot, 20, 1, loads)
        pose = observation(robot, q, w, names)
        for measure in MEASURES:
            A = pose.reshape(20, 6, -1)[:, MEASURES[measure]].reshape(-1, len(names))
            exact = ExactEngine(chain, program, names, Experiment(loads, measure)).partition(order)
            assert_same(*numeric_partition(A, names, order), exact)


def assert_same(found: Partition, decision: NumericRank, exact: Partition) -> None:
    assert decision.rank == exact.rank
    assert decision.gap > 1e6
    assert (found.g1, found.g2, found.g3) == (exact.g1, exact.g2, exact.g3)
    assert found.kept == exact.kept
    assert {frozenset(b) for b in found.blocks} == {frozenset(b) for b in exact.blocks}
    assert {e: set(row) for e, row in found.couplings.items()} == {
        e: set(row) for e, row in exact.couplings.items()
    }
    for e, row in exact.couplings.items():
        for k, c in row.items():
            assert found.couplings[e][k] == pytest.approx(float(c), rel=1e-6)


def engine_of(r: Reduction, seed: int) -> ExactEngine:
    chain, names = ElasticChain(r.robot), tuple(p.name for p in r.full)
    program = observation_program(chain, terms_of(r.full), names)
    return ExactEngine(chain, program, names, r.experiment, seed)


@pytest.mark.parametrize("name", ["kuka_kr270", "scara", "franka_panda"])
def test_neither_the_seed_nor_the_primes_change_the_result(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    r = reduce(load(name), "gravity", "pose")
    order = preference(ElasticChain(r.robot), r.full)
    for seed in (2, 3, 12345):
        assert engine_of(r, seed).partition(order) == r.partition
    monkeypatch.setattr("symstiff.reduction.structural.PRIMES", PRIMES[::-1])
    assert engine_of(r, 1).partition(order) == r.partition


@pytest.mark.parametrize("primes", [(103, 11, *PRIMES[:6]), (PRIMES[0], 7, *PRIMES[1:6])])
def test_a_prime_that_loses_rank_is_left_out(
    primes: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a field of 7, 11 or 103 elements columns coincide by accident; the other primes must win, first or last."""
    r = reduce(load("planar2r"))
    order = preference(ElasticChain(r.robot), r.full)
    monkeypatch.setattr("symstiff.reduction.structural.PRIMES", primes)
    assert engine_of(r, 1).partition(order) == r.partition


def test_the_numeric_rank_shows_its_gap() -> None:
    found = numeric_rank(np.array([10.0, 1.0, 1e-3, 1e-15]), 100)
    assert (found.rank, found.gap) == (3, pytest.approx(1e12))
    assert numeric_rank(np.array([2.0, 1.0]), 10).gap == float("inf")


def test_few_configurations_identify_less_than_the_class_does() -> None:
    r = reduce(KR270, "gravity", "pose")
    names, order = [p.name for p in r.full], preference(ElasticChain(KR270), r.full)
    found, decision = numeric_partition(raw_columns(r, count=3), names, order)
    assert decision.rank == len(found.kept) == rank(scaled(raw_columns(r, count=3))) < r.partition.rank


def test_the_numeric_engine_does_not_care_about_the_columns_sizes() -> None:
    r = reduce(KR270, "gravity", "pose")
    names, order, A = [p.name for p in r.full], preference(ElasticChain(KR270), r.full), raw_columns(r)
    A = np.where(np.linalg.norm(A, axis=0) > 1e-12, A, 0.0)
    size = 10.0 ** np.random.default_rng(4).uniform(-6, 6, len(names))
    one, two = numeric_partition(A, names, order)[0], numeric_partition(A * size, names, order)[0]
    assert (one.g1, one.g2, one.g3, one.kept, one.blocks) == (two.g1, two.g2, two.g3, two.kept, two.blocks)


@pytest.mark.parametrize("prime", [PRIMES[0], 101])
def test_the_echelon_form_is_reduced_and_spans_the_same_rows(prime: int) -> None:
    rng = np.random.default_rng(0)
    base = rng.integers(0, prime, (4, 9))
    matrix = rng.integers(0, prime, (12, 4)).astype(object) @ base.astype(object) % prime
    form, pivots = echelon(matrix.astype(np.int64), prime)
    assert len(form) == len(pivots) == 4
    assert np.array_equal(form[:, pivots], np.eye(4))
    rebuilt = matrix[:, pivots] @ form.astype(object) % prime
    assert np.array_equal(rebuilt, matrix)


def test_fractions_come_back_from_their_residues() -> None:
    p = PRIMES[0]
    for n, d in ((7, 20), (-529, 10000), (0, 1), (-1, 3), (30000, 30001)):
        found = rational(n * pow(d, -1, p) % p, p)
        assert found is not None
        assert (found.numerator, found.denominator) == (n, d)


# --- fixed joints, odd robots ----------------------------------------------------------------------------

FIXED = [
    ({1: 0, 4: "pi/6"}, "gravity", "pose"),
    ({2: "-pi/2", 3: 0.7}, "wrench", "position"),
    ({1: 0, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0}, "wrench", "pose"),
]


@pytest.mark.parametrize(("fixed", "loads", "measure"), FIXED)
def test_joints_that_stand_still_are_seen_at_their_angle(fixed: Any, loads: str, measure: str) -> None:
    r = reduce(KR270, loads, measure, fixed)
    assert rank(columns(r)) == r.partition.rank < reduce(KR270, loads, measure).partition.rank
    assert_couplings_hold(r)


def test_a_fixed_joint_stands_at_its_angle_with_the_offset_of_its_zero() -> None:
    """Offsets on parallel joints, of odd angles, merged and single: only the sum with the variable counts."""
    table = to_table(KR270)
    for row, theta in zip(table["joint"], ("pi/6", 0.7, "pi/3", 1, "-pi/2", 0.3), strict=True):
        row["theta"] = theta
    shifted = from_table(table)
    assert reduce(shifted, "gravity").partition == reduce(KR270, "gravity").partition
    one = reduce(shifted, "gravity", fixed={1: "-pi/6", 3: 0})
    assert one.partition == reduce(KR270, "gravity", fixed={1: 0, 3: "pi/3"}).partition
    assert rank(columns(one)) == one.partition.rank
    assert_couplings_hold(one)


def test_a_prismatic_joint_can_stand_still() -> None:
    for at in (0.1, "pi/10"):
        r = reduce(load("scara"), fixed={3: at})
        assert rank(columns(r)) == r.partition.rank
        assert_couplings_hold(r)


@pytest.mark.parametrize("fixed", [{0: 0}, {7: 0}, {1: "nan"}, {1: "__import__('os')"}])
def test_a_joint_that_is_not_there_or_an_angle_that_is_none_is_refused(fixed: Any) -> None:
    with pytest.raises(UserError):
        reduce(KR270, fixed=fixed)


@pytest.mark.parametrize(("loads", "measure"), [("weight", "pose"), ("wrench", "orientation")])
def test_an_unknown_class_is_refused(loads: str, measure: str) -> None:
    with pytest.raises(UserError, match="unknown"):
        reduce(KR270, loads, measure)


def odd_six() -> Robot:
    """Not in the library: inclined beams, a rigid tilted base, an offset and turned tool."""
    table = to_table(KR270)
    table["name"] = "odd_six"
    table["base"] = {"xyz": [0, 0, 0.5], "rpy": [0, "pi/9", 0], "link": {"template": "rigid"}}
    beams = ([0.35, 0, 0.675], [1, 0.2, 0.1], [0, 1, 1], "y", "z", [0, 0, -1])
    for row, beam in zip(table["joint"], beams, strict=True):
        row["link"]["beam_axis"] = beam
    table["tool"] = {"xyz": [0.05, 0.1, 0.3], "rpy": [0.1, 0.2, 0.3]}
    return from_table(table)


@pytest.mark.parametrize("loads", ["wrench", "gravity"])
def test_a_robot_with_inclined_beams_a_rigid_base_and_an_offset_tool_reduces(loads: str) -> None:
    r = reduce(odd_six(), loads)
    assert dict(r.counts)["M3"] == 6 * 8 + 1
    assert "c1" in [p.name for p in r.full]
    assert "c1" in r.parameters  # the tilted base lets gravity turn joint 1
    assert rank(columns(r)) == r.partition.rank
    assert_couplings_hold(r)


@pytest.mark.parametrize("alphas", [("pi/6", "pi/3"), ("pi/4", "-pi/4"), ("pi", 0.4)])
def test_twists_of_any_angle_give_the_rank_that_numbers_give(alphas: tuple[Any, Any]) -> None:
    """Where a sine is a half or equals its cosine, a careless rational stand-in would add rank."""
    table = to_table(KR270)
    table["joint"][1]["alpha"], table["joint"][3]["alpha"] = alphas
    r = reduce(from_table(table), "wrench")
    assert rank(columns(r)) == r.partition.rank
    assert_couplings_hold(r)


def test_couplings_hold_where_odd_angles_leave_no_short_fraction() -> None:
    table = to_table(odd_six())
    table["base"]["rpy"] = [0.3, "pi/7", -1]
    r = reduce(from_table(table), "gravity", fixed={1: 0.3, 2: 0.4, 3: 0.5, 4: 0.6, 5: 0.7})
    assert rank(columns(r)) == r.partition.rank
    assert_couplings_hold(r)
    assert all(len(c) < 40 for row in r.as_dict()["couplings"].values() for c in row.values())


# --- M3 where it is not exact ----------------------------------------------------------------------------


def joints_outside(r: Reduction) -> tuple[str, ...]:
    """The aggregated joints whose columns lie outside the span of π′, by numbers."""
    q, w = samples(r.robot, 24, 2, r.experiment.loads)
    joints = [j for j, new in r.stages[3].stands_for.items() if new is None]
    R = np.linalg.qr(scaled(observation(r.robot, q, w, [p.name for p in r.full] + joints)), mode="r")
    full = R[:, : len(r.full)]
    return tuple(
        j for k, j in enumerate(joints, len(r.full)) if rank(np.column_stack([full, R[:, k]])) > rank(full)
    )


def test_a_joint_oblique_to_its_links_elastic_axes_is_recorded_as_an_inexact_aggregation() -> None:
    r = reduce(odd_six(), "wrench")
    assert r.inexact_aggregations == joints_outside(r) == ("c2", "c3")
    assert r.as_dict()["inexact_aggregations"] == list(r.inexact_aggregations)


def test_the_full_template_makes_the_aggregation_exact() -> None:
    table = to_table(odd_six())
    for joint in reduce(odd_six()).inexact_aggregations:
        table["joint"][int(joint[1:]) - 2]["link"]["template"] = "full"
    assert reduce(from_table(table)).inexact_aggregations == ()


def test_a_template_without_the_joints_rotation_is_recorded_too() -> None:
    table = to_table(load("planar2r"))
    table["template"] = [{"name": "rod", "pattern": ["*....."] + ["......"] * 5}]
    table["joint"][0]["link"]["template"] = "rod"
    assert reduce(from_table(table)).inexact_aggregations == ()  # link 2's bending still stands for it
    table["joint"][1]["link"]["template"] = "rod"
    r = reduce(from_table(table))
    assert r.inexact_aggregations == joints_outside(r) == ("c2",)


@pytest.mark.parametrize("name", library())
def test_the_librarys_aggregations_are_exact(name: str) -> None:
    r = reduce(load(name))
    assert r.inexact_aggregations == joints_outside(r) == ()


# --- growth ----------------------------------------------------------------------------------------------


def snake(n: int) -> Robot:
    rows = [
        {"a": 0.1, "alpha": "pi/2" if i % 2 else "-pi/2", "d": 0, "link": {"beam_axis": "x"}}
        for i in range(n)
    ]
    return from_table({"format": 1, "name": "snake", "joint": rows, "tool": {"xyz": [0.05, 0.02, 0.1]}})


def test_a_snake_of_thirty_joints_reduces(record_property: Any) -> None:
    import time

    start = time.perf_counter()
    r = reduce(snake(30))
    seconds = time.perf_counter() - start
    record_property("seconds", seconds)
    print(f"a snake of 30 joints: {seconds:.1f} s")
    assert dict(r.counts)["M3"] == 31 * 8
    # the rank grows by the same number with every pair of joints
    ranks = [reduce(snake(n)).partition.rank for n in (4, 6, 8)]
    assert ranks[1] - ranks[0] == ranks[2] - ranks[1]
    assert r.partition.rank == ranks[2] + (30 - 8) // 2 * (ranks[2] - ranks[1])


def test_exact_numbers_are_read_as_the_reduction_needs_them() -> None:
    assert reduce(KR270, fixed={1: parse_exact("pi/6")}).as_dict()["fixed"] == {"q1": "pi/6"}
