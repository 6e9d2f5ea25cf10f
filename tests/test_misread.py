"""Tables that are written in another way than told: they are asked about, and no effect is named for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from symstiff.calibration.doubts.axes import against_loads
from symstiff.calibration.doubts.slips import Reading, joint_hint, marker_hint
from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.errors import UserError
from symstiff.report.words import headline, sentence
from symstiff.robot import load
from tests.blind.generate import Options, case
from tests.diagnosis_data import ROBOT, design, measured


def diagnosed(table: Measurements) -> Finding:
    return diagnose(Task(load(ROBOT), table))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["deflection", "absolute"])
@pytest.mark.parametrize("names", [("p2", "p1", "p3"), ("p3", "p1", "p2")])
def test_exchanged_markers_are_asked_about(
    kind: Literal["deflection", "absolute"], names: tuple[str, ...]
) -> None:
    truth = Truth(load(ROBOT), nominal_truth(load(ROBOT)), noise=Noise((0.02,) * 3))
    table = simulate(truth, replace(design(), kind=kind), 3)
    assert diagnosed(table).verdict == "nothing_missing"
    found = diagnosed(replace(table, points=names))
    assert not found.testable
    read = ", ".join(f"{a} as {b}" for a, b in zip(names, table.points, strict=True) if a != b)
    assert f"markers look exchanged: to read {read}" in found.reason
    if kind == "deflection":
        said = identify(load(ROBOT), replace(table, points=names)).remarks
        assert any("markers look exchanged" in remark for remark in said)
        assert not any("exchanged" in remark for remark in identify(load(ROBOT), table).remarks)


@pytest.mark.parametrize("kind", ["deflection", "absolute"])
@pytest.mark.parametrize(("joint", "sign", "quarters", "told"), [(2, -1, 0, "-q2"), (2, 1, 1, "q2 - 90 deg")])
def test_a_joint_that_is_read_in_another_way_is_asked_about(
    kind: Literal["deflection", "absolute"], joint: int, sign: int, quarters: int, told: str
) -> None:
    """A table whose column has the other sign, or another zero: no effect is named for it."""
    truth = Truth(load(ROBOT), nominal_truth(load(ROBOT)), noise=Noise((0.02,) * 3))
    table = simulate(truth, replace(design(), kind=kind), 3)
    wrong = replace(table, q=Reading(joint, sign, quarters).of(table.q))
    found = diagnosed(wrong)
    assert not found.testable
    assert "a joint looks read in another way: " in found.reason
    assert f" {told} for q{joint} " in found.reason
    assert (" or q2 - 90 deg" in found.reason) == (
        quarters == 1 and kind == "deflection"
    )  # half a turn is alike
    assert "correct the order, signs and zeros of the table's joints" in found.reason
    if kind == "deflection":
        assert any("looks read in another way" in remark for remark in identify(load(ROBOT), wrong).remarks)
        assert not any("another way" in remark for remark in identify(load(ROBOT), table).remarks)


def in_tool_axes(rows: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Vectors side by side in the axes of the planar arm's tool, which stands at q1 + q2 about z."""
    angle = -q.sum(axis=1)
    c, s, out = np.cos(angle), np.sin(angle), rows.copy()
    for k in (0, 3):
        out[:, k] = c * rows[:, k] - s * rows[:, k + 1]
        out[:, k + 1] = s * rows[:, k] + c * rows[:, k + 1]
    return out


@pytest.mark.parametrize("start", ["complete", "joints"])
@pytest.mark.parametrize("what", ["the loads", "the deflections", "loads and deflections"])
def test_a_table_in_the_axes_of_the_tool_is_asked_about(what: str, start: str) -> None:
    """As a sensor at the flange writes them: no effect is named for it, and no model is made of it unasked."""
    truth = Truth(load(ROBOT), nominal_truth(load(ROBOT)), noise=Noise((0.02,) * 3))
    table = simulate(truth, design(), 3)
    w = in_tool_axes(table.w, table.q) if "loads" in what else table.w
    values = in_tool_axes(table.values, table.q) if "deflections" in what else table.values
    wrong = replace(table, w=w, values=values)
    found = diagnose(Task(load(ROBOT), wrong, start))
    assert not found.testable
    assert headline(found) == "The table has to be corrected first"
    assert sentence(found).startswith("Nothing is tested before the table is right: ")
    hint = f"{what} look told in another way: turning them from the tool's axes to the base's would leave "
    assert hint in found.reason
    assert f"correct the table: its {what.removeprefix('the ')} are read in the base's axes" in found.reason
    assert any(hint in remark for remark in identify(load(ROBOT), wrong).remarks)
    assert not any("in another way" in remark for remark in identify(load(ROBOT), table).remarks)


def turned(rows: np.ndarray, degrees: float) -> np.ndarray:
    """Vectors turned about z."""
    return in_tool_axes(rows, np.full((len(rows), 1), -np.radians(degrees)))


@pytest.mark.slow
def test_no_table_is_doubted_for_little_that_the_model_leaves_of_it() -> None:
    """A sensor that is turned and a frame that drifts: a frame turned by 34 degrees would leave 53 % of that, too."""
    hidden = case(25, Options(seed=1699, classes=("two",), shares=(1.0,), lambdas=(60.0,)))
    assert diagnose(Task(hidden.model.robot, hidden.table)).testable


CHANGES: dict[str, tuple[str, Callable[[np.ndarray], np.ndarray], int]] = {
    "the deflections look told in another way from pose p6 on: the other sign of dy would":
        ("values", lambda rows: rows * [1, -1, 1, 1, 1, 1], 5),
    "the deflections look told in another way from pose p5 on: x and y exchanged would":
        ("values", lambda rows: rows[:, [1, 0, 2, 4, 3, 5]], 4),
    "the loads look told in another way from pose p7 on: the other sign of fx would":
        ("w", lambda rows: rows * [-1, 1, 1, 1, 1, 1], 6),
    "the loads look told in another way: turning them by 90 deg about z would":
        ("w", lambda rows: turned(rows, -90.0), 0),
    "the deflections look told in another way: turning them by 30.0 deg about (0.00, 0.00, 1.00) would":
        ("values", lambda rows: turned(rows, -30.0), 0),
}  # fmt: skip


@pytest.mark.parametrize("told", CHANGES)
def test_signs_and_axes_that_are_others_throughout_or_from_a_pose_on_are_asked_about(told: str) -> None:
    """As after a change of the device, or of who wrote: no drift, bad poses or crosstalk are named for it."""
    truth = Truth(load(ROBOT), nominal_truth(load(ROBOT)), noise=Noise((0.002,) * 3))
    table = simulate(truth, design(), 3)
    column, change, since = CHANGES[told]
    rows = getattr(table, column)
    wrong = replace(table, **{column: np.where((table.pose >= since)[:, None], change(rows), rows)})
    found = diagnosed(wrong)
    assert not found.testable
    assert told in found.reason


@pytest.mark.parametrize("degrees", [90, -90])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_quarter_turn_is_told_as_the_turn_that_corrects_it(axis: str, degrees: int) -> None:
    """An arm whose joints turn about all axes: the planar one's columns tell no signs."""
    robot, rng = load("ur10"), np.random.default_rng(4)
    planned = measurements(
        rng.uniform(-2.0, 2.0, (40, 6)), rng.normal(size=(40, 6)) * [90, 90, 90, 30, 30, 30]
    )
    table = simulate(Truth(robot, nominal_truth(robot), noise=Noise((0.002,) * 3)), planned, 3)
    back = Rotation.from_euler(axis, -degrees, degrees=True).as_matrix()
    wrong = replace(table, w=np.hstack([table.w[:, :3] @ back.T, table.w[:, 3:] @ back.T]))
    hint = f"the loads look told in another way: turning them by {degrees} deg about {axis} would"
    assert any(hint in remark for remark in identify(robot, wrong).remarks)


@pytest.mark.parametrize("kind", ["deflection", "absolute"])
def test_joints_whose_columns_are_exchanged_are_asked_about(kind: Literal["deflection", "absolute"]) -> None:
    truth = Truth(load(ROBOT), nominal_truth(load(ROBOT)), noise=Noise((0.02,) * 3))
    table = simulate(truth, replace(design(), kind=kind), 3)
    found = diagnosed(replace(table, q=table.q[:, ::-1]))
    assert not found.testable
    assert "a joint looks read in another way: q1 for q2 and q2 for q1 would leave " in found.reason


def test_a_joint_has_to_fit_far_better_otherwise_and_a_slide_has_no_quarter_turns() -> None:
    q = np.arange(12.0).reshape(6, 2)

    def left(best: float, freedom: int = 40) -> Callable[[np.ndarray], tuple[float, int]]:
        return lambda read: (best if np.array_equal(read, Reading(2, -1, 0).of(q)) else 4.0, freedom)

    assert joint_hint(q, (True, False), left(0.01)).endswith("-q2 for q2 would leave 5 % of the residual")
    assert joint_hint(q, (True, True), left(2.0)) == joint_hint(q, (True, True), left(0.01, 10)) == ""
    tried: list[np.ndarray] = []

    def seen(read: np.ndarray) -> tuple[float, int]:
        tried.append(read)
        return 1.0, 40

    joint_hint(q, (False, True), seen)
    assert sum(not np.array_equal(read[:, 0], q[:, 0]) for read in tried) == 1  # the slide's sign
    assert sum(not np.array_equal(read[:, 1], q[:, 1]) for read in tried) == 7


def test_of_many_markers_two_may_be_exchanged() -> None:
    told = tuple("abcdef")
    wrong = ("a", "e", "c", "d", "b", "f")
    hint = marker_hint(told, lambda names: (4e-8 if names == wrong else 4.0, 20))
    assert hint == "markers look exchanged: to read b as e, e as b would leave 0 % of the residual"
    assert marker_hint(told, lambda names: (1.0, 20)) == ""
    assert marker_hint(told, lambda names: (4e-8 if names == wrong else 4.0, 19)) == ""
    assert marker_hint(told, lambda names: (0.0, 99)) == ""
    assert marker_hint(("tcp",), lambda names: (1.0, 99)) == ""


@pytest.mark.slow
def test_what_rounding_and_a_few_readings_leave_exchanges_no_markers() -> None:
    for seed in range(12):
        table = measured(seed=seed)
        few = table.select(np.flatnonzero((table.pose == 0) & (table.w[:, 0] == table.w[0, 0])))
        assert "exchanged" not in diagnosed(few).reason


KUKA = load("kuka_kr270")


def under_weight(sign: float) -> Measurements:
    """Deflections under a vertical force, dz told with a sign."""
    robot, rng = load("kuka_kr270"), np.random.default_rng(6)
    limits = np.array([j.range for j in robot.joint])
    w = np.zeros((30, 6))
    w[:, 2] = -2000.0
    plan = measurements(rng.uniform(limits[:, 0], limits[:, 1], (30, robot.dof)), w)
    table = simulate(Truth(robot, nominal_truth(robot), (), Noise((0.02,) * 3)), plan, 6)
    values = np.array(table.values)
    values[:, 2] *= sign
    return replace(table, values=values)


@pytest.mark.parametrize("start", ["joints", "complete"])
def test_an_arm_that_gives_way_upwards_under_weights_is_not_identified(start: str) -> None:
    assert against_loads(KUKA, under_weight(1.0)) == ""
    turned = under_weight(-1.0)
    assert against_loads(KUKA, turned) == "dz or fz"
    with pytest.raises(UserError, match=r"point against their loads.*look at the sign of dz or fz"):
        identify(load("kuka_kr270"), turned, start)
    assert diagnose(Task(load("kuka_kr270"), turned, start)).last.doubtful


def test_work_is_asked_of_forces_alone() -> None:
    """A moment may push the point against the force."""
    turned = under_weight(-1.0)
    w = np.array(turned.w)
    w[:, 4] = 300.0
    assert against_loads(KUKA, replace(turned, w=w)) == ""
    unread = np.array(turned.values)
    unread[:, 2] = np.nan
    assert against_loads(KUKA, replace(turned, values=unread)) == ""
