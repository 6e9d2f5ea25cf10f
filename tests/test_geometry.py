"""Pose and Jacobian against their definition: symbolically, and at 50 digits."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp
from definition import jacobian, places, pose, poses, samples, twist

from symstiff.robot import Robot, from_table, library, load
from symstiff.robot.exact import Exact
from symstiff.robot.table import to_table
from symstiff.symbolic.algebras import evaluate_decimal
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.numeric import kinematics
from symstiff.symbolic.program import Let, Program
from symstiff.symbolic.programs import (
    forward_program,
    jacobian_program,
    virtual_jacobian_program,
)
from symstiff.symbolic.terms import q

# --- the definition, symbolically ------------------------------------------------------------------------


def expressions(program: Program) -> list[sp.Expr]:
    """The outputs of a program with every temporary and constant put in."""
    known = {c.symbol: c.exact for c in program.constants}
    found = []
    for statement in program.statements:
        value = statement.expression.xreplace(known)
        if isinstance(statement, Let):
            known[statement.symbol] = value
        else:
            found.append((statement.index, value))
    return [value for _, value in sorted(found, key=lambda pair: pair[0])]


def vanishes(expression: sp.Expr, angles: list[sp.Symbol]) -> bool:
    """Whether a trigonometric polynomial is zero: sin² is 1 − cos² and nothing else is related."""
    expanded = sp.expand(sp.expand_trig(expression))
    pairs = {a: (sp.Symbol(f"c_{a.name}"), sp.Symbol(f"s_{a.name}")) for a in angles}
    for angle, (c, s) in pairs.items():
        expanded = expanded.xreplace({sp.cos(angle): c, sp.sin(angle): s})
    for c, s in pairs.values():
        squares = {s**k: s ** (k % 2) * (1 - c**2) ** (k // 2) for k in range(2, 12)}
        expanded = sp.expand(expanded.xreplace(squares))
    return bool(expanded == 0)


def exact(value: Any) -> sp.Expr:
    return value.sympy() if isinstance(value, Exact) else sp.sympify(value)


def partial_derivatives(robot: Robot) -> list[sp.Expr]:
    """J_θ, row-major: ∂(pose)/∂θ_v at θ = 0, as the seed defines it."""
    variables, theta = [q(i) for i in range(1, robot.dof + 1)], sp.Symbol("theta", real=True)
    arithmetic: dict[str, Any] = {"alg": sp, "number": exact, "root": sp.sqrt}
    at = pose(robot, variables, **arithmetic)
    columns = []
    for place in places(robot):
        moved = pose(robot, variables, {place: theta}, **arithmetic)
        change = np.array([[sp.diff(x, theta).xreplace({theta: sp.S.Zero}) for x in row] for row in moved])
        columns.append(twist(change, at))
    return [column[r] for r in range(6) for column in columns]


def assert_geometry_is_definition(robot: Robot) -> None:
    found = expressions(virtual_jacobian_program(ElasticChain(robot)))
    expected = partial_derivatives(robot)
    assert len(found) == len(expected) == 6 * (7 * robot.dof + 6)
    angles = [q(i) for i in range(1, robot.dof + 1)]
    wrong = [k for k, (f, e) in enumerate(zip(found, expected, strict=True)) if not vanishes(f - e, angles)]
    assert not wrong


@pytest.mark.parametrize("name", ["planar2r", "scara"])
def test_the_geometric_jacobian_is_the_partial_derivative_of_the_pose(name: str) -> None:
    assert_geometry_is_definition(load(name))


@pytest.mark.slow
def test_the_geometric_jacobian_is_the_definition_where_nothing_is_parallel(odd3r: Robot) -> None:
    table = to_table(odd3r)
    table["base"]["rpy"] = ["pi/2", 0, "pi"]  # more radicals cost half a minute; they are tested at 50 digits
    table["joint"][0]["theta"] = "-pi/2"
    assert_geometry_is_definition(from_table(table))


# --- the definition, at 50 digits on a 6R ----------------------------------------------------------------


def six_odd_joints() -> Robot:
    """A KR 270 with everything that a file may add: inclined beams, turned base and tool, odd twists."""
    table = to_table(load("kuka_kr270"))
    table["base"]["rpy"] = ["pi/5", "pi/7", -1]
    table["base"]["link"] = {"beam_axis": [1, 2, 3]}
    table["tool"]["rpy"] = [0.3, "-pi/3", 2]
    table["joint"][1]["link"]["beam_axis"] = [0.35, 0, 0.675]
    table["joint"][4]["link"]["beam_axis"] = [0, -1, 1]
    table["joint"][2]["alpha"], table["joint"][3]["theta"], table["joint"][5]["alpha"] = "pi/6", 0.7, 1
    return from_table(table)


def mp(value: Any) -> Any:
    if isinstance(value, Exact):
        return mpmath.mpf(value.rational.numerator) / value.rational.denominator + mpmath.pi * (
            mpmath.mpf(value.pi.numerator) / value.pi.denominator
        )
    return mpmath.mpf(value)


@pytest.mark.parametrize("robot", [load("kuka_kr270"), six_odd_joints()], ids=["kr270", "odd"])
def test_the_jacobians_of_a_6r_are_central_differences_at_50_digits(robot: Robot) -> None:
    variables, h = ["0.3", "-1.1", "0.9", "2.3", "-0.7", "1.9"], mpmath.mpf("1e-16")
    chain = ElasticChain(robot)
    with mpmath.workdps(50):
        at_q = [mpmath.mpf(v) for v in variables]
        arithmetic: dict[str, Any] = {"alg": mpmath, "number": mp, "root": mpmath.sqrt}
        at = pose(robot, at_q, **arithmetic)

        def difference(springs: list[Any]) -> np.ndarray:
            ahead, behind = (pose(robot, at_q, s, **arithmetic) for s in springs)
            return twist((ahead - behind) / (2 * h), at)

        expected = [difference([{p: h}, {p: -h}]) for p in places(robot)]
        found = evaluate_decimal(virtual_jacobian_program(chain), q=variables)["J"]
        V = len(expected)
        assert max(abs(found[r * V + v] - expected[v][r]) for r in range(6) for v in range(V)) < 1e-28
        joints = evaluate_decimal(jacobian_program(chain), q=variables)["J"]
        actuated = [
            column for place, column in zip(places(robot), expected, strict=True) if place[0] == "joint"
        ]
        assert max(abs(joints[6 * r + j] - actuated[j][r]) for r in range(6) for j in range(6)) < 1e-28
        T = evaluate_decimal(forward_program(chain), q=variables)["T"]
        assert max(abs(T[4 * r + c] - at[r, c]) for r in range(4) for c in range(4)) < 1e-45


@pytest.mark.parametrize("name", library())
def test_jacobian_and_pose_of_every_library_robot_are_those_of_the_definition(name: str) -> None:
    robot = load(name)
    configurations, _ = samples(robot, 2, seed=3)
    found = kinematics(robot, configurations)
    for k, angles in enumerate(configurations):
        np.testing.assert_allclose(found.J_theta[k], jacobian(robot, angles), atol=1e-13)
        np.testing.assert_allclose(found.T[k], poses(robot, configurations)[k], atol=1e-13)
    assert [(v.kind, v.body, v.axis) for v in ElasticChain(robot).virtual_joints] == places(robot)
