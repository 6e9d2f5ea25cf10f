"""A model that was reduced for joints that stand still says where it holds, in every file that it writes."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.calibration.identify import identify
from symstiff.calibration.tables.measurements import measurements
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only, load_model
from symstiff.reduction.physical import physical_stages
from symstiff.reduction.reduce import reduce
from symstiff.reduction.remarks import reduction_remarks
from symstiff.robot import load

ROBOT = "ur10"


def test_only_joints_that_matter_are_said_to_stand_still() -> None:
    """The last joint turns nothing that a vertical load bends, and without links the first does not either."""
    assert list(reduce(load(ROBOT), "gravity", "pose", {2: -1, 6: "0.3"}).standing) == [2]
    assert reduce(load(ROBOT), "gravity", "pose").standing == {}
    assert joints_only(load(ROBOT), "gravity", "pose", {1: 0, 6: 0}).fixed == {}


def test_what_is_kept_holds_where_the_joints_stood_alone() -> None:
    """Fitted to the complete arm where q2 and q3 stand still, the model gives it there and nowhere else."""
    robot, fixed = load(ROBOT), {2: -1.0, 3: 1.2}
    model = StiffnessModel.of(reduce(robot, "gravity", "pose", fixed))
    assert model.fixed == fixed
    full = physical_stages(robot)[-1].parameters
    rng = np.random.default_rng(1)
    truth = StiffnessModel(
        robot, full, "gravity", values={p.name: rng.uniform(0.5, 1.5) * 1e-8 for p in full}
    )
    q, w = rng.uniform(-2, 2, (60, 6)), np.zeros((60, 6))
    w[:, 2] = -100.0
    there = q.copy()
    there[:, 1:3] = [-1.0, 1.2]
    table = measurements(there, w, values=truth.deflection(there, w), kind="deflection")
    found = identify(robot, table, model).model
    wanted = truth.deflection(there, w)
    np.testing.assert_allclose(found.deflection(there, w), wanted, atol=1e-9 * np.abs(wanted).max())
    assert np.abs(found.deflection(q, w) - truth.deflection(q, w)).max() > 1e-3 * np.abs(wanted).max()


@pytest.mark.slow
def test_the_file_and_the_hash_tell_where_the_joints_stood(tmp_path: Path) -> None:
    models = [
        StiffnessModel.of(reduce(load(ROBOT), "gravity", "pose", fixed))
        for fixed in (None, {2: -1.0, 3: 1.2}, {2: -0.5, 3: 0.7})
    ]
    assert len({m.structure_hash for m in models}) == 3
    for m in models:
        m.save(tmp_path / "model.toml")
        again = load_model(tmp_path / "model.toml")
        assert (again.fixed, again.structure_hash) == (m.fixed, m.structure_hash)
    assert "fixed" not in (models[0].save(tmp_path / "m.toml"), (tmp_path / "m.toml").read_text())[1]


@pytest.mark.parametrize("key", ["q9", "2"])
def test_a_joint_that_the_robot_does_not_have_cannot_stand_still(tmp_path: Path, key: str) -> None:
    StiffnessModel.of(reduce(load(ROBOT), "gravity", "pose", {2: -1.0})).save(tmp_path / "model.toml")
    text = (tmp_path / "model.toml").read_text()
    assert "q2 = -1.0" in text
    (tmp_path / "model.toml").write_text(text.replace("q2 = -1.0", f"{key} = -1.0"))
    with pytest.raises(UserError, match=f"fixed: ur10 has no joint '{key}'"):
        load_model(tmp_path / "model.toml")


@pytest.mark.slow
def test_code_and_compensation_say_it(run: Run, tmp_path: Path) -> None:
    where = ("--loads", "gravity", "--fixed", "q2=-1,q3=1.2", "--targets", "c", "--no-compile")
    folder = tmp_path / "code"
    assert run("generate", ROBOT, *where, "-o", str(folder)).code == 0
    assert "q2 = -1, q3 = 1.2 (rad, m), and hold there alone" in (folder / "ur10.h").read_text()
    assert "q2 = -1, q3 = 1.2 (rad, m) alone" in (folder / "README.md").read_text()
    assert json.loads((folder / "manifest.json").read_text())["options"]["fixed"] == {"q2": -1.0, "q3": 1.2}
    example = re.search(r"q\[UR10_N_JOINTS\] = \{(.*)\};", (folder / "main.c").read_text())
    assert example is not None
    assert [float(x) for x in example[1].split(",")][1:3] == [-1.0, 1.2]
    model = load_model(folder / "model.toml")
    model.with_values(dict.fromkeys(model.parameters, 1e-8)).save(tmp_path / "m.toml")
    head = ",".join(f"q{k}[rad]" for k in range(1, 7))
    for name, q3, told in (("there", 1.2, False), ("elsewhere", 0.5, True)):
        way = tmp_path / f"{name}.csv"
        way.write_text(f"{head},fz[N]\n0.3,-1,{q3},0.2,0.4,0.1,-50\n")
        done = run("compensate", str(tmp_path / "m.toml"), str(way), "-o", str(tmp_path / "out.csv"))
        assert done.code == 0, done.err
        assert ("was reduced for q3 = 1.2 rad" in " ".join(done.out.split())) == told


@pytest.mark.parametrize("degrees", [{5: 90.0}, {2: 17.3, 3: 72.7}])
def test_angles_of_a_table_in_degrees_stand_for_themselves(degrees: dict[int, float]) -> None:
    """Decimals of radians would part what a right angle keeps together: the rank of many poses tells."""
    robot, fixed = load("kuka_kr270"), {j: float(np.radians(a)) for j, a in degrees.items()}
    reduction = reduce(robot, "gravity", "pose", fixed)
    full = StiffnessModel(robot, physical_stages(robot)[-1].parameters, "gravity")
    rng = np.random.default_rng(2)
    q, w = rng.uniform(-2, 2, (40, 6)), np.zeros((40, 6))
    w[:, 2] = -1000.0
    for joint, value in fixed.items():
        q[:, joint - 1] = value
    A = full.observation(q, w)
    A = A.reshape(-1, A.shape[-1])
    size = np.linalg.norm(A, axis=0)
    A = A[:, size > 1e-12 * size.max()] / size[size > 1e-12 * size.max()]
    assert reduction.partition.rank == np.linalg.matrix_rank(A, tol=1e-9)
    assert len(reduction.parameters) == reduction.partition.rank


@pytest.mark.parametrize(
    ("fixed", "doubted"),
    [
        ({5: "1.5708"}, 'q5 standing still at 1.5708 rad, not quite pi/2: where that is meant, write "pi/2"'),
        ({2: "0.5236", 3: "-0.5236", 5: "0.5236"}, "q2, q5 standing still at 0.5236 rad, not quite pi/6"),
        ({3: 1e-5}, 'q3 standing still at 1e-05 rad, not quite 0: where that is meant, write "0"'),
        ({5: "pi/2"}, ""),
        ({5: "1.5707963268"}, ""),
        ({5: 3 * math.pi / 2}, ""),
        ({5: "0.3", 3: "1.57"}, ""),
    ],
)
def test_a_joint_that_stands_nearly_square_is_doubted(fixed: dict[int, str], doubted: str) -> None:
    told = [r for r in reduction_remarks(reduce(load("kuka_kr270"), "gravity", fixed=fixed)) if "still" in r]
    assert any(doubted in r for r in told) if doubted else not told


def test_a_slide_that_stands_still_is_no_angle() -> None:
    robot = load("scara")
    assert robot.joint[2].prismatic
    assert not any("still" in r for r in reduction_remarks(reduce(robot, "gravity", fixed={3: 1e-4})))


def test_a_table_of_rounded_radians_is_refused_by_the_name_of_the_joint(run: Run, tmp_path: Path) -> None:
    """The fifth joint of a wrist at a right angle, printed with four digits: of the same poses degrees are enough."""
    rng = np.random.default_rng(4)
    q = rng.uniform([-3, -2, -1.5, -3, 0, -3], [3, 0, 2, 3, 0, 3], (25, 6))
    (tmp_path / "truth.toml").write_text('format = 1\nrobot = "kuka_kr270"\n[noise]\nsigma_mm = 0.02\n')
    for unit, size, square in (("rad", 1.0, "1.5708"), ("deg", 180 / np.pi, "90")):
        rows = [[*(f"{x * size:.4f}" for x in row[:4]), square, f"{row[5] * size:.4f}"] for row in q]
        lines = [f"a{k},{','.join(row)},-2500,{p}" for k, row in enumerate(rows) for p in ("p1", "p2", "p3")]
        head = ",".join(["pose", *(f"q{j}[{unit}]" for j in range(1, 7)), "fz[N]", "point"])
        (tmp_path / "poses.csv").write_text("\n".join([head, *lines]) + "\n")
        data, model = tmp_path / f"{unit}.csv", tmp_path / f"{unit}.toml"
        done = run("simulate", tmp_path / "truth.toml", "--poses", tmp_path / "poses.csv", "-o", data)
        assert done.code == 0, done
        done = run("identify", "kuka_kr270", data, "-o", model)
        if unit == "rad":
            assert_users_mistake(done, "symstiff: q5 standing still at 1.5708 rad", "in a table degrees")
        else:
            assert done.code == 0, done
            assert "standing" not in done.out
