"""What a table is warned of and loses, and above all what it is not: honest rows have to pass unharmed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.tables.checks import check_robot, without_copies, without_zeros
from symstiff.calibration.tables.measurements import Measurements, concatenate, measurements
from symstiff.calibration.tables.table import read_poses, read_table
from symstiff.errors import UserError
from symstiff.robot import Robot, from_table

POSES = np.array([[0.1, 0.2], [0.3, -0.4], [-0.5, 0.6], [0.7, 0.8], [-0.9, 1.0]])
DOWN = np.array([0.0, 0.0, -100.0, 0.0, 0.0, 0.0])


def arm(**second: object) -> Robot:
    first = {"a": 1, "alpha": 0, "d": 0, "limits": [-1.0, 2.0]}
    return from_table({"format": 1, "name": "two", "joint": [first, {"a": 1, "alpha": 0, "d": 0, **second}]})


def deflected(a_newton: float = 1e-6, w: np.ndarray = DOWN, q: np.ndarray = POSES) -> Measurements:
    """A position that gives way down by so many m/N under a load, in every pose."""
    w = np.broadcast_to(w, (len(q), 6))
    values = np.full((len(q), 6), np.nan)
    values[:, :3] = [0.0, 0.0, -100.0 * a_newton]
    return measurements(q, w, kind="deflection", values=values)


def read(folder: Path, head: str, *rows: str) -> Measurements:
    path = folder / "data.csv"
    path.write_text("\n".join((head, *rows)) + "\n")
    return read_table(path)


def test_joint_readings_of_one_pose_may_differ_as_commands_do_not(tmp_path: Path) -> None:
    head = "pose,q1[rad],q2[rad],fz[N],dz[mm]"
    table = read(tmp_path, head, "a,0.1,0.2,-100,0.1", "a,0.1005,0.2,-50,0.05")
    assert table.labels == ("a",)
    with pytest.raises(UserError, match="give each configuration its own label"):
        read(tmp_path, head, "a,0.1,0.2,-100,0.1", "a,0.103,0.2,-50,0.05")


def test_readings_on_the_way_up_and_down_under_one_load_are_two(tmp_path: Path) -> None:
    head = "pose,q1[rad],q2[rad],fz[N],dz[mm],branch"
    assert len(read(tmp_path, head, "a,0.1,0.2,-100,0.1,up", "a,0.1,0.2,-100,0.1,down")) == 2


def test_a_load_of_minus_nothing_is_none(tmp_path: Path) -> None:
    head = "pose,q1[rad],q2[rad],fx[N],fz[N],dz[mm]"
    with pytest.raises(UserError, match="line 3: duplicate of"):
        read(tmp_path, head, "a,0.1,0.2,0,-100,0.1", "a,0.1,0.2,-0,-100,0.2")


@pytest.mark.parametrize(("q1", "far"), [(-1.35, 1), (-1.25, 0), (2.25, 0), (2.35, 1)])
def test_a_joint_is_far_outside_from_a_tenth_of_its_range_on(q1: float, far: int) -> None:
    table = deflected(q=np.vstack([POSES, [[q1, 0.0]]]))
    assert sum("q1 is far outside" in w for w in check_robot(table, arm())) == far


def test_a_slide_has_limits_where_the_file_tells_none_and_a_turning_joint_has_not() -> None:
    q = np.vstack([POSES, [[0.0, 30.0]]])
    table = deflected(q=q)
    assert not any("q2" in w for w in check_robot(table, arm()))
    sliding = replace(table, joint_units=("rad", "m"))
    assert any("q2 is far outside" in w for w in check_robot(sliding, arm(type="prismatic")))


@pytest.mark.parametrize(("a_newton", "odd"), [(5e-9, 1), (2e-8, 0), (1e-7, 0)])
def test_deflections_are_too_small_below_those_of_machine_tools(a_newton: float, odd: int) -> None:
    table = deflected(a_newton)
    assert sum("nm a newton" in w for w in check_robot(table, arm())) == odd


def test_one_row_hides_no_unit_and_makes_none_odd() -> None:
    share = np.array([1.0, 1.0, 1.0, 1.0, 1000.0])[:, None]
    for a_newton, odd in ((1e-9, True), (1e-6, False)):
        table = deflected(a_newton)
        for factor in (share, 1 / share):
            moved = replace(table, values=table.values * factor)
            assert any("nm a newton" in w for w in check_robot(moved, arm())) is odd


def test_each_row_is_held_against_its_own_force_and_moments_are_none() -> None:
    share = np.array([1.0, 1.0, 1.0, 100.0, 100.0])[:, None]
    table = deflected(2e-8)
    assert not check_robot(replace(table, w=table.w * share, values=table.values * share), arm())
    assert not check_robot(deflected(1e-9, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 100.0])), arm())


def test_few_poses_arrays_and_slides_near_zero_are_not_taken_for_radians(tmp_path: Path) -> None:
    def doubted(table: Measurements, robot: Robot) -> bool:
        return any("write q1[rad]" in w for w in check_robot(table, robot))

    path = tmp_path / "poses.csv"
    rows = [f"p{k},{a},{b},-100\n" for k, (a, b) in enumerate(POSES)]
    path.write_text("pose,q1[deg],q2[deg],fz[N]\n" + "".join(rows))
    assert doubted(read_poses(path), arm())
    assert not doubted(deflected(q=POSES / 50), arm())
    path.write_text("pose,q1[deg],q2[deg],fz[N]\n" + "".join(rows[:3]))
    assert not doubted(read_poses(path), arm())
    path.write_text("pose,q1[cm],q2[cm],fz[N]\n" + "".join(rows))
    slide = {"type": "prismatic", "limits": [-2.0, 2.0], "a": 0, "d": 0}
    gantry = {"format": 1, "name": "g", "joint": [{**slide, "alpha": "pi/2"}, {**slide, "alpha": 0}]}
    assert not doubted(read_poses(path), from_table(gantry))


def test_a_pose_copied_under_another_label_is_left_out_and_one_measured_anew_is_not() -> None:
    once, labels = deflected(), tuple(f"again{k}" for k in range(5))
    again = replace(once, labels=labels)
    kept, (told,) = without_copies(concatenate([once, again]))
    np.testing.assert_array_equal(kept.values, once.values)
    assert told.startswith("5 of 5 repeats")
    anew = concatenate([once, replace(again, values=again.values + 1e-6)])
    assert without_copies(anew) == (anew, [])
    kept, (told,) = without_copies(concatenate([anew, again.select([2])]))  # one copy among many repeats
    assert (len(kept), told[:21]) == (10, "1 of 6 repeats read t")


def test_only_rows_that_have_no_load_and_read_nothing_are_left_out() -> None:
    table = deflected()
    w, values = table.w.copy(), table.values.copy()
    w[:2] = 0.0
    values[1:3, :3] = 0.0  # row 1 opens its pose; row 2 is stiff to the last digit
    kept, (remark,) = without_zeros(replace(table, w=w, values=values))
    assert kept.pose.tolist() == [0, 2, 3, 4]
    assert remark.startswith("1 row")
    standing = replace(table, w=w, values=values, kind="absolute")
    assert without_zeros(standing) == (standing, [])


def test_equal_readings_of_other_steps_and_directions_are_no_copies() -> None:
    up = deflected()
    for name in ("branch", "load_step"):
        one, two = (replace(up, **{name: np.full(5, x)}) for x in (1.0, -1.0))
        table = concatenate([one, two])
        assert without_copies(table) == (table, [])


def repeated(grid: float) -> Measurements:
    """300 readings and two repeats of each, with a noise of a micrometre, read to a grid."""
    rows = np.tile(np.arange(5), 180)
    noise = 1e-6 * np.random.default_rng(0).normal(size=(len(rows), 6))
    values, steps = np.round((deflected().values[rows] + noise) / grid) * grid, np.arange(300) // 5
    repeat = np.repeat([1.0, 2.0, 3.0], 300)
    return replace(
        deflected().select(rows), values=values, load_step=np.tile(steps.astype(float), 3), repeat=repeat
    )


def test_repeats_that_coarse_readings_make_equal_are_no_copies() -> None:
    coarse = repeated(3e-6)
    readings = np.column_stack([coarse.pose, coarse.load_step, np.nan_to_num(coarse.values)])
    assert len(np.unique(readings, axis=0)) < 895
    assert without_copies(coarse) == (coarse, [])


def test_a_few_copied_repeats_among_many_are_left_out() -> None:
    honest = repeated(1e-9)
    values = honest.values.copy()
    values[300:330] = values[:30]
    kept, (told,) = without_copies(replace(honest, values=values))
    assert len(kept) == 870
    assert told.startswith("30 of 600 repeats")
