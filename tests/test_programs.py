"""Programs: how many operations, nothing twice and nothing in vain, angles and their rational stand-ins."""

from __future__ import annotations

import math
import tomllib
from importlib import resources
from typing import Any

import numpy as np
import pytest
import sympy as sp
from definition import elastic_frame, samples
from kr270_programs import kr270_programs

from symstiff.effects.base import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import from_table, library, load, parse_exact
from symstiff.symbolic.algebras import count
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.numeric import kinematics
from symstiff.symbolic.program import Builder, Let, Program
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
def test_the_stand_ins_of_an_odd_angle_are_a_rational_rotation_beside_the_exact_one(alpha: str) -> None:
    """Also where the sine is a half, or equals the cosine: both keep a stand-in, or rank would be found."""
    robot = from_table({"format": 1, "name": "one", "joint": [{"a": 0.5, "alpha": alpha, "d": 0.1}]})
    builder = Builder("constants", ())
    pair = sp.Matrix(ElasticChain(robot).alpha(builder, 1))
    rational = pair.subs({c.symbol: c.rational for c in builder.constants})
    assert rational.dot(rational) == 1
    angle = sp.nsimplify(alpha)
    assert pair.subs({c.symbol: c.exact for c in builder.constants}) == sp.Matrix(
        [sp.cos(angle), sp.sin(angle)]
    )
    assert max(abs(sp.N(rational - sp.Matrix([sp.cos(angle), sp.sin(angle)]), 30))) < 1e-12


def test_the_rational_stand_ins_of_an_inclined_beam_are_a_rotation() -> None:
    robot = from_table(
        {
            "format": 1,
            "name": "one",
            "joint": [{"a": 1, "alpha": 0.4, "d": 0, "link": {"beam_axis": [1, 2, 3]}}],
        }
    )
    builder = Builder("axes", ())
    axes = ElasticChain(robot).elastic_axes(builder, 1)
    rational = {c.symbol: c.rational for c in builder.constants}
    exact_values = {c.symbol: c.exact for c in builder.constants}
    E = sp.Matrix(3, 3, lambda r, k: sp.sympify(axes[k][r]))
    R = E.subs(rational)
    assert sp.eye(3) == R.T * R
    assert R.det() == 1
    expected = elastic_frame((1, 2, 3), float, np.sqrt).astype(float)
    np.testing.assert_allclose(np.array(E.subs(exact_values), float), expected, atol=1e-15)
    np.testing.assert_allclose(np.array(R, float), expected, atol=1e-12)


def test_a_terms_load_symbol_and_its_place_share_a_name() -> None:
    assert tau(link_joint(2, 6)).name == "tau_link2_6"
