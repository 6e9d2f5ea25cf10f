"""Derivation: geometry against the definition, columns against recursion, and laws of elasticity."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest
import sympy as sp
from definition import elastic_frame, jacobian, observation, places, pose, poses, samples, twist
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from symstiff.reduction.physical import original, physical_stages, symmetrised, terms_of
from symstiff.robot import Robot, from_table, library, load
from symstiff.robot.exact import Exact
from symstiff.robot.table import to_table
from symstiff.symbolic.algebras import count, evaluate_decimal, evaluate_numpy
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.numeric import forward, kinematics, virtual_joints
from symstiff.symbolic.program import Builder, Let, Program
from symstiff.symbolic.programs import (
    compliance_program,
    deflection_program,
    forward_program,
    jacobian_program,
    observation_program,
    virtual_jacobian_program,
)
from symstiff.symbolic.terms import Term, link_joint, q, tau

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
    assert [(v.kind, v.body, v.axis) for v in virtual_joints(robot)] == places(robot)


# --- random robots ---------------------------------------------------------------------------------------

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


# --- the observation matrix ------------------------------------------------------------------------------


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


# --- programs --------------------------------------------------------------------------------------------


def kr270_programs() -> tuple[Program, Program]:
    """Deflection and observation of the KR 270's 56 parameters."""
    if not _PROGRAMS:
        robot = load("kuka_kr270")
        full = physical_stages(robot)[-1].parameters
        names = tuple(p.name for p in full)
        chain = ElasticChain(robot)
        _PROGRAMS.append(deflection_program(chain, terms_of(full), names))
        _PROGRAMS.append(observation_program(chain, terms_of(full), names))
    return _PROGRAMS[0], _PROGRAMS[1]


_PROGRAMS: list[Program] = []


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
