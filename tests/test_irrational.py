"""Irrational numbers of the exact engine: fixed angles that cancel, beams whose unit vector has roots."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
import sympy as sp
from definition import observation, samples
from numerics import assert_couplings_hold, columns, rank, raw_columns, scaled

from symstiff.discrepancy.apart.distinguish import distinction
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.reduction.circle import Circle, order_for, prime_with_roots, primes
from symstiff.reduction.closed_form import closed_form
from symstiff.reduction.prime import PrimeAlgebra
from symstiff.reduction.structural import LOADS
from symstiff.robot import Robot, from_table, load, parse_exact
from symstiff.symbolic.chain import ElasticChain

# --- points of the circle ----------------------------------------------------------------------------------------

ANGLES = ["pi/6", "-2*pi/5", "3*pi/7", "0.5", "-0.8", "pi/3-0.3", "1/3+pi/4", "1e-7"]


@pytest.mark.parametrize("text", ANGLES)
def test_points_of_fixed_angles_keep_the_identities_of_sines_and_cosines(text: str) -> None:
    angles = [parse_exact(a).sympy() for a in ANGLES]
    one, order = parse_exact(text).sympy(), order_for(angles)
    p = primes(order)[0]
    circle = Circle(p, order)
    c, s = circle.point(one)
    assert (c * c + s * s) % p == 1
    assert circle.point(one + sp.pi / 2) == ((-s) % p, c)
    assert circle.point(-one) == (c, (-s) % p)
    for other in angles:
        d, t = circle.point(other)
        assert circle.point(one + other) == ((c * d - s * t) % p, (s * d + c * t) % p)
    assert len({circle.point(a) for a in angles}) == len(angles)


def test_a_part_of_pi_too_fine_for_any_prime_still_cancels() -> None:
    one, two = (parse_exact(a).sympy() for a in ("0.1234567*pi", "0.2345678*pi"))
    order = order_for([one, two])
    circle = Circle(primes(order)[0], order)
    (c, s), (d, t), p = circle.point(one), circle.point(two), circle.p
    assert circle.point(one + two) == ((c * d - s * t) % p, (s * d + c * t) % p)
    assert circle.point(-one) == (c, (-s) % p)


def test_algebraic_sines_and_cosines_solve_their_equations_modulo_every_prime() -> None:
    order = order_for([sp.pi / 7])
    for p in primes(order, 6):
        algebra = PrimeAlgebra(p, order)
        sixth, fifth, seventh, eighth = (algebra.fixed_angle(sp.pi / n) for n in (6, 5, 7, 4))
        assert 2 * sixth.sine % p == 1
        assert (4 * fifth.cosine**2 - 2 * fifth.cosine - 1) % p == 0
        x = 2 * seventh.cosine
        assert (x**3 - x**2 - 2 * x + 1) % p == 0
        assert eighth.cosine == eighth.sine
        roots = [algebra.power(algebra.number(sp.Integer(n)), sp.S.Half) for n in (2, 3, 5, 6, 18)]
        assert [2 * eighth.cosine % p, 2 * sixth.cosine % p, (4 * fifth.cosine - 1) % p] == roots[:3]
        assert roots[3] == roots[0] * roots[1] % p


def test_roots_exist_modulo_the_prime_that_is_chosen_for_them() -> None:
    p = prime_with_roots(360, frozenset({37 * 25, 7 * 11}))
    circle = Circle(p)
    for n in (37, 7, 11, 77):
        root = circle.root(n)
        assert root is not None
        assert root * root % p == n
    assert circle.root(49) == 7


# --- reductions ---


def tilted(base: str, *alphas: str) -> Robot:
    """A chain of inclined axes, each beam along the axis of its frame that is nearest to the link."""
    lengths, beams = ((0.1, 0.3), (0.4, 0.1), (0.3, 0.1)), "zxx"
    joints = [
        {"a": a, "alpha": alpha, "d": d, "link": {"beam_axis": beam}}
        for (a, d), alpha, beam in zip(lengths, (*alphas, "0"), beams, strict=True)
    ]
    base_table = {"rpy": [base, 0, 0], "link": {"beam_axis": "z"}}
    tool = {"xyz": [0.05, 0.02, 0.1]}
    return from_table({"format": 1, "name": "tilted", "base": base_table, "joint": joints, "tool": tool})


UR10, TILTED = load("ur10"), tilted("pi/3", "-pi/6", "-pi/6")
CANCELLING = [
    (UR10, {2: -0.5, 3: -0.3, 4: 0.8}, "pose", 35, 14),
    (UR10, {2: -0.5, 3: -0.3, 4: 0.8}, "position", 33, 12),
    (UR10, {2: "-pi/4", 3: "-pi/4"}, "pose", 41, 19),
    (UR10, {2: "-pi/3", 3: "-pi/6"}, "pose", 41, 19),
    (load("kuka_kr270"), {2: "-pi/4", 3: "-pi/4"}, "pose", 42, 20),
    (TILTED, {1: 0, 2: 0}, "pose", 22, 12),
    (tilted("pi/5", "-pi/10", "-pi/10"), {1: 0, 2: 0}, "pose", 22, 12),
    (tilted("2*pi/7", "-pi/7", "-pi/7"), {1: 0, 2: 0}, "pose", 22, 12),
    (tilted("0.7", "-0.3", "-0.4"), {1: 0, 2: 0}, "pose", 22, 12),
]


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "fixed", "measure", "influential", "count"), CANCELLING)
def test_fixed_angles_that_cancel_leave_what_numbers_leave(
    robot: Robot, fixed: Any, measure: str, influential: int, count: int
) -> None:
    """Sums of angles that are zero or a quarter turn, along one axis or along the chain."""
    r = reduce(robot, "gravity", measure, fixed)
    steps, A = dict(r.counts), raw_columns(r)
    size = np.linalg.norm(A, axis=0)
    assert set(r.partition.g2) == {
        p.name for p, s in zip(r.full, size, strict=True) if s < 1e-11 * size.max()
    }
    assert (steps["M4"], steps["M5"]) == (influential, count)
    assert rank(columns(r)) == count
    assert_couplings_hold(r)
    coefficients = [
        abs(float(c)) for row in r.as_dict()["couplings"].values() for c in map(sp.Rational, row.values())
    ]
    assert min(coefficients) > 1e-3
    assert max(coefficients) < 1e3


def test_an_irrational_coupling_reads_as_a_decimal_and_a_rational_one_as_a_fraction() -> None:
    """By hand: axes z and y of frames 0 and 1, inclined by 60 and 30 degrees, and their shares of an upright force."""
    r = reduce(TILTED, "gravity", fixed={1: 0, 2: 0}).as_dict()["couplings"]
    assert r["k1_11"] == {"k0_11": "3/2", "k0_33": "1/2"}
    assert r["k1_33"] == {"k0_11": "-1/2", "k0_33": "1/2"}
    assert all(
        re.fullmatch(r"-?(\d{1,5}(/\d{1,5})?|\d*\.\d{10,17})", c) for row in r.values() for c in row.values()
    )


@pytest.mark.slow
@pytest.mark.parametrize("fixed", [{2: 0.25, 3: 0.25}, {1: 0.25, 2: -0.25}, {2: "pi/7", 4: 1}, {3: "3*pi/4"}])
def test_couplings_at_short_angles_are_those_of_numbers(fixed: Any) -> None:
    """A radian is no rational point of the circle: no fraction may be found where its sine matters."""
    for loads in ("wrench", "gravity"):
        r = reduce(UR10, loads, fixed=fixed)
        assert rank(columns(r)) == r.partition.rank
        assert_couplings_hold(r)


OBLIQUE = [([0.3, -0.5, 0], 0.3, 0.5), ([0.3, -0.4, 0], 0.3, 0.4), (["0.35", -0.675, 0], 0.35, 0.675)]


@pytest.mark.parametrize(("beam", "a", "d"), OBLIQUE)
@pytest.mark.parametrize("loads", list(LOADS))
def test_a_beam_along_its_link_reduces_alike_whether_its_unit_vector_is_rational_or_not(
    beam: Any, a: float, d: float, loads: str
) -> None:
    pedestal = {"a": a, "alpha": "-pi/2", "d": d, "link": {"beam_axis": beam}}
    arm = {"a": 0.6, "alpha": 0, "d": 0, "link": {"beam_axis": "x"}}
    table = {"format": 1, "name": "oblique", "base": {"link": {"beam_axis": "z"}}, "joint": [pedestal, arm]}
    r = reduce(from_table({**table, "tool": {"xyz": [0.05, 0.02, 0.1]}}), loads)
    assert {"k0_26", "k0_35"} <= set(r.partition.g1)
    assert rank(columns(r)) == r.partition.rank
    assert_couplings_hold(r)


def oblique_four() -> Robot:
    """Links of which each is bent, with its beam along the lever; 60 digits find ranks 30 and 26."""
    bent = {"a": 0.1, "alpha": "-pi/2", "d": 0.2, "link": {"beam_axis": [0.1, -0.2, 0.0]}}
    arm = {"a": 0.5, "alpha": 0, "d": 0.1, "link": {"beam_axis": [0.5, 0, 0.1]}}
    wrist = {"a": 0, "alpha": "pi/2", "d": 0.2, "link": {"beam_axis": "y"}}
    base, tool = {"link": {"beam_axis": "z"}}, {"xyz": [0.05, 0.02, 0.1]}
    return from_table(
        {"format": 1, "name": "bent", "base": base, "joint": [bent, arm, bent, wrist], "tool": tool}
    )


@pytest.mark.parametrize(("loads", "count"), [("wrench", 30), ("gravity", 26)])
def test_beams_along_bent_links_give_the_rank_that_sixty_digits_give(loads: str, count: int) -> None:
    r = reduce(oblique_four(), loads)
    assert rank(columns(r)) == r.partition.rank == count
    assert_couplings_hold(r)
    chain = ElasticChain(r.robot, symbolic=True)
    lengths = dict(zip(chain.lengths(), chain.length_values(), strict=True))
    for e, row in closed_form(r).items():
        for k, c in row.items():
            assert float(c.subs(lengths)) == pytest.approx(float(r.partition.couplings[e][k]), rel=1e-12)


def test_a_beam_along_a_bent_link_leaves_of_its_asymmetry_what_numbers_leave() -> None:
    """Ranks of the observation matrix by the definition, with and without the link's other entries."""
    bent = {"a": 0.1, "alpha": "-pi/2", "d": 0.2, "link": {"beam_axis": [0.1, -0.2, 0.0]}}
    arm = {"a": 0.5, "alpha": 0, "d": 0.1, "link": {"beam_axis": [0.5, 0, 0.1]}}
    base, tool = {"link": {"beam_axis": "z"}}, {"xyz": [0.05, 0.02, 0.1]}
    robot = from_table({"format": 1, "name": "bent", "base": base, "joint": [bent, arm, bent], "tool": tool})
    reduction = reduce(robot)
    names = [p.name for p in reduction.full]
    every = sorted({*names, *(f"k1_{r}{c}" for r in range(1, 7) for c in range(r, 7))})
    q, w = samples(robot, 24, 1, "wrench")
    few, all_ = (rank(scaled(observation(robot, q, w, n).reshape(-1, len(n)))) for n in (names, every))
    found = distinction(StiffnessModel.of(reduction), "link_asymmetry", {"link": 1})
    assert (len(found.parameters), found.gained) == (13, all_ - few)
