"""Programs: how many operations, nothing twice and nothing in vain, angles and what stands for them modulo a prime."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from importlib import resources
from typing import Any

import numpy as np
import pytest
import sympy as sp
from definition import elastic_frame, samples
from kr270_programs import kr270_programs

from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.reduction.circle import prime_with_roots
from symstiff.reduction.prime import PRIMES, PrimeAlgebra
from symstiff.robot import from_table, library, load, parse_exact
from symstiff.symbolic.algebras import count
from symstiff.symbolic.builder import Builder
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.numeric import kinematics
from symstiff.symbolic.program import Let, Program
from symstiff.symbolic.programs import (
    jacobian_program,
    virtual_jacobian_program,
)
from symstiff.symbolic.terms import link_joint, q, tau


def operations(program: Program) -> int:
    """Additions, multiplications and sign changes, counted here from the statements' sums of products."""
    total = 0
    for statement in program.statements:
        e = statement.expression
        if e.is_Function:
            continue
        terms = [t.as_coeff_Mul() for t in sp.Add.make_args(e)]
        total += len(terms) - 1 + int(all(number < 0 for number, _ in terms))
        for number, rest in terms:
            assert all(f.is_Symbol or f == 1 for f in sp.Mul.make_args(rest))
            factors = int(abs(number) != 1) + sum(f.is_Symbol for f in sp.Mul.make_args(rest))
            total += max(0, factors - 1)
    return total


def test_the_kr270s_programs_stay_below_the_operation_bars() -> None:
    """56 parameters; additions, multiplications and sign changes, without the sines and cosines."""
    deflection, observed = kr270_programs()
    for program, bar in ((deflection, 440), (observed, 640)):
        counted = count(program)
        assert counted["add"] + counted["mul"] + counted["neg"] == operations(program)
        assert operations(program) <= bar
        assert counted["other"] == 0


def test_parallel_axes_of_the_kr270_turn_by_one_merged_angle() -> None:
    lets = [
        s.expression
        for s in jacobian_program(ElasticChain(load("kuka_kr270"))).statements
        if isinstance(s, Let)
    ]
    sums = [e for e in lets if e.is_Add and e.free_symbols <= {q(i) for i in range(1, 7)}]
    assert sums == [q(2) + q(3)]


def test_a_merged_angle_needs_no_functions_where_its_parts_have_theirs() -> None:
    assert [count(program)["trig"] for program in kr270_programs()] == [12, 12]


def test_a_law_that_turns_with_the_joints_takes_the_sines_that_are_there() -> None:
    """What the arm weighs on a gear, in a base that stands oblique: no function of an angle is called anew."""
    file = tomllib.loads((resources.files("symstiff.robot") / "library" / "ur10.toml").read_text())
    oblique = from_table({**file, "base": {**file.get("base", {}), "rpy": [0.1, 0.2, 0.3]}})
    model = StiffnessModel.of(reduce(oblique, "gravity", "position"))
    gear = EffectInstance("nonlinear_stiffness", {"joint": 3}, {"load": 50.0, "saturation": 1.0})
    plain, grown = (count(m.deflection_program) for m in (model, model.with_effect(gear)))
    assert grown["mul"] > plain["mul"]
    assert grown["trig"] == plain["trig"]


def test_programs_compute_nothing_twice_and_nothing_in_vain() -> None:
    for program in kr270_programs():
        lets = [s for s in program.statements if isinstance(s, Let)]
        assert len({s.expression for s in lets}) == len(lets)
        used = set().union(*(s.expression.free_symbols for s in program.statements))
        assert {s.symbol for s in lets} <= used
        known = {v for vector in program.inputs for v in vector.symbols} | {
            c.symbol for c in program.constants
        }
        for statement in program.statements:
            assert statement.expression.free_symbols <= known
            if isinstance(statement, Let):
                known.add(statement.symbol)


@pytest.mark.parametrize("name", library())
def test_symbolic_lengths_with_their_numbers_put_in_are_the_numeric_program(name: str) -> None:
    robot = load(name)
    chain = ElasticChain(robot, symbolic=True)
    numbers = {}
    rows = chain.rows
    for i in range(1, robot.dof + 1):
        numbers |= {f"a_{i}": float(rows[i - 1].a), f"d_{i}": float(rows[i - 1].d)}
    numbers |= {f"t_{axis}": float(v) for axis, v in zip("xyz", robot.tool.xyz, strict=True)}
    program = virtual_jacobian_program(chain)
    assert {s.name for s in chain.lengths()} <= set(numbers)
    angles, _ = samples(robot, 1, seed=2)
    known = {q(i): sp.Float(angles[0, i - 1]) for i in range(1, robot.dof + 1)}
    known |= {s: sp.Float(numbers[s.name]) for s in chain.lengths()}
    known |= {c.symbol: sp.N(c.exact) for c in program.constants}
    values = np.zeros(program.size("J"))
    for statement in program.statements:
        value = statement.expression.xreplace(known)
        if isinstance(statement, Let):
            known[statement.symbol] = sp.N(value)
        else:
            values[statement.index] = float(value)
    np.testing.assert_allclose(values.reshape(6, -1), kinematics(robot, angles).J_theta[0], atol=1e-12)


@pytest.mark.parametrize(
    ("alpha", "pair"), [(0, (1, 0)), ("pi/2", (0, 1)), ("-pi/2", (0, -1)), ("pi", (-1, 0))]
)
def test_right_angles_give_exact_zeros_and_ones(alpha: Any, pair: tuple[int, int]) -> None:
    row = {"a": 0.5, "alpha": alpha, "d": 0.1}
    robot = from_table({"format": 1, "name": "one", "joint": [row], "tool": {"xyz": [0.1, 0.2, 0.3]}})
    builder = Builder("constants", ())
    assert ElasticChain(robot).alpha(builder, 1) == pair
    program = virtual_jacobian_program(ElasticChain(robot))
    assert program.constants == ()
    assert not any(s.expression.atoms(sp.Float) for s in program.statements)


@pytest.mark.parametrize("alpha", [1.5707963267948966, -1.570796326795, 1.5707963268, 4.71238898038469])
def test_a_right_angle_with_all_its_digits_is_one(alpha: float) -> None:
    robot = from_table({"format": 1, "name": "one", "joint": [{"a": 0.5, "alpha": alpha, "d": 0.1}]})
    assert robot.joint[0].alpha == parse_exact(f"{round(alpha / (math.pi / 2))}*pi/2")
    assert float(parse_exact("1.5708")) == 1.5708


@pytest.mark.parametrize("alpha", ["pi/6", "pi/3", "-2*pi/3", "pi/4", "3*pi/4", "pi/5", "0.4", "-3"])
def test_the_constants_of_an_odd_angle_are_a_rotation_exactly_and_modulo_a_prime(alpha: str) -> None:
    robot = from_table({"format": 1, "name": "one", "joint": [{"a": 0.5, "alpha": alpha, "d": 0.1}]})
    builder, algebra = Builder("constants", ()), PrimeAlgebra(PRIMES[0])
    pair = sp.Matrix(ElasticChain(robot).alpha(builder, 1))
    angle = sp.nsimplify(alpha)
    assert pair.subs({c.symbol: c.exact for c in builder.constants}) == sp.Matrix(
        [sp.cos(angle), sp.sin(angle)]
    )
    assert all(abs(sp.N(sp.cos(c.turn) - c.exact, 30)) < 1e-25 for c in builder.constants)
    residues = pair.subs({c.symbol: algebra.constant(c) for c in builder.constants})
    assert residues.dot(residues) % algebra.p == 1
    fixed = algebra.fixed_angle(angle)
    assert [x % algebra.p for x in residues] == [fixed.cosine, fixed.sine]


def test_an_inclined_beams_axes_are_a_rotation_and_have_rational_multiples() -> None:
    joint = {"a": 1, "alpha": 0.4, "d": 0, "link": {"beam_axis": [1, 2, 3]}}
    chain = ElasticChain(from_table({"format": 1, "name": "one", "joint": [joint]}))
    builder = Builder("axes", ())
    axes = chain.elastic_axes(builder, 1)
    E = sp.Matrix(3, 3, lambda r, k: sp.sympify(axes[k][r]))
    R = E.subs({c.symbol: c.exact for c in builder.constants})
    assert sp.eye(3) == (R.T * R).applyfunc(sp.nsimplify)
    expected = elastic_frame((1, 2, 3), float, np.sqrt).astype(float)
    np.testing.assert_allclose(np.array(R, float), expected, atol=1e-15)
    prime = prime_with_roots(360, chain.squares())
    residue = {c.symbol: PrimeAlgebra(prime).constant(c) for c in builder.constants}
    assert (E.T * E).subs(residue).applyfunc(lambda x: x % prime) == sp.eye(3)
    longer = replace(chain, unit_axes=False)
    S = sp.Matrix(3, 3, lambda r, k: sp.sympify(longer.elastic_axes(builder, 1)[k][r]))
    assert all(x.is_Rational for x in S)
    lengths = np.array(longer.axis_lengths(1), float)
    np.testing.assert_allclose(np.array(S, float), expected * lengths, rtol=1e-14)


def test_a_terms_load_symbol_and_its_place_share_a_name() -> None:
    assert tau(link_joint(2, 6)).name == "tau_link2_6"
