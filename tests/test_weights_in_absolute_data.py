"""Absolute positions of a robot whose links have weight: the model that is written holds for loads at the tool."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.calibration.absolute import fit_absolute
from symstiff.calibration.doubts.point import find_point
from symstiff.calibration.experiment.current import settled
from symstiff.calibration.fits.decomposition import column_space
from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import Truth, clean_response, nominal_truth
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.calibration.tables.writing import write_table
from symstiff.discrepancy.bridge.growth import fit
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel, joints_only, load_model
from symstiff.reduction.reduce import reduce
from symstiff.report.folder import write_report
from symstiff.report.law_plots import draw_law
from symstiff.report.residuals import draw_residuals
from symstiff.robot import Robot, from_table, load
from symstiff.robot.table import to_table
from symstiff.symbolic.numeric import forward

SIGMA = 2e-5
UR10_A, UR10_D = (0, -0.612, -0.5723, 0, 0, 0), (0.1273, 0, 0, 0.163941, 0.1157, 0.0922)
UR10_ALPHA = (np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0)
MASS = (7.778, 12.93, 3.87, 1.96, 1.96, 0.202)
COM = (
    (0.021, 0, 0.027),
    (0.38, 0, 0.158),
    (0.24, 0, 0.068),
    (0, 0.007, 0.018),
    (0, 0.007, 0.018),
    (0, 0, 0.03),
)


def heavy() -> Robot:
    robot = load("ur10")
    assert any(joint.link.mass for joint in robot.joint)
    return robot


def experiment(robot: Robot, seed: int, kind: str, noise: float) -> tuple[Truth, object]:
    rng = np.random.default_rng(seed)
    poses, levels = 30, (0.0, 0.5, 1.0)
    q = np.array([[rng.uniform(*j.range) for j in robot.joint] for _ in range(poses)])
    force = rng.normal(size=(poses, 6)) * [60, 60, 60, 0, 0, 0]
    w = np.concatenate([f * s for f in force for s in levels]).reshape(-1, 6)
    values = {n: v * float(np.exp(0.3 * rng.normal())) for n, v in nominal_truth(robot).items()}
    truth, q = Truth(robot, values, ()), np.repeat(q, 3, axis=0)
    read = clean_response(truth, q, w, {"kind": kind})
    read[:, :3] += noise * rng.normal(size=(len(q), 3))
    read[:, 3:] += 2 * noise * rng.normal(size=(len(q), 3))
    sigma = np.hstack([np.full((len(q), 3), SIGMA), np.full((len(q), 3), 2 * SIGMA)])
    table = measurements(
        q,
        w,
        values=read,
        sigma=sigma,
        pose=np.repeat(np.arange(poses), 3),
        kind=kind,
        joint_units=["rad"] * 6,
    )
    return truth, table


@pytest.mark.parametrize("way", ["diagnosis", "identification"])
def test_the_values_are_those_that_loads_at_the_tool_show(way: str) -> None:
    robot = heavy()
    truth, table = experiment(robot, 3, "absolute", SIGMA)
    start = StiffnessModel.of(reduce(robot, "force", "pose"))
    model = fit(start, table).model if way == "diagnosis" else identify(robot, table, start).model
    _, fresh = experiment(robot, 11, "deflection", 0.0)
    loads = replace(fresh, w=0.3 * fresh.w)
    wanted = clean_response(truth, loads.q, loads.w, {"kind": "deflection"})[:, :3]
    found = model.deflection(loads.q, loads.w)[:, :3]
    error = float(np.sqrt(np.mean((found - wanted) ** 2)))
    assert error < 0.05 * float(np.sqrt(np.mean(wanted**2)))


@pytest.mark.slow
def test_absolute_data_of_a_heavy_arm_say_that_model_and_code_leave_its_weight_out() -> None:
    robot = heavy()
    for kind, told in (("absolute", 1), ("deflection", 0)):
        _, table = experiment(robot, 3, kind, SIGMA)
        start = StiffnessModel.of(reduce(robot, "force", "pose"))
        remarks = (identify(robot, table, start).remarks, diagnose(Task(robot, table, start)).remarks)
        assert [sum("own weight bends the arm" in r for r in said) for said in remarks] == [told, told]


def test_no_column_is_the_rounding_of_others() -> None:
    """Such a column is a direction by chance: it takes a degree of freedom, another one at every call."""
    robot = heavy()
    _, table = experiment(robot, 3, "absolute", SIGMA)
    start = StiffnessModel.of(reduce(robot, "force", "pose"))
    one = column_space(settled(start, table).A)
    other = column_space(settled(start, replace(table, q=table.q + 1e-13)).A)
    assert one.shape == other.shape
    assert np.linalg.norm(one - other @ (other.T @ one), axis=0) == pytest.approx(0.0, abs=1e-6)


def frames(q: np.ndarray) -> list[np.ndarray]:
    """The UR10's frames 0 … 6, (4, 4) each, written down from its DH table."""
    found = [np.eye(4)]
    for theta, a, d, alpha in zip(q, UR10_A, UR10_D, UR10_ALPHA, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        row = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        found.append(found[-1] @ np.array(row))
    return found


def bent(
    q: np.ndarray, compliance: dict[int, float], point: np.ndarray, force: np.ndarray, gap: float = 0.0
) -> np.ndarray:
    """(3,) position of a point on the UR10's flange whose joints give way under the links' weight and a force there.

    Joint 3 has a ``gap`` besides, that turns over within a newton metre.
    """
    f, turned = frames(q), np.array(q)
    tip = f[6][:3, 3] + f[6][:3, :3] @ point
    for j, c in compliance.items():
        axis, origin = f[j - 1][:3, 2], f[j - 1][:3, 3]
        arms = (f[i + 1][:3, 3] + f[i + 1][:3, :3] @ np.array(COM[i]) - origin for i in range(j - 1, 6))
        moments = (-9.80665 * m * np.cross(axis, arm)[2] for m, arm in zip(MASS[j - 1 :], arms, strict=True))
        load = sum(moments) + axis @ np.cross(tip - origin, force)
        turned[j - 1] += c * load + (gap / 2 * np.tanh(load) if j == 3 else 0.0)
    moved = frames(turned)[6]
    return np.asarray(moved[:3, 3] + moved[:3, :3] @ point)


def probed(
    compliance: dict[int, float], probe: tuple[float, float, float], stated: bool = True, noise: float = SIGMA
) -> Measurements:
    """Positions of a probe that the robot file does not tell, of a UR10 with joint offsets of a milliradian."""
    rng = np.random.default_rng(5)
    q, offset = rng.uniform(-2.5, 2.5, (200, 6)), 1e-3 * rng.normal(size=6)
    read = np.array([bent(row + offset, compliance, np.array(probe), np.zeros(3)) for row in q])
    read += noise * rng.normal(size=read.shape)
    values = np.hstack([read, np.full((len(q), 3), np.nan)])
    sigma = np.where(np.isfinite(values), noise, np.nan) if stated else None
    w, units = np.zeros((len(q), 6)), ["rad"] * 6
    return measurements(q, w, values=values, sigma=sigma, kind="absolute", joint_units=units)


@pytest.mark.parametrize("stated", [True, False], ids=["stated", "no sigma"])
@pytest.mark.parametrize("probe", [(0.0, 0.0, 0.0934), (0.1, 0.0, 0.15)])
def test_a_probe_that_nobody_told_of_leaves_the_compliances_right(
    probe: tuple[float, float, float], stated: bool
) -> None:
    truth = {2: 8e-6, 3: 9e-6}
    found = identify(heavy(), probed(truth, probe, stated), "joints")
    for j, c in truth.items():
        assert abs(found.model.values[f"c{j}"] - c) < 4 * found.model.deviations[f"c{j}"] < 1e-6
    assert any("mm from the tool centre point" in remark for remark in found.remarks)
    assert found.training.after["positional"].rms < 1.2 * SIGMA * np.sqrt(3)


def gapped(q: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(3,) position of the tool centre point with a gap of 0.4 mrad in joint 3."""
    return bent(q, {2: 8e-6, 3: 9e-6}, np.zeros(3), force, 4e-4)


def with_gap() -> Measurements:
    """Positions under loads that turn the third gear's load over, of the arm above."""
    rng, poses, shares = np.random.default_rng(2), 40, (0.0, 0.5, 1.0)
    q = np.repeat(rng.uniform(-2, 2, (poses, 6)), len(shares), axis=0)
    sides = np.repeat([1.0 if k % 2 else -1.0 for k in range(poses)], len(shares))
    force = (sides * np.tile(shares, poses))[:, None] * np.array([20.0, -30.0, -60.0])
    read = np.array([gapped(row, f) for f, row in zip(force, q, strict=True)])
    values = np.hstack([read + 1e-5 * rng.normal(size=read.shape), np.full((len(q), 3), np.nan)])
    w, pose = np.hstack([force, np.zeros((len(q), 3))]), np.repeat(np.arange(poses), len(shares))
    return measurements(q, w, values=values, pose=pose, kind="absolute", joint_units=["rad"] * 6)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["diagnosis", "identification", "identified again"])
def test_a_gap_found_under_the_arms_weight_turns_over_where_the_whole_load_does(
    way: str, tmp_path: Path
) -> None:
    """What the written model says of a load at the tool counts the weight that the gear carries besides."""
    robot, table = heavy(), with_gap()
    gap = EffectInstance("backlash", {"joint": 3}, {"width": 1.0})
    if way == "diagnosis":
        found = diagnose(Task(robot, table, "joints"))
        picture = draw_law(found, found.named[0])
        assert picture is not None
        assert "τ is the joint's whole load" in picture.caption
        model = found.model
    else:
        model = identify(robot, table, joints_only(robot, "force", "position").with_effect(gap)).model
        if way == "identified again":
            model.save(tmp_path / "model.toml")
            model = identify(robot, table, load_model(tmp_path / "model.toml")).model
    assert [(e.effect, e.where) for e in model.effects] == [("backlash", {"joint": 3})]
    assert model.values["backlash_3_gap"] == pytest.approx(4e-4, rel=0.05)
    loaded = np.flatnonzero(table.w.any(axis=1))
    moved = [gapped(q, w[:3]) - gapped(q, 0 * w[:3])
             for q, w in zip(table.q[loaded], table.w[loaded], strict=True)]  # fmt: skip
    error = model.deflection(table.q[loaded], table.w[loaded])[:, :3] - moved
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 1e-5


def geometry_alone(table: Measurements, probe: tuple[float, float, float]) -> float:
    """What DH constants, probe and placement leave of positions, rms [m]: columns by differences of own kinematics."""

    def position(q: np.ndarray, p: np.ndarray) -> np.ndarray:
        T = np.eye(4)
        for k in range(6):
            theta, a, d, alpha = np.array([q[k], UR10_A[k], UR10_D[k], UR10_ALPHA[k]]) + p[4 * k : 4 * k + 4]
            c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
            c2, s2 = np.cos(p[24 + k]), np.sin(p[24 + k])  # a turn about y, for parallel axes
            row = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
            T = T @ np.array(row) @ np.array([[c2, 0, s2, 0], [0, 1, 0, 0], [-s2, 0, c2, 0], [0, 0, 0, 1]])
        x = T[:3, 3] + T[:3, :3] @ (np.array(probe) + p[30:33])
        return np.asarray(x + p[33:36] + np.cross(p[36:39], x))

    nominal, steps = np.zeros(39), 1e-6 * np.eye(39)
    y = np.concatenate([x - position(q, nominal) for q, x in zip(table.q, table.values[:, :3], strict=True)])
    A = np.vstack([[(position(q, h) - position(q, -h)) / 2e-6 for h in steps] for q in table.q])
    A = A.reshape(len(table.q), 39, 3).transpose(0, 2, 1).reshape(-1, 39)
    left = y - A @ np.linalg.lstsq(A, y, rcond=1e-8)[0]
    return float(np.sqrt(3 * np.mean(left**2)))


def test_what_geometry_alone_leaves_of_positions_stands_beside_what_the_model_leaves() -> None:
    """Most of what a fit removes is placement and geometry, which no model holds: it is no deflection compensated."""
    probe = (0.1, 0.0, 0.15)
    table = probed({2: 8e-5, 3: 9e-5}, probe)
    result = identify(heavy(), table, "joints")
    residuals = result.training
    assert residuals.geometry is not None
    assert residuals.geometry["positional"].rms == pytest.approx(geometry_alone(table, probe), rel=0.02)
    assert residuals.geometry["positional"].rms > 3 * residuals.after["positional"].rms
    assert residuals.to_dict()["compensated"] is None
    by_pose = draw_residuals(result).axes[3]
    shown = {line.get_label(): np.sqrt(np.mean(line.get_ydata() ** 2)) for line in by_pose.lines}
    assert shown["placed, rigid and uncalibrated"] == pytest.approx(1e3 * residuals.before["positional"].rms)
    assert shown["geometry and compliances"] == pytest.approx(1e3 * residuals.after["positional"].rms)


def test_a_compliance_that_positions_do_not_tell_is_zero_everywhere_or_nowhere() -> None:
    found = identify(heavy(), probed({2: 8e-6, 3: 9e-6}, (0.0, 0.0, 0.0934), noise=1e-3), "joints")
    zero = {n for n in found.model.parameters if found.model.values[n] == 0.0}
    assert "c5" in zero
    assert not zero & set(found.model.deviations)
    assert not zero & set(found.fit.names)
    told = next(r for r in found.remarks if "sizes that no arm has" in r)
    assert all(name in told for name in zero)
    for j, c in {2: 8e-6, 3: 9e-6}.items():
        assert abs(found.model.values[f"c{j}"] - c) < 4 * found.model.deviations[f"c{j}"]


def test_of_positions_no_deflection_is_said_to_be_compensated(run: Run, tmp_path: Path) -> None:
    write_table(probed({2: 8e-6, 3: 9e-6}, (0.0, 0.0, 0.0934)), tmp_path / "data.csv")
    done = run("identify", "ur10", tmp_path / "data.csv", "--start", "joints", "-o", tmp_path / "model.toml")
    assert done.code == 0
    assert "compensated" not in done.out
    assert "geometry alone" in done.out
    undetermined = next(line for line in done.out.splitlines() if line.startswith("│ geometry_5_6"))
    assert undetermined.split("│")[2:4] == ["           – ", "       – "]  # no value, rather than one of many
    assert "inf" not in done.out


@pytest.mark.slow
@pytest.mark.parametrize(("start", "noise"), [("complete", 5e-3), ("complete", 2e-4), ("joints", 1e-3)])
def test_a_diagnosis_writes_no_compliances_that_geometry_hides(
    start: str, noise: float, tmp_path: Path
) -> None:
    """A geometry that is off looks like compliances of any size in positions of an arm that carries nothing."""
    found = diagnose(
        Task(heavy(), probed({2: 8e-6, 3: 9e-6}, (0.0, 0.0, 0.0934), noise=noise), start, max_poses=60)
    )
    write_report(found, tmp_path / "report")
    model = load_model(tmp_path / "report" / "model.toml")
    q = np.array([[0.2, -1.0, 1.4, -0.5, 1.2, 0.1]])
    moved = model.of_robot().deflection(q, [[0.0, 0.0, -50.0, 0.0, 0.0, 0.0]])[0, :3]
    assert (
        np.linalg.norm(moved) < 3e-3
    )  # c2 and c3 are told to a half and to their size, the others not at all
    told = [r for r in found.remarks if "not determined by these positions" in r]
    assert len(told) == 1
    nothing_left = noise == 5e-3
    lacks = "is no model of the robot under loads" if nothing_left else "part under loads until loaded poses"
    assert lacks in told[0]
    assert (tmp_path / "report" / "code").exists() != nothing_left


def test_rounding_does_not_choose_what_positions_tell() -> None:
    """Rows in another order are summed with other roundings: the same compliances and constants stand."""
    table = probed({2: 8e-6, 3: 9e-6}, (0.0, 0.0, 0.0))
    model = StiffnessModel.of(reduce(heavy(), "force", "position"))
    turned = table.select(np.arange(len(table))[::-1])
    one, other = (fit_absolute(model, t) for t in (table, turned))
    assert one.fit.names == other.fit.names
    assert set(one.known) == set(other.known)


def test_a_model_whose_tool_is_the_measured_point_is_read_again(run: Run, tmp_path: Path) -> None:
    probe, (data, model) = (0.0, 0.0, 0.0934), (tmp_path / n for n in ("data.csv", "model.toml"))
    write_table(probed({2: 8e-6, 3: 9e-6}, probe), data)
    assert run("identify", "ur10", data, "--start", "joints", "-o", model).code == 0
    first = load_model(model)
    assert first.robot.tool.xyz != load("ur10").tool.xyz
    again = tmp_path / "again.toml"
    assert run("identify", "ur10", data, "--start", model, "-o", again).code == 0
    second = load_model(again)
    assert second.file_tool == first.file_tool == (0.0, 0.0, 0.0)
    assert dict(second.values) == pytest.approx(dict(first.values), rel=1e-3, abs=1e-9)
    made = run("generate", "ur10", "--model", model, "-o", tmp_path / "code", "--no-compile")
    assert made.code == 0
    assert "tool centre point is the point that was measured" in " ".join((made.out + made.err).split())


def test_tables_that_do_not_tell_the_point_refuse_a_model_of_another(run: Run, tmp_path: Path) -> None:
    robot, data, model = heavy(), tmp_path / "data.csv", tmp_path / "model.toml"
    probed_model = identify(robot, probed({2: 8e-6, 3: 9e-6}, (0.0, 0.0, 0.0934)), "joints").model
    probed_model.save(model)
    _, table = experiment(robot, 11, "deflection", SIGMA)
    write_table(table, data)
    x, y, z = probed_model.robot.tool.xyz
    refused = run("identify", "ur10", data, "--start", model, "-o", tmp_path / "new.toml")
    assert_users_mistake(refused, f"xyz = [{float(x):g}, {float(y):g}, {float(z):g}] under [tool]")
    told = load("ur10").model_copy(update={"tool": probed_model.robot.tool})
    assert identify(told, table, probed_model).model.robot == probed_model.robot


def test_the_point_of_a_small_arm_is_found_by_a_share_of_its_reach() -> None:
    """4 mm beside the tool are a twelfth of a 50 mm arm, and what a calibration finds of one of 1.3 m."""
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (30, 6))
    for scale, found in ((0.04, True), (1.0, False)):
        raw = to_table(load("ur10"))
        for joint in raw["joint"]:
            joint["a"], joint["d"] = (float(Fraction(str(joint.get(k, 0)))) * scale for k in ("a", "d"))
        robot = from_table(raw, "small")
        T = forward(robot, q)
        values = np.full((30, 6), np.nan)
        values[:, :3] = T[:, :3, 3] + T[:, :3, :3] @ np.array([3.0e-3, 0.0, 2.65e-3])
        table = measurements(q, np.zeros((30, 6)), values=values, kind="absolute")
        model, remark = find_point(StiffnessModel.of(reduce(robot, "gravity", "position")), table, robot)
        assert remark.startswith("the measured point stands 4.0 mm from") == found
        assert (model.robot != robot) == found
