"""Reduction M1–M5: the seed's numbers, the maps' algebra, groups by their definition, and odd robots."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import sympy as sp
from definition import samples
from hypothesis import given, settings
from hypothesis import strategies as st
from numerics import assert_couplings_hold, columns, rank

from symstiff.errors import UserError
from symstiff.reduction import reduce
from symstiff.reduction.physical import Stage, physical_stages, terms_of
from symstiff.reduction.template import beam_compliance, beam_pattern, pattern
from symstiff.robot import Robot, from_table, library, load
from symstiff.robot.table import to_table
from symstiff.symbolic.algebras import evaluate_numpy
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.program import Let, Program
from symstiff.symbolic.programs import observation_program

KR270 = load("kuka_kr270")


# --- the seed's Table 1 ----------------------------------------------------------------------------------


def test_the_seeds_table_1_comes_out_exactly() -> None:
    r = reduce(KR270, loads="gravity", measure="pose")
    steps = ("original", "M1", "M2", "M3", "M4", "M5")
    assert r.counts == tuple(zip(steps, (258, 153, 62, 56, 46, 26), strict=True))
    assert r.partition.g1 == ("k0_35",)
    assert (len(r.partition.g2), len(r.partition.g3), r.partition.rank) == (10, 45, 26)


@pytest.mark.parametrize(
    ("loads", "measure", "rank_", "groups"),
    [
        ("wrench", "pose", 32, (2, 0, 54)),
        ("gravity", "position", 24, (1, 10, 45)),
        ("force", "position", 30, None),
    ],
)
def test_other_classes_of_loads_and_measurements_have_the_known_ranks(
    loads: str, measure: str, rank_: int, groups: tuple[int, int, int] | None
) -> None:
    p = reduce(KR270, loads, measure).partition
    assert p.rank == rank_
    assert groups is None or (len(p.g1), len(p.g2), len(p.g3)) == groups


@pytest.mark.parametrize(
    ("loads", "one", "two"), [("gravity", 25, 26), ("force", 31, 32), ("wrench", 31, 32)]
)
def test_a_marker_beside_the_tool_centre_point_tells_more_than_this_and_less_than_the_pose(
    loads: str, one: int, two: int
) -> None:
    for points, known in ((("p1",), one), (("p1", "p2"), two)):
        r = reduce(KR270, loads, "position", points=points)
        assert r.partition.rank == rank(columns(r)) == known
        assert_couplings_hold(r)


# --- M1 to M3 --------------------------------------------------------------------------------------------


def put_in(program: Program) -> list[sp.Expr]:
    """Outputs of a program in q and w alone."""
    known: dict[sp.Symbol, sp.Expr] = {c.symbol: c.exact for c in program.constants}
    found: dict[int, sp.Expr] = {}
    for statement in program.statements:
        value = statement.expression.xreplace(known)
        if isinstance(statement, Let):
            known[statement.symbol] = value
        else:
            found[statement.index] = value
    return [found[k] for k in range(len(found))]


def stage_program(robot: Robot, stage: Stage) -> Program:
    names = tuple(p.name for p in stage.parameters)
    terms = terms_of(stage.parameters, symmetric=stage.step != "original")
    return observation_program(ElasticChain(robot), terms, names)


@pytest.mark.parametrize("name", library())
def test_every_physical_step_has_a_binary_matrix_with_at_most_one_entry_in_a_row(name: str) -> None:
    stages = physical_stages(load(name))
    for before, stage in pairwise(stages):
        M = stage.matrix
        assert M.shape == (len(before.parameters), len(stage.parameters))
        assert list(stage.stands_for) == list(before.names)
        assert set(np.unique(M)) <= {0, 1}
        assert M.sum(axis=1).max() == 1
        assert M.sum(axis=0).min() >= 1
        for k, old in enumerate(before.names):  # π = M·π′ sets every old parameter to the one it stands for
            new = stage.stands_for[old]
            assert (M[k].sum() == 0) == (new is None)
            assert new is None or M[k, stage.names.index(new)] == 1
            assert (old in stage.reasons) == (new != old)


def test_a_links_symmetrisation_is_the_seeds_36_by_21_matrix() -> None:
    stages = physical_stages(KR270)
    rows = [k for k, p in enumerate(stages[0].parameters) if p.name.startswith("k3_")]
    cols = [k for k, p in enumerate(stages[1].parameters) if p.name.startswith("k3_")]
    M = stages[1].matrix[np.ix_(rows, cols)]
    assert M.shape == (36, 21)
    assert sorted(M.sum(axis=0)) == [1] * 6 + [2] * 15


@pytest.mark.parametrize("name", ["planar2r", "scara"])
def test_the_reduced_observation_matrix_is_symbolically_the_full_one_times_the_map(name: str) -> None:
    """A_π′ = A_π·M for M1 and M2 in closed form; M3 leaves the absorbed joints' columns out (seed eq. 10, 11)."""
    robot = load(name)
    stages = physical_stages(robot)
    matrices = []
    for stage in stages:
        flat = put_in(stage_program(robot, stage))
        matrices.append(sp.Matrix(6, len(stage.parameters), flat))
    for k in (1, 2, 3):
        difference = matrices[k - 1] * sp.Matrix(stages[k].matrix.tolist()) - matrices[k]
        assert all(sp.expand(sp.expand_trig(x)) == 0 for x in difference if x != 0)


def test_the_maps_hold_symbolically_on_the_kr270_in_its_temporaries() -> None:
    """Columns of one program that has all stages' parameters: sums of columns are equal as expressions."""
    stages = physical_stages(KR270)
    terms = terms_of(stages[0].parameters, symmetric=False)
    renamed = [
        [type(t)(f"{s.step}:{t.parameter}", t.at, t.factor) for t in terms_of(s.parameters)]
        for s in stages[1:]
    ]
    names = [t.parameter for t in terms]
    names = list(dict.fromkeys([*names, *(t.parameter for ts in renamed for t in ts)]))
    program = observation_program(ElasticChain(KR270), [*terms, *(t for ts in renamed for t in ts)], names)
    outputs, width = {s.index: s.expression for s in program.statements if not isinstance(s, Let)}, len(names)
    column = {n: [outputs[r * width + c] for r in range(6)] for c, n in enumerate(names)}
    before = {p.name: column[p.name] for p in stages[0].parameters}
    for stage in stages[1:]:
        after = {p.name: column[f"{stage.step}:{p.name}"] for p in stage.parameters}
        for new, expected in after.items():
            parts = [before[old] for old, stands in stage.stands_for.items() if stands == new]
            assert all(unfolds_to_zero(sum(x[r] for x in parts) - expected[r], program) for r in range(6))
        before = after


def unfolds_to_zero(difference: sp.Expr, program: Program) -> bool:
    """Whether an expression in temporaries vanishes, putting in as few of their definitions as it takes."""
    difference = sp.expand(difference)
    for statement in reversed(program.statements):
        if difference == 0:
            return True
        if isinstance(statement, Let) and difference.has(statement.symbol):
            difference = sp.expand(difference.xreplace({statement.symbol: statement.expression}))
    return bool(difference == 0)


def test_a_joint_is_aggregated_only_where_an_elastic_link_stands_before_it() -> None:
    table = to_table(KR270)
    table["base"]["link"] = {"template": "rigid"}
    table["joint"][2]["link"]["template"] = "rigid"
    r = reduce(from_table(table))
    assert [p.name for p in r.full if p.is_joint] == ["c1", "c4"]
    assert not any(p.name.startswith(("k0_", "k3_")) for p in r.full)
    assert len(r.full) == 5 * 8 + 2
    assert "acts together with link 1" in r.stages[3].reasons["c2"]


# --- the template ----------------------------------------------------------------------------------------


def test_the_beams_template_is_the_seeds_equation_13_and_its_entries_are_timoshenkos() -> None:
    E, G, L, A, J, I2, I3, k2, k3 = sp.symbols("E G L A J I_2 I_3 kappa_2 kappa_3", positive=True)
    k = beam_compliance()
    textbook = sp.zeros(6, 6)
    textbook[0, 0], textbook[3, 3] = L / (E * A), L / (G * J)
    textbook[1, 1] = L**3 / (3 * E * I3) + k2 * L / (G * A)
    textbook[2, 2] = L**3 / (3 * E * I2) + k3 * L / (G * A)
    textbook[4, 4], textbook[5, 5] = L / (E * I2), L / (E * I3)
    textbook[1, 5] = textbook[5, 1] = L**2 / (2 * E * I3)
    textbook[2, 4] = textbook[4, 2] = -(L**2) / (2 * E * I2)
    assert (k - textbook).applyfunc(sp.simplify) == sp.zeros(6, 6)
    stars = ["*.....", ".*...*", "..*.*.", "...*..", "..*.*.", ".*...*"]
    assert beam_pattern() == tuple(tuple(c == "*" for c in row) for row in stars)
    numbers = k.subs({E: 2, G: 1, L: 1, A: 1, J: 1, I2: 1, I3: 2, k2: 1, k3: 1})
    assert numbers.is_positive_definite


def test_a_users_own_template_and_the_built_in_ones_decide_which_terms_stay() -> None:
    table = to_table(load("planar2r"))
    rows = ["*.....", ".*...*", "......", "......", "......", ".*...*"]
    table["template"] = [{"name": "flat", "pattern": rows}]
    table["base"]["link"] = {"template": "rigid"}
    table["joint"][0]["link"]["template"], table["joint"][1]["link"]["template"] = "flat", "full"
    robot = from_table(table)
    assert pattern(robot, "flat")[1] == (False, True, False, False, False, True)
    names = [p.name for p in reduce(robot).full]
    assert names[:5] == ["c1", "k1_11", "k1_22", "k1_26", "k1_66"]
    assert len(names) == 5 + 21


# --- M4 and M5 by their definitions ----------------------------------------------------------------------

CLASSES = [
    ("kuka_kr270", "gravity", "pose"),
    ("kuka_kr270", "wrench", "pose"),
    ("scara", "force", "position"),
]


@pytest.mark.parametrize(("name", "loads", "measure"), [*CLASSES, ("planar2r", "gravity", "pose")])
def test_groups_and_blocks_are_what_the_seed_defines(name: str, loads: str, measure: str) -> None:
    r = reduce(load(name), loads, measure)
    names, A, p = [x.name for x in r.full], columns(r), r.partition

    def of(group: Any) -> np.ndarray:
        return A[:, [names.index(n) for n in group]]

    everything = rank(A)
    assert everything == p.rank == rank(of(p.kept)) == len(p.kept)
    assert sorted([*p.g1, *p.g2, *p.g3]) == sorted(names)
    for n in names:  # G1: without it the rank falls; G2: no influence; G3: neither
        without = rank(of([m for m in names if m != n]))
        group = "G1" if without < everything else "G2" if not of([n]).any() else "G3"
        assert n in {"G1": p.g1, "G2": p.g2, "G3": p.g3}[group]
    assert rank(of(p.g1)) == len(p.g1)
    assert rank(of(p.g3)) == everything - len(p.g1)
    # M5a: (a) disjoint, (b) no member raises its block's rank, (c) every member of another block does
    assert sorted(n for block in p.blocks for n in block) == sorted(p.g3)
    for block in p.blocks:
        own = rank(of(block))
        assert all(rank(of([m for m in block if m != n])) == own for n in block)
        others = [n for n in p.g3 if n not in block]
        assert all(rank(of([*block, n])) > own for n in others)
    assert sum(rank(of(block)) for block in p.blocks) == rank(of(p.g3))


def test_blocks_split_where_groups_are_independent() -> None:
    """Condition (a) with more than one block: a planar arm's in-plane and out-of-plane terms do not mix."""
    p = reduce(load("planar2r"), "wrench", "pose").partition
    assert len(p.blocks) > 1


# --- M5b and M5c -----------------------------------------------------------------------------------------


def test_what_is_preferred_stays_and_what_is_avoided_goes_where_ranks_allow() -> None:
    usual = reduce(KR270, "gravity")
    gone = list(usual.partition.couplings)[:3]
    wished = reduce(KR270, "gravity", prefer=gone)
    assert set(gone) <= set(wished.parameters)
    assert wished.partition.rank == usual.partition.rank
    assert (wished.partition.g1, wished.partition.g2, wished.partition.g3) == (
        usual.partition.g1,
        usual.partition.g2,
        usual.partition.g3,
    )
    assert_couplings_hold(wished)
    avoided = reduce(KR270, "gravity", avoid=["k1_66", "k0_35"])
    assert "k1_66" not in avoided.parameters
    assert "k0_35" in avoided.parameters  # identifiable alone: nothing else can stand for it
    with pytest.raises(UserError, match="no parameter 'k9_11'"):
        reduce(KR270, prefer=["k9_11"])


def test_physical_sense_keeps_joint_like_rotations_before_bending_and_diagonals_before_couplings() -> None:
    r = reduce(KR270, "wrench", "pose")
    like_joints = {"k0_44", "k1_66", "k2_66", "k3_44", "k4_55", "k5_44"}  # the diagonals along joints 1 to 6
    axis = {f"k{i}_{3 + m}{3 + m}" for i, m in zip(range(6), (3, 3, 3, 1, 2, 1), strict=True)}
    assert len(axis & set(r.parameters)) == 6 or like_joints <= set(r.parameters)
    for e, row in r.partition.couplings.items():
        if e[-1] == e[-2]:  # a diagonal term goes only where no coupling term could have gone instead
            assert all(k[-1] == k[-2] for k in row)


REDUCTION = reduce(KR270, "gravity")
values = st.floats(-1e-5, 1e-5, allow_nan=False)


@given(
    st.lists(values, min_size=26, max_size=26), st.lists(values, min_size=30, max_size=30), st.integers(0, 99)
)
@settings(max_examples=25, deadline=None)
def test_full_and_reduced_sets_are_inverse_for_any_constants_and_predict_the_same(
    reduced: list[float], constants: list[float], seed: int
) -> None:
    r = REDUCTION
    known = dict(zip(r.parameters, reduced, strict=True))
    fixed = dict(zip((p.name for p in r.full if p.name not in r.parameters), constants, strict=True))
    full = r.full_values(known, fixed)
    assert {n: full[n] for n in fixed} == fixed
    back = r.reduced_values(full)
    np.testing.assert_allclose([back[n] for n in r.parameters], reduced, atol=1e-18)
    full_A, kept_A = programs()
    q, w = samples(KR270, 3, seed, "gravity")
    w *= 1000.0
    one = evaluate_numpy(full_A, q=q, w=w)["A"] @ np.array([full[p.name] for p in r.full])
    two = evaluate_numpy(kept_A, q=q, w=w)["A"] @ np.array(reduced)
    np.testing.assert_allclose(one, two, atol=1e-13)


_PROGRAMS: list[Program] = []


def programs() -> list[Program]:
    """Observation programs of the KR 270's π′ and π″."""
    if not _PROGRAMS:
        for parameters in (REDUCTION.full, REDUCTION.kept):
            names = tuple(p.name for p in parameters)
            _PROGRAMS.append(observation_program(ElasticChain(KR270), terms_of(parameters), names))
    return _PROGRAMS


def test_a_constant_can_be_given_only_to_what_was_eliminated() -> None:
    known = dict.fromkeys(REDUCTION.parameters, 0.0)
    with pytest.raises(UserError, match="'k0_35' is no eliminated parameter"):
        REDUCTION.full_values(known, {"k0_35": 1.0})
    with pytest.raises(UserError, match="'k7_11' is no parameter after M3"):
        REDUCTION.reduced_values({"k7_11": 1.0})
