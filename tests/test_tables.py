"""Measurement tables: what is read, what is refused and with which line, and that writing gives it back."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from symstiff.calibration.tables.checks import check_robot, without_copies
from symstiff.calibration.tables.measurements import concatenate, measurements
from symstiff.calibration.tables.table import read_poses, read_table, write_table
from symstiff.errors import UserError
from symstiff.robot import from_table, load

GOOD = """\
pose,q1[deg],q2[rad],fx[N],fz[kN],mx[N*m],point,dx[mm],dy[um],dz[m],drx[mrad],sigma_x[mm],time[min],temperature[K],load_step,branch,repeat
a,90,0.5,10,-2.5,3,p1,1,2000,-0.003,1.5,0.01,1,293.15,1,up,1
a,90,0.5,10,-2.5,3,p1,1.1,2100,-0.0031,1.4,0.01,2,294.15,1,up,2
a,90,0.5,10,-2.5,3,p2,1,2000,-0.003,1.5,0.01,,,1,,1
b,-45,-0.5,10,-2.5,3,p1,1,2000,-0.003,1.5,0.02,4,295.15,1,down,1
"""
TWO = {
    "format": 1,
    "name": "two",
    "joint": [{"a": 1, "alpha": 0, "d": 0, "limits": ["-1", "2"]}, {"a": 1, "alpha": 0, "d": 0}],
    "marker": [{"name": "p1", "xyz": [0, 0, 0]}, {"name": "p2", "xyz": [0, 0, "0.1"]}],
}


def save(tmp_path, text, name="data.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(tmp_path, text, read=read_table):
    with pytest.raises(UserError) as error:
        read(save(tmp_path, text))
    message = str(error.value)
    assert "data.csv" in message
    assert "\n" not in message
    return message


def line_of(message):
    return int(re.search(r"line (\d+)", message).group(1))


def test_a_table_is_read_in_si_units(tmp_path):
    table = read_table(save(tmp_path, GOOD))
    assert table.kind == "deflection"
    assert table.labels == ("a", "b")
    assert table.points == ("p1", "p2")
    assert list(table.pose) == [0, 0, 0, 1]
    assert list(table.point) == [0, 0, 1, 0]
    assert table.q[0] == pytest.approx([math.pi / 2, 0.5])
    assert table.w[0] == pytest.approx([10, 0, -2500, 3, 0, 0])
    assert table.values[0, :4] == pytest.approx([1e-3, 2e-3, -3e-3, 1.5e-3])
    assert np.isnan(table.values[0, 4:]).all()
    assert table.sigma[:, 0] == pytest.approx([1e-5, 1e-5, 1e-5, 2e-5])
    assert np.isnan(table.sigma[:, 1:]).all()
    assert table.time[:2] == pytest.approx([60, 120])
    assert np.isnan(table.time[2])
    assert table.temperature[[0, 1, 3]] == pytest.approx([20, 21, 22])
    assert table.branch[[0, 1, 3]] == pytest.approx([1, 1, -1])
    assert np.isnan(table.branch[2])
    assert list(table.repeat) == [1, 2, 1, 1]
    assert table.place(3).endswith("data.csv: line 5")


UNITS = {
    "q1": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180},
    "q2": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "fx": {"N": 1.0, "kN": 1e3},
    "my": {"N*m": 1.0, "kN*m": 1e3, "N*mm": 1e-3, "Nmm": 1e-3, "kNm": 1e3},
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
}


@pytest.mark.parametrize(("column", "unit"), [(c, u) for c, units in UNITS.items() for u in units])
def test_a_column_is_read_in_each_of_its_units(tmp_path, column, unit):
    cells = {"pose": "a", "q1": "rad", "q2": "m", "fz": "N", "dx": "mm"} | {column: unit}
    head = ",".join(c if c == "pose" else f"{c}[{u}]" for c, u in cells.items())
    row = ",".join("a" if c == "pose" else "0.25" for c in cells)
    table = read_table(save(tmp_path, f"{head}\n{row}\n"))
    seen = {
        "q1": table.q[0, 0],
        "q2": table.q[0, 1],
        "fx": table.w[0, 0],
        "my": table.w[0, 4],
        "time": table.time[0],
    }
    assert seen[column] == pytest.approx(0.25 * UNITS[column][unit], rel=1e-12)


def test_absolute_data_have_a_kind_of_their_own_and_need_no_load(tmp_path):
    table = read_table(save(tmp_path, "pose,q1[deg],x[mm],y[mm],z[mm]\na,1,1000,2,3\n"))
    assert table.kind == "absolute"
    assert table.values[0, :3] == pytest.approx([1.0, 0.002, 0.003])
    assert table.points == ("tcp",)


def test_a_line_of_blanks_is_empty(tmp_path):
    assert len(read_table(save(tmp_path, GOOD + "  \n\t\n"))) == 4


def test_a_byte_order_mark_empty_lines_and_windows_line_ends_do_not_disturb(tmp_path):
    text = b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").replace("b,-45", "\r\nb,-45").encode()
    table = read_table(save(tmp_path, text))
    assert len(table) == 4
    assert table.line[-1] == 6


def test_tables_cannot_be_changed_behind_a_callers_back(tmp_path):
    table = read_table(save(tmp_path, GOOD))
    with pytest.raises(ValueError, match="read-only"):
        table.q[0, 0] = 1.0


def test_several_files_are_one_table_and_each_keeps_its_lines(tmp_path):
    one = save(tmp_path, GOOD, "one.csv")
    two = save(tmp_path, GOOD.replace("b,-45,-0.5", "c,-40,-0.5").replace("a,90,0.5", "d,95,0.5"), "two.csv")
    table = read_table([one, two])
    assert len(table) == 8
    assert table.labels == ("a", "b", "d", "c")
    assert table.place(7).endswith("two.csv: line 5")


def test_a_label_for_other_joint_values_in_another_file_is_another_pose(tmp_path):
    """Plans of two campaigns call their poses p1, p2, …"""
    one, two, three = (
        save(tmp_path, GOOD.replace("b,-45", f"b,-{b}"), f"{name}.csv")
        for name, b in (("may", 45), ("june", 40), ("july", 35))
    )
    with pytest.raises(UserError, match=r"june\.csv: line 2: duplicate"):  # pose a is the same in both
        read_table([one, two])
    for path, a in ((two, 85), (three, 80)):
        path.write_text(path.read_text().replace("a,90", f"a,{a}"))
    table = read_table([one, two, three])
    assert table.labels == ("a", "b", "a (june)", "b (june)", "a (july)", "b (july)")


def test_files_of_one_name_are_told_apart_by_their_folders(tmp_path):
    (tmp_path / "old").mkdir()
    one = save(tmp_path, GOOD, "may.csv")
    two = save(tmp_path / "old", GOOD.replace("b,-45", "b,-40").replace("a,90", "a,85"), "may.csv")
    assert read_table([one, two]).labels == ("a", "b", f"a ({two})", f"b ({two})")


def test_a_row_given_in_two_files_names_both(tmp_path):
    one, two = save(tmp_path, GOOD, "one.csv"), save(tmp_path, GOOD, "two.csv")
    with pytest.raises(UserError, match=r"two\.csv: line 2: duplicate of .*one\.csv: line 2"):
        read_table([one, two])
    with pytest.raises(UserError, match=r"one\.csv is given twice"):
        read_table([one, tmp_path / ".." / tmp_path.name / "one.csv"])


def test_tables_may_hold_one_component_each_of_the_same_readings(tmp_path):
    """A device that lost one coordinate: such rows stand in a table without that column."""
    head = "pose,q1[rad],fz[N],{}\na,0.1,-100,{}\nb,0.5,-100,{}\n"
    one = save(tmp_path, head.format("dx[mm]", 0.1, 0.2), "one.csv")
    two = save(tmp_path, head.format("dy[mm],dz[mm]", "0.3,0.5", "0.4,0.6"), "two.csv")
    table = read_table([one, two])
    assert table.measured[:, :3].tolist() == [[True, False, False]] * 2 + [[False, True, True]] * 2
    assert table.labels == ("a", "b")
    three = save(tmp_path, head.format("dz[mm]", 0.5, 0.6), "three.csv")
    with pytest.raises(UserError, match=r"three\.csv: line 2: duplicate of .*two\.csv: line 2"):
        read_table([one, two, three])
    lost = refusal(tmp_path, head.format("dx[mm],dy[mm]", "0.1,", "0.2,0.4"))
    assert (
        "line 2: column dy[mm]: missing value: leave the row out, or move rows without that reading" in lost
    )


def test_equal_loads_of_two_load_steps_are_two_readings(tmp_path):
    head = "pose,q1[rad],fz[N],dx[mm],load_step,branch\n"
    table = read_table(save(tmp_path, head + "a,0,-100,0.10,1,up\na,0,-100,0.12,3,up\n"))
    assert table.load_step.tolist() == [1.0, 3.0]
    again = refusal(tmp_path, head + "a,0,-100,0.10,1,up\na,0,-100,0.12,1,up\n")
    assert "line 3: duplicate of" in again


def test_different_kinds_of_data_do_not_mix(tmp_path):
    one = save(tmp_path, GOOD, "one.csv")
    two = save(tmp_path, "pose,q1[deg],q2[deg],x[mm]\nz,1,2,3\n", "two.csv")
    three = save(tmp_path, "pose,q1[deg],fx[N],dx[mm]\nz,1,2,3\n", "three.csv")
    with pytest.raises(UserError, match=r"two\.csv: line 2: kind of data"):
        read_table([one, two])
    with pytest.raises(UserError, match=r"three\.csv: line 2: joints"):
        read_table([one, three])


def test_poses_need_nothing_measured_and_keep_what_is(tmp_path):
    table = read_poses(save(tmp_path, "pose,q1[deg],fz[N],point\na,10,-5,tcp\n"))
    assert table.kind == "none"
    assert np.isnan(table.values).all()
    assert read_poses(save(tmp_path, GOOD)).kind == "deflection"
    assert "missing" in refusal(tmp_path, "pose,q1[deg],fz[N]\na,10,-5\nb,10,\n", read_poses)


def test_a_trajectory_needs_no_labels_and_may_come_back_to_a_place(tmp_path):
    table = read_poses(save(tmp_path, "q1[deg],fz[N]\n10,-5\n20,-5\n10,-5\n"))
    assert table.labels == ("1", "2", "3")
    assert list(table.pose) == [0, 1, 2]


def test_a_table_is_held_against_its_robot(tmp_path):
    table = read_table(save(tmp_path, GOOD))
    robot = from_table(TWO)
    (warning,) = check_robot(table, robot)
    assert "sigma is stated for translations and not for rotations" in warning
    with pytest.raises(UserError, match="line 2: 2 joint columns, robot kuka_kr270 has 6"):
        check_robot(table, load("kuka_kr270"))
    with pytest.raises(UserError, match="line 4: robot two has no marker 'p2'"):
        check_robot(table, from_table({**TWO, "marker": TWO["marker"][:1]}))
    sliding = from_table({**TWO, "joint": [TWO["joint"][0], {**TWO["joint"][1], "type": "prismatic"}]})
    with pytest.raises(UserError, match="joint 2 of two is prismatic"):
        check_robot(table, sliding)


def test_joints_far_outside_their_limits_and_copied_poses_are_told(tmp_path):
    far = read_table(save(tmp_path, GOOD.replace("b,-45,", "b,-145,")))
    assert any("line 5" in w and "q1" in w for w in check_robot(far, from_table(TWO)))
    copied = GOOD + "c,-45,-0.5,10,-2.5,3,p1,1,2000,-0.003,1.5,0.02,4,295.15,1,down,1\n"
    _, (told,) = without_copies(read_table(save(tmp_path, copied)))
    assert "line 6" in told
    assert "line 5" in told


@pytest.mark.parametrize(("degrees", "doubted"), [(1.5, 1), (6.2, 1), (6.6, 0), (30.0, 0), (100.0, 0)])
def test_degrees_that_never_leave_one_turn_of_radians_are_doubted(tmp_path, degrees, doubted):
    q = np.random.default_rng(0).uniform(-1.0, 0.0, (8, 2)) * degrees
    q[0, 1] = -degrees
    rows = "".join(f"p{k},{a},{b},-100\n" for k, (a, b) in enumerate(q))
    table = read_poses(save(tmp_path, "pose,q1[deg],q2[deg],fz[N]\n" + rows))
    assert sum("write q1[rad]" in w for w in check_robot(table, from_table(TWO))) == doubted


def attempt(path):
    try:
        return read_table(path), ""
    except UserError as error:
        return None, str(error)


def numbers(shape, size):
    return arrays(float, shape, elements=st.floats(-size, size, allow_nan=False))


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_what_is_written_is_read_back(tmp_path_factory, data):
    rows, dof = data.draw(st.integers(1, 6)), data.draw(st.integers(1, 7))
    values = data.draw(numbers((rows, 6), 0.1))
    values[:, data.draw(st.integers(1, 6)) :] = np.nan
    w = data.draw(numbers((rows, 6), 1e4))
    w[np.abs(w) < 1e-20] = 0.0  # nothing feels less, and no table has it
    w[0, 0] = 1.0
    table = measurements(
        data.draw(numbers((rows, dof), 3.0)),
        w,
        pose=range(rows),
        labels=[f"pose, {k}" for k in range(rows)],
        points=("tcp", "p1"),
        point=data.draw(arrays(int, rows, elements=st.integers(0, 1))),
        kind="deflection",
        values=values,
        sigma=np.where(np.isfinite(values), 1e-5, np.nan),
        time=data.draw(numbers(rows, 1e5)),
        branch=data.draw(arrays(float, rows, elements=st.sampled_from([1.0, -1.0, np.nan]))),
        repeat=np.arange(rows),
        joint_units=data.draw(st.lists(st.sampled_from(["rad", "m"]), min_size=dof, max_size=dof)),
    )
    path = tmp_path_factory.mktemp("tables") / "t.csv"
    write_table(table, path, angle=data.draw(st.sampled_from(["rad", "deg"])))
    back = read_table(path)
    assert back.labels == table.labels
    assert back.joint_units == table.joint_units
    assert [back.points[k] for k in back.point] == [table.points[k] for k in table.point]
    for name in ("q", "w", "values", "sigma", "time", "temperature", "load_step", "branch", "repeat"):
        a, b = getattr(table, name), getattr(back, name)
        assert np.allclose(a, b, rtol=1e-13, atol=1e-300, equal_nan=True), name
    again = path.with_name("u.csv")
    write_table(back, again)
    write_table(read_table(again), path)
    assert path.read_bytes() == again.read_bytes()


def test_writing_leaves_nothing_behind_where_it_fails(tmp_path):
    table = measurements([[0.1]], [[1.0, 0, 0, 0, 0, 0]])
    with pytest.raises(UserError, match="cannot write"):
        write_table(table, tmp_path / "missing" / "t.csv")
    (tmp_path / "t.csv").mkdir()
    with pytest.raises(UserError, match="cannot write"):
        write_table(table, tmp_path / "t.csv")
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]


def test_a_component_measured_in_some_rows_only_is_not_written_as_one_table(tmp_path):
    values = np.full((2, 6), np.nan)
    values[0, 0] = 1e-3
    table = measurements([[0.1], [0.2]], np.ones((2, 6)), kind="deflection", values=values)
    with pytest.raises(UserError, match="other rows"):
        write_table(table, tmp_path / "t.csv")
    assert not (tmp_path / "t.csv").exists()


def test_a_sigma_told_in_some_rows_only_is_not_written_as_one_table(tmp_path):
    values = np.full((2, 6), np.nan)
    values[:, 0] = 1e-3
    sigma = np.where(np.arange(2)[:, None] == 0, 1e-5, np.nan) * np.where(np.arange(6) == 0, 1.0, np.nan)
    table = measurements([[0.1], [0.2]], np.ones((2, 6)), kind="deflection", values=values, sigma=sigma)
    with pytest.raises(UserError, match="sigma_x is told in other rows only"):
        write_table(table, tmp_path / "t.csv")
    assert not (tmp_path / "t.csv").exists()


def test_rows_can_be_selected_and_put_together_again(tmp_path):
    table = read_table(save(tmp_path, GOOD))
    halves = concatenate([table.select([0, 2]), table.select([1, 3])])
    assert list(halves.line) == [2, 4, 3, 5]
    assert np.array_equal(halves.values[:, 0], table.values[[0, 2, 1, 3], 0])
    assert list(table.frame()["dx[mm]"]) == pytest.approx([1, 1.1, 1, 1])


def test_a_table_of_16000_poses_with_nine_coordinates_is_read_whole(tmp_path):
    rng = np.random.default_rng(0)
    q = np.repeat(rng.uniform(-2, 2, (16_000, 6)), 3, axis=0)
    values = np.hstack([rng.normal(size=(48_000, 3)) * 1e-3, np.full((48_000, 3), np.nan)])
    table = measurements(
        q, [0, 0, -2500.0, 0, 0, 0], points=("p1", "p2", "p3"), point=np.tile([0, 1, 2], 16_000),
        kind="deflection", values=values,
    )  # fmt: skip
    write_table(table, tmp_path / "big.csv")
    back = read_table(tmp_path / "big.csv")
    assert len(back.labels) == 16_000
    assert np.allclose(back.values[:, :3], values[:, :3], rtol=1e-13, atol=0)


def test_an_empty_point_is_the_tool_centre_point(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("pose,q1[deg],fz[N],point,dz[mm]\na,10,-5,,0.1\na,10,-5,p1,0.2\nb,20,-5,tcp,0.1\n")
    found = read_table(path)
    assert [found.points[k] for k in found.point] == ["tcp", "p1", "tcp"]
