"""The library of robots, both DH conventions, exact numbers."""

from __future__ import annotations

import copy
import json
import math
import pickle
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import Exact, Robot, elementary_chain, from_table, library, load, parse, parse_exact
from symstiff.robot.table import to_table

# --- frames, written here from the definitions, with nothing of the package -------------------------------


def turn(axis: str, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    frame = np.eye(4)
    frame[i, i] = frame[j, j] = c
    frame[i, j], frame[j, i] = -s, s
    return frame


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    frame = np.eye(4)
    frame[:3, 3] = x, y, z
    return frame


def placed(placement: Any) -> np.ndarray:
    roll, pitch, yaw = map(float, placement.rpy)
    return shift(*map(float, placement.xyz)) @ turn("z", yaw) @ turn("y", pitch) @ turn("x", roll)


def pose_by_definition(robot: Robot, q: list[float]) -> np.ndarray:
    """The tool's pose from the file's rows, each convention by its textbook formula."""
    pose = placed(robot.base)
    for joint, value in zip(robot.joint, q, strict=True):
        theta, d = float(joint.theta), float(joint.d)
        theta, d = (theta, d + value) if joint.prismatic else (theta + value, d)
        screw_x = turn("x", float(joint.alpha)) @ shift(x=float(joint.a))
        screw_z = turn("z", theta) @ shift(z=d)
        pose = pose @ (screw_x @ screw_z if robot.convention == "modified" else screw_z @ screw_x)
    return pose @ placed(robot.tool)


def pose_by_chain(robot: Robot, q: list[float]) -> np.ndarray:
    """The tool's pose as the product of the elementary motions of the standard chain."""
    chain = elementary_chain(robot)
    pose = np.eye(4)
    for motion in chain.base:
        pose = pose @ moved(motion.kind, float(motion.value))
    for row, value in zip(chain.rows, q, strict=True):
        pose = pose @ moved("rz", float(row.theta) + (0 if row.prismatic else value))
        pose = pose @ moved("tz", float(row.d) + (value if row.prismatic else 0))
        pose = pose @ moved("tx", float(row.a)) @ moved("rx", float(row.alpha))
    for motion in chain.tool:
        pose = pose @ moved(motion.kind, float(motion.value))
    return pose


def moved(kind: str, value: float) -> np.ndarray:
    return turn(kind[1], value) if kind[0] == "r" else shift(**{kind[1]: value})


# --- the library -----------------------------------------------------------------------------------------


def test_the_library_has_the_nine_robots_that_the_project_promises() -> None:
    assert library() == (
        "abb_irb6640",
        "franka_panda",
        "kuka_kr240",
        "kuka_kr270",
        "planar2r",
        "puma560",
        "scara",
        "ur10",
        "ur5e",
    )


@pytest.mark.parametrize("name", library())
def test_every_robot_of_the_library_says_where_its_numbers_come_from_and_what_it_can_do(name: str) -> None:
    robot = load(name)
    assert robot.name == name
    assert robot.title
    assert robot.source
    assert all(joint.limits is not None for joint in robot.joint)
    assert all(link.beam_axis is not None for link in robot.links)
    assert 0.5 < robot.reach < 4


@pytest.mark.parametrize("name", library())
def test_every_robot_of_the_library_has_three_markers_that_are_not_in_line(name: str) -> None:
    p, q, r = (np.array([float(x) for x in marker.xyz]) for marker in load(name).marker)
    assert np.linalg.norm(np.cross(q - p, r - p)) > 1e-4


# Positions of the flange that the manufacturers' drawings and manuals give, worked out by hand.
HAND_WORKED = [
    ("abb_irb6640", [0] * 6, (0.32 + 1.392 + 0.2, 0, 0.78 + 1.075 + 0.2)),
    ("franka_panda", [0] * 7, (0.088, 0, 0.333 + 0.316 + 0.384 - 0.107)),
    ("kuka_kr240", [0] * 6, (0.35 + 1.25 + 1.1 + 0.23, 0, 0.75 - 0.055)),
    (
        "kuka_kr240",
        [0, -math.pi / 2, math.pi / 2, 0, 0, 0],
        (0.35 + 1.1 + 0.23, 0, 0.75 + 1.25 - 0.055),
    ),
    ("planar2r", [0, math.pi / 2], (1, 0.7, 0)),
    ("puma560", [0] * 6, (0.4318 + 0.0203, -0.15005, 0.6718 + 0.4318 + 0.05625)),
    ("scara", [0, 0, 0.1, 0], (0.325 + 0.275, 0, 0.387 - 0.1)),
    ("ur10", [0] * 6, (-0.612 - 0.5723, -0.163941 - 0.0922, 0.1273 - 0.1157)),
    ("ur5e", [0] * 6, (-0.425 - 0.3922, -0.1333 - 0.0996, 0.1625 - 0.0997)),
]


@pytest.mark.parametrize(("name", "q", "position"), HAND_WORKED)
def test_the_flange_stands_where_the_drawing_has_it(name: str, q: list[float], position: Any) -> None:
    np.testing.assert_allclose(pose_by_chain(load(name), q)[:3, 3], position, atol=1e-12)


def test_the_published_joint_stiffnesses_of_the_kr_240_are_read_as_compliances() -> None:
    stiffness = [1 / joint.compliance for joint in load("kuka_kr240").joint]
    np.testing.assert_allclose(stiffness, [1.4098e6, 4.0076e5, 9.3528e5, 3.60e5, 3.70e5, 3.80e5])


# --- both conventions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", library())
def test_the_standard_chain_of_a_library_robot_is_the_chain_of_its_file(name: str) -> None:
    robot = load(name)
    rng = np.random.default_rng(5)
    for _ in range(3):
        q = [float(rng.uniform(*joint.range)) for joint in robot.joint]
        np.testing.assert_allclose(pose_by_chain(robot, q), pose_by_definition(robot, q), atol=1e-12)


lengths = st.integers(-20, 20).map(lambda n: f"{n}/10")
angles = st.integers(-12, 12).map(lambda n: f"{n}*pi/12")
placements = st.fixed_dictionaries({"xyz": st.tuples(*[lengths] * 3), "rpy": st.tuples(*[angles] * 3)})
dh_rows = st.fixed_dictionaries(
    {
        "type": st.sampled_from(["revolute", "prismatic"]),
        "a": lengths,
        "d": lengths,
        "alpha": angles,
        "theta": angles,
    }
)
robots = st.fixed_dictionaries(
    {
        "format": st.just(1),
        "name": st.just("any"),
        "convention": st.sampled_from(["standard", "modified"]),
        "base": placements,
        "tool": placements,
        "joint": st.lists(dh_rows, min_size=1, max_size=7),
    }
).map(from_table)


@settings(max_examples=60, deadline=None)
@given(robot=robots, q=st.lists(st.floats(-3, 3), min_size=7, max_size=7))
def test_a_modified_file_is_the_same_chain_regrouped(robot: Robot, q: list[float]) -> None:
    q = q[: robot.dof]
    np.testing.assert_allclose(pose_by_chain(robot, q), pose_by_definition(robot, q), atol=1e-10)


def test_a_row_of_the_standard_chain_takes_its_shape_from_the_next_modified_row() -> None:
    rows = elementary_chain(load("franka_panda")).rows
    assert [float(row.a) for row in rows] == [0, 0, 0.0825, -0.0825, 0, 0.088, 0]
    assert [row.alpha.pi * 2 for row in rows] == [-1, 1, 1, -1, 1, 1, 0]
    assert rows[0].d == Exact(Fraction(333, 1000))


# --- exact numbers ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "rational", "pi"),
    [
        ("-pi/2", 0, Fraction(-1, 2)),
        ("π", 0, 1),
        ("2*(1/3 - 0.5)", Fraction(-1, 3), 0),
        ("--3", 3, 0),
        (".5e-3", Fraction(1, 2000), 0),
        ("pi*3/4+1", 1, Fraction(3, 4)),
        (" 7 ", 7, 0),
        (0.1, Fraction(1, 10), 0),
        (-3, -3, 0),
    ],
)
def test_numbers_and_expressions_are_read_exactly(text: Any, rational: Any, pi: Any) -> None:
    assert parse_exact(text) == Exact(Fraction(rational), Fraction(pi))


fractions = st.fractions(max_denominator=10**6).filter(lambda f: abs(f) < 10**6)


@settings(deadline=None)
@given(fractions, fractions)
def test_an_exact_number_survives_being_written_and_read(rational: Fraction, pi: Fraction) -> None:
    number = Exact(rational, pi)
    assert parse_exact(str(number)) == number
    assert float(number.sympy()) == pytest.approx(float(number), rel=1e-12, abs=1e-9)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "()",
        "1+",
        "*2",
        "2pi",
        "pi pi",
        "1 2",
        "(1",
        "1)",
        "__import__('os')",
        "q",
        "1**2",
        "1//2",
        "e",
        "0x10",
        "pie",
        "1e",
        "١",
        "1,5",
        "sin(1)",
        "1;2",
        "1_0",
        "a.b",
        "[1]",
        "\x00",
        "(" * 150,
        "-" * 199,
        "1" * 201,
    ],
)
def test_what_is_no_expression_is_refused(text: str) -> None:
    with pytest.raises(UserError, match=r"cannot read .* as a number: use"):
        parse_exact(text)


@pytest.mark.parametrize(
    "value",
    [
        "1e999999999",
        "1e-999999999",
        "1e300*1e300",
        "1e300*pi*1e300",
        "inf",
        "-nan",
        "Infinity",
        float("inf"),
        float("nan"),
        10**5000,
        -(10**400),
        Fraction(10**400),
    ],
    ids=lambda value: str(value) if isinstance(value, str | float) else "huge",
)
def test_a_number_that_no_computer_number_can_hold_is_refused(value: Any) -> None:
    with pytest.raises(UserError, match="finite number"):
        parse_exact(value)


@pytest.mark.parametrize("value", ["pi*pi", "1/pi", "1/0", "1/(1-1)"])
def test_arithmetic_that_leaves_the_exact_numbers_is_refused(value: str) -> None:
    with pytest.raises(UserError, match=r"multiple of pi|multiples of pi|division by zero"):
        parse_exact(value)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.__setitem__("11", 1.0),
        lambda d: d.__delitem__("66"),
        lambda d: d.update({"11": 1.0}),
        lambda d: d.setdefault("11", 1.0),
        lambda d: d.pop("66"),
        lambda d: d.popitem(),
        lambda d: d.clear(),
        lambda d: d.__ior__({"11": 1.0}),
    ],
)
def test_the_values_of_a_robot_and_of_a_model_are_read_only(change: Callable[[Any], Any]) -> None:
    table = to_table(load("planar2r"))
    table["joint"][0]["link"] = {"compliance": {"66": 1e-7}}
    robot = from_table(table)
    model = StiffnessModel.of(reduce(load("planar2r"), "gravity"))
    for shared in (
        robot.joint[0].link.compliance,
        load("planar2r").base.link.compliance,
        model.values,
        model.deviations,
    ):
        before = dict(shared)
        with pytest.raises(TypeError, match="read-only"):
            change(shared)
        assert shared == before


def test_read_only_values_equal_copy_pickle_and_serialise_as_others() -> None:
    table = to_table(load("planar2r"))
    table["joint"][0]["link"] = {"compliance": {"66": 1e-7}}
    robot = from_table(table)
    for same in (
        copy.copy(robot),
        copy.deepcopy(robot),
        pickle.loads(pickle.dumps(robot)),
        robot.model_copy(deep=True),
    ):
        assert same == robot
        assert same.joint[0].link.compliance == {"66": 1e-7}
        with pytest.raises(TypeError):
            same.joint[0].link.compliance["66"] = 1.0
    assert type(robot.model_dump()["joint"][0]["link"]["compliance"]) is dict
    assert from_table(to_table(robot)) == robot
    model = StiffnessModel.of(reduce(load("planar2r"), "gravity")).with_values(
        {"k1_55": 2e-7}, {"k1_55": 1e-9}
    )
    for other in (copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        assert other == model
    assert json.loads(json.dumps(model.values)) == {"k1_55": 2e-7}


GANTRY = """
format = 1
name = "gantry"
[[joint]]
type = "prismatic"
a = 0
alpha = 0
d = 0
limits = [-0.5, 3.0]
[[joint]]
a = 0.4
alpha = 0
d = 0.3
[joint.link.compliance]
{entries}
[tool]
xyz = [0, 0, 0.2]
"""


def test_a_slide_reaches_as_far_as_its_stroke() -> None:
    robot = parse(GANTRY.format(entries="").encode())
    assert robot.reach == pytest.approx(0.5 + 0.2 + 3.0)


@pytest.mark.parametrize("coupling", ["3.9e-8", "-3.9e-8", "4e-8"])
def test_a_coupling_within_what_an_elastic_body_allows_is_taken(coupling: str) -> None:
    robot = parse(GANTRY.format(entries=f"22 = 2e-8\n66 = 8e-8\n26 = {coupling}").encode())
    assert robot.links[2].compliance["26"] == float(coupling)


def test_a_coupling_beyond_it_is_refused_whatever_its_sign() -> None:
    for coupling in ("4.1e-8", "-4.1e-8"):
        with pytest.raises(UserError, match="entry 26: of an elastic body"):
            parse(GANTRY.format(entries=f"22 = 2e-8\n66 = 8e-8\n26 = {coupling}").encode())
