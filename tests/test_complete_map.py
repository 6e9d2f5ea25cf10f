"""Complete parameters and the identifiable set that stands for them."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.reduction.complete import complete_map, known_values, left_out
from symstiff.reduction.physical import physical_stages
from symstiff.robot import load
from symstiff.robot.loading import from_table
from symstiff.robot.table import to_table


def _inclined():
    """The planar arm with full links inclined to their DH axes, an elastic pedestal."""
    table = to_table(load("planar2r"))
    table["base"] = {"link": {"beam_axis": [3, 0, 4], "template": "full"}}
    for joint in table["joint"]:
        joint["alpha"] = "-pi/2"
        joint["link"] = {"beam_axis": [4, 0, 3], "template": "full"}
    return from_table(table, "inclined")


def _oblique(link):
    """A KR 270 one of whose beams runs between its DH axes: its template lacks a part of the joint after it."""
    table = to_table(load("kuka_kr270"))
    table["joint"][link - 1]["link"]["beam_axis"] = ["7/20", 0, "27/40"]
    for joint in table["joint"]:
        joint["compliance"] = 1e-6
    return from_table(table, f"oblique{link}")


def _loads(rng, kind, n):
    w = np.zeros((n, 6))
    w[:, {"gravity": [2], "force": [0, 1, 2], "wrench": [0, 1, 2, 3, 4, 5]}[kind]] = 1.0
    return w * rng.normal(0.0, 1000.0, (n, 6))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["gravity", "force", "wrench"])
@pytest.mark.parametrize(
    "robot",
    [load("kuka_kr270"), load("planar2r"), load("scara"), _inclined(), *map(_oblique, (1, 3, 4))],
    ids=lambda r: r.name,
)
def test_the_identifiable_set_predicts_what_links_and_joints_apart_predict(robot, kind):
    rng = np.random.default_rng(3)
    reduction = reduce(robot, kind, "pose")
    complete = reduction.stages[2]
    pi = rng.uniform(0.5, 1.5, len(complete.names)) * 1e-6
    q = np.array([[rng.uniform(*j.range) for j in robot.joint] for _ in range(6)])
    w = _loads(rng, kind, 6)
    apart = StiffnessModel(robot, complete.parameters, values=dict(zip(complete.names, pi, strict=True)))
    reduced = StiffnessModel.of(
        reduction, dict(zip(reduction.parameters, complete_map(reduction) @ pi, strict=True))
    )
    expected = apart.deflection(q, w)
    np.testing.assert_allclose(reduced.deflection(q, w), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("link", [1, 3, 4])
def test_what_the_robot_file_states_predicts_what_its_joints_do(link):
    rng = np.random.default_rng(4)
    robot = _oblique(link)
    q = np.array([[rng.uniform(*j.range) for j in robot.joint] for _ in range(6)])
    w = _loads(rng, "gravity", 6)
    joints = [p for p in physical_stages(robot)[2].parameters if p.is_joint]
    expected = StiffnessModel(robot, tuple(joints), values={p.name: 1e-6 for p in joints}).deflection(q, w)
    found = StiffnessModel.of(reduce(robot, "gravity")).deflection(q, w)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def _between(compliance):
    """An arm whose second joint is oblique to the beam before it; link 2's springs stand for it all the same."""
    table = to_table(load("planar2r"))
    table["base"] = {"link": {"beam_axis": "x"}}
    first, second = table["joint"]
    first |= {"a": 0.5, "alpha": "pi/4", "d": 0.2, "link": {"beam_axis": [5, 3, 4]}}
    second |= {"a": 0.4, "alpha": "-pi/2", "d": 0.1, "compliance": compliance, "link": {"beam_axis": "x"}}
    return from_table(table, "between")


def test_a_joint_that_other_links_stand_for_gives_them_round_values_and_no_dust():
    """By hand: joint 2 turns about −y of frame 2, 0.4 m away: k2_55 = c, k2_35 = −0.4·c, k2_33 = 0.16·c.

    Link 2's three translations together move the tool as the pedestal's do: k2_33 = Σ k0 − k2_11 − k2_22.
    """
    c = 2e-6
    found = known_values(reduce(_between(c)))
    expected = dict.fromkeys(("k0_11", "k0_22", "k0_33"), 0.16 * c)
    expected |= {"k2_11": -0.16 * c, "k2_22": -0.16 * c, "k2_35": -0.4 * c, "k2_55": c}
    assert {n: v for n, v in found.items() if v} == expected


def test_a_joint_that_no_load_of_the_class_turns_adds_nothing():
    table = to_table(load("planar2r"))
    table["template"] = [{"name": "rod", "pattern": ["*....."] + ["......"] * 5}]
    for joint in table["joint"]:
        joint |= {"compliance": 1e-6, "link": {"template": "rod"}}
    assert known_values(reduce(from_table(table, "level"), "gravity")) == {}


@pytest.mark.slow
def test_what_the_robot_file_states_is_the_same_to_the_last_digit_on_other_processors():
    program = (
        "from test_complete_map import _oblique; from symstiff.reduction import reduce\n"
        "from symstiff.reduction.complete import known_values; print(known_values(reduce(_oblique(3), 'gravity')))"
    )
    printed = [
        subprocess.run(
            [sys.executable, "-c", program],
            cwd=Path(__file__).parent,
            env={**os.environ, "OPENBLAS_CORETYPE": processor},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for processor in ("Nehalem", "Haswell")
    ]
    assert "k" in printed[0]
    assert printed[0] == printed[1]


def _without_place(**compliances):
    """An arm whose second joint has nothing before it that turns: link 1 is a rod that only lengthens."""
    table = to_table(load("planar2r"))
    table["template"] = [{"name": "rod", "pattern": ["*....."] + ["......"] * 5}]
    table["base"] = {"link": {"beam_axis": "x"}}
    first, second = table["joint"]
    first |= {"alpha": "pi/4", "d": 0.2, "compliance": 1e-6}
    second |= {"alpha": "-pi/2", "d": 0.1}
    first["link"], second["link"] = {"template": "rod"}, {"template": "rigid"}
    second.pop("compliance", None)
    second |= compliances
    return from_table(table, "without_place")


def test_a_stated_compliance_without_a_place_is_left_out_and_changes_no_other_value():
    robot, without = _without_place(compliance=2e-6), _without_place()
    assert reduce(robot).inexact_aggregations == ("c2",)
    found, expected = known_values(reduce(robot)), known_values(reduce(without))
    assert found == expected
    assert {n: v for n, v in found.items() if v} == {
        "k0_66": 1e-6
    }  # joint 1 turns about the pedestal's third axis


def test_the_map_has_no_column_for_a_joint_without_a_place():
    reduction = reduce(_without_place(compliance=2e-6))
    P = complete_map(reduction)
    zero = [n for n, column in zip(reduction.stages[2].names, P.T, strict=True) if not column.any()]
    assert zero == ["c2"]


def test_what_is_left_out_is_told_where_the_file_states_it():
    (told,) = left_out(reduce(_without_place(compliance=2e-6)))
    assert told.startswith("c2: the file's 2e-06 is left out of the values")
    assert left_out(reduce(_without_place())) == []
    assert left_out(reduce(_oblique(3), "gravity")) == []
