"""Columns, recursion and definition agree on any robot, and deflections keep the laws of elasticity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from definition import jacobian, observation, places, poses, samples
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from kr270_programs import kr270_programs

from symstiff.effects.arm import weight_load
from symstiff.reduction.physical import original, symmetrised, terms_of
from symstiff.robot import Robot, from_table, load
from symstiff.robot.table import to_table
from symstiff.symbolic.algebras import evaluate_numpy
from symstiff.symbolic.builder import Builder
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.compliance import compliance_program
from symstiff.symbolic.numeric import forward
from symstiff.symbolic.programs import (
    deflection_program,
    observation_program,
)
from symstiff.symbolic.terms import Term, q

lengths = st.sampled_from([0, 0, 0.35, -0.055, "1/3", 1.1])
twists = st.sampled_from([0, "pi/2", "-pi/2", "pi", "pi/6", "-pi/6", 0.4, "-3*pi/4"])
beams = st.one_of(
    st.sampled_from(["x", "y", "z"]),
    st.tuples(*[st.sampled_from([0, 1, -1, 0.35, 2])] * 3).filter(any).map(list),
)
placements = st.fixed_dictionaries(
    {"xyz": st.lists(lengths, min_size=3, max_size=3), "rpy": st.lists(twists, min_size=3, max_size=3)}
)
joints = st.fixed_dictionaries(
    {
        "type": st.sampled_from(["revolute", "revolute", "prismatic"]),
        "a": lengths,
        "alpha": twists,
        "d": lengths,
        "theta": twists,
        "link": st.fixed_dictionaries({"beam_axis": beams}),
    }
)
tables = st.fixed_dictionaries(
    {
        "format": st.just(1),
        "name": st.just("random"),
        "convention": st.sampled_from(["standard", "modified"]),
        "base": placements.flatmap(lambda p: beams.map(lambda b: {**p, "link": {"beam_axis": b}})),
        "joint": st.lists(joints, min_size=1, max_size=4),
        "tool": placements,
    }
)


def symmetric_terms(robot: Robot) -> tuple[tuple[Term, ...], tuple[str, ...]]:
    """Full symmetric link matrices (21 terms) and the joints."""
    parameters = symmetrised(original(robot)).parameters
    return terms_of(parameters), tuple(p.name for p in parameters)


@pytest.mark.slow
@given(tables, st.integers(0, 2**31))
@settings(max_examples=8, deadline=None)
def test_columns_recursion_and_definition_agree_on_any_robot(table: dict[str, Any], seed: int) -> None:
    robot = from_table(table)
    chain, (terms, names) = ElasticChain(robot), symmetric_terms(robot)
    angles, w = samples(robot, 2, seed)
    p = np.random.default_rng(seed).normal(size=len(names))
    A = evaluate_numpy(observation_program(chain, terms, names), q=angles, w=w)["A"]
    expected = observation(robot, angles, w, names).reshape(2, 6, -1)
    np.testing.assert_allclose(A, expected, atol=1e-11)
    dt = evaluate_numpy(deflection_program(chain, terms, names), p=p, q=angles, w=w)["dt"]
    np.testing.assert_allclose(dt, expected @ p, atol=1e-10)
    np.testing.assert_allclose(forward(robot, angles)[0], poses(robot, angles)[0], atol=1e-12)


@given(tables, st.integers(0, 2**31))
@settings(max_examples=4, deadline=None)
def test_the_compliance_matrix_is_symmetric_and_gives_the_deflection(
    table: dict[str, Any], seed: int
) -> None:
    robot = from_table(table)
    chain, (terms, names) = ElasticChain(robot), symmetric_terms(robot)
    angles, w = samples(robot, 2, seed)
    p = np.random.default_rng(seed).normal(size=len(names))
    C = evaluate_numpy(compliance_program(chain, terms, names), p=p, q=angles)["C"]
    np.testing.assert_allclose(C, C.transpose(0, 2, 1), atol=1e-12)
    dt = evaluate_numpy(deflection_program(chain, terms, names), p=p, q=angles, w=w)["dt"]
    np.testing.assert_allclose(np.einsum("nij,nj->ni", C, w), dt, atol=1e-10)


def modified(robot: Robot) -> dict[str, Any]:
    """The same robot as Craig would write it: a and alpha move one row down, joint 1 stands on frame 0."""
    table = to_table(robot)
    table["convention"] = "modified"
    shape = [(0, 0), *((row.get("a", 0), row.get("alpha", 0)) for row in table["joint"])]
    for row, (a, alpha) in zip(table["joint"], shape, strict=False):
        row["a"], row["alpha"] = a, alpha
    return table


@given(tables, st.integers(0, 2**31))
@settings(max_examples=4, deadline=None)
def test_a_robot_gives_the_same_deflections_in_both_dh_conventions(table: dict[str, Any], seed: int) -> None:
    assume(len(table["joint"]) > 1)
    table = {**table, "convention": "standard"}  # a modified file has no a, alpha after its last joint
    table["joint"] = [*table["joint"][:-1], {**table["joint"][-1], "a": 0, "alpha": 0}]
    standard = from_table(table)
    other = from_table(modified(standard))
    terms, names = symmetric_terms(standard)
    angles, w = samples(standard, 2, seed)
    p = np.random.default_rng(seed).normal(size=len(names))
    one, two = (
        evaluate_numpy(deflection_program(ElasticChain(r), terms, names), p=p, q=angles, w=w)["dt"]
        for r in (standard, other)
    )
    np.testing.assert_allclose(one, two, atol=1e-11)


def test_a_kr270_in_modified_dh_deflects_and_reduces_as_in_standard_dh() -> None:
    from symstiff.reduction import reduce

    standard, other = load("kuka_kr270"), from_table(modified(load("kuka_kr270")))
    assert other.convention == "modified"
    one, two = reduce(standard, "gravity"), reduce(other, "gravity")
    assert one.partition == two.partition


def test_a_centre_of_mass_and_a_beam_stand_in_the_standard_frame_in_a_modified_file_too() -> None:
    """The same numbers in both conventions are the same arm: at the far end of a link, not at its Craig frame."""
    robot = load("kuka_kr270")
    table = to_table(robot)
    for row in table["joint"]:
        row["link"] = {
            "template": "full",
            "beam_axis": [0.3, 0.5, 0.7],
            "mass": 40.0,
            "com": [0.1, -0.2, 0.3],
        }
    standard = from_table(table)
    other = from_table(modified(standard))
    turn = {q(j): 0.3 * j for j in range(1, 7)}
    for joint in (2, 3, 5):
        one, two = (float(weight_load(r, joint).evalf(subs=turn)) for r in (standard, other))
        assert one == pytest.approx(two, rel=1e-9)
        assert abs(one) > 1.0
    b = Builder("axes", ())
    assert ElasticChain(standard).elastic_axes(b, 2) == ElasticChain(other).elastic_axes(b, 2)


def test_a_column_of_the_full_link_is_one_virtual_joint_times_the_load_on_another(odd3r: Robot) -> None:
    """The general term J_i·(J_jᵀW) for all 36 entries; the diagonal ones are seed eq. (5)."""
    full = original(odd3r).parameters
    names = tuple(p.name for p in full)
    assert len(names) == 3 + 4 * 36
    angles, w = samples(odd3r, 2, seed=8)
    program = observation_program(ElasticChain(odd3r), terms_of(full, symmetric=False), names)
    A = evaluate_numpy(program, q=angles, w=w)["A"]
    where = {place: k for k, place in enumerate(places(odd3r))}
    for n, (one_q, one_w) in enumerate(zip(angles, w, strict=True)):
        J = jacobian(odd3r, one_q)
        for k, p in enumerate(full):
            i = where["joint", p.body, 0] if p.is_joint else where["link", p.body, p.row]
            j = where["joint", p.body, 0] if p.is_joint else where["link", p.body, p.column]
            np.testing.assert_allclose(A[n, :, k], J[:, i] * (J[:, j] @ one_w), atol=1e-13)


def test_compliance_is_the_inverse_of_the_seeds_stiffness_matrix() -> None:
    """K_C = (J_θ·k·J_θᵀ)⁻¹ (seed eq. 2) with positive definite link matrices."""
    robot = load("kuka_kr270")
    terms, names = symmetric_terms(robot)
    angles, w = samples(robot, 2, seed=5)
    rng = np.random.default_rng(5)
    springs, values = np.zeros((48, 48)), {}
    order = places(robot)
    for i in range(7):
        root = rng.normal(size=(6, 6))
        block, rows = root @ root.T, [order.index(("link", i, a)) for a in range(1, 7)]
        springs[np.ix_(rows, rows)] = block
        values |= {f"k{i}_{r + 1}{c + 1}": block[r, c] for r in range(6) for c in range(r, 6)}
    for j in range(1, 7):
        values[f"c{j}"] = springs[order.index(("joint", j, 0)), order.index(("joint", j, 0))] = rng.uniform(
            1, 2
        )
    p = [values[n] for n in names]
    C = evaluate_numpy(compliance_program(ElasticChain(robot), terms, names), p=p, q=angles)["C"]
    dt = evaluate_numpy(deflection_program(ElasticChain(robot), terms, names), p=p, q=angles, w=w)["dt"]
    for k, one_q in enumerate(angles):
        J = jacobian(robot, one_q)
        K = np.linalg.inv(J @ springs @ J.T)
        np.testing.assert_allclose(C[k] @ K, np.eye(6), atol=1e-9)
        np.testing.assert_allclose(K @ dt[k], w[k], rtol=1e-8)


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
def test_deflection_is_linear_in_load_and_reciprocal(a: float, b: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-3, 3, (1, 6))
    first, second, p = rng.normal(size=(1, 6)), rng.normal(size=(1, 6)), rng.normal(size=56)

    def dt(w: np.ndarray) -> np.ndarray:
        return evaluate_numpy(kr270_programs()[0], p=p, q=angles, w=w)["dt"]

    size = (abs(a) + abs(b) + 1) * 1e3
    np.testing.assert_allclose(dt(a * first + b * second), a * dt(first) + b * dt(second), atol=1e-13 * size)
    assert float((first @ dt(second).T).item()) == pytest.approx(
        float((second @ dt(first).T).item()), abs=1e-9
    )
