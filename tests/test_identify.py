"""Identification from tables to models: what it recovers, what it refuses, what it remarks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.complete import reconstruct_model
from symstiff.calibration.experiment.readings import experiment_of
from symstiff.calibration.identify import identify
from symstiff.calibration.levels import by_level, levels_of
from symstiff.calibration.rows import equations, predict
from symstiff.calibration.simulation import nominal_truth, simulate, truth_from_table
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.calibration.tables.poses import with_markers
from symstiff.calibration.tables.table import read_table
from symstiff.compensation import compensate, compensate_online
from symstiff.effects.instance import EffectInstance
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, load_model
from symstiff.reduction import reduce
from symstiff.reduction.complete import complete_map
from symstiff.robot import load
from symstiff.robot.loading import parse
from symstiff.symbolic.numeric import forward, joint_jacobian
from tests.diagnosis_data import measured

UR10_DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "ur10" / "series_a.csv"


def poses(robot, n, seed=0):
    rng = np.random.default_rng(seed)
    return np.array([rng.uniform(*j.range, n) for j in robot.joint]).T


def virtual(name="kuka_kr270", n=40, seed=0, force=600.0, **noise) -> Measurements:
    """A virtual experiment with small loads, where the nonlinear robot is nearly the linear one."""
    robot = load(name)
    rng = np.random.default_rng([seed, 1])
    w = np.zeros((n, 6))
    w[:, 2] = rng.choice([-1.0, 1.0], n) * force * rng.uniform(0.5, 1.0, n)
    truth = truth_from_table({"format": 1, "robot": name, "noise": {"sigma_mm": 0.005, **noise}})
    return simulate(truth, with_markers(poses(robot, n, seed), w, ("p1", "p2", "p3")), seed)


@pytest.fixture(scope="module")
def result():
    return identify(load("kuka_kr270"), virtual(), held_out=0.25)


def test_the_complete_model_compensates_nearly_all_of_the_deflection_on_held_out_poses(result) -> None:
    assert len(result.fit.names) == 26
    assert result.validation is not None
    assert result.validation.compensated > 0.97


def test_negative_diagonals_that_stand_for_others_are_said_to_be_sums_unless_physics_bounds_them(
    result,
) -> None:
    told = next(remark for remark in result.remarks if "of parameters with signs" in remark)
    negative = [
        p.name for p in result.reduction.kept if not p.is_coupling and result.model.values[p.name] < 0
    ]
    assert told.partition(":")[0].split(", ") == negative
    physical = identify(load("kuka_kr270"), virtual(), physical=True)
    assert not any("with signs" in remark for remark in physical.remarks)


def test_the_poses_held_out_are_the_same_in_whatever_order_the_rows_stand(result) -> None:
    table = virtual()
    turned = np.arange(len(table.labels))[::-1]
    backwards = replace(table.select(np.arange(len(table))[::-1]), labels=table.labels[::-1])
    backwards = replace(backwards, pose=turned[backwards.pose])
    shuffled = identify(load("kuka_kr270"), backwards, held_out=0.25)
    assert shuffled.held_out is not None
    assert set(shuffled.held_out.labels) == set(result.held_out.labels)
    assert shuffled.validation.after["positional"].rms == pytest.approx(
        result.validation.after["positional"].rms, rel=1e-6
    )


def test_what_is_identified_is_what_the_reduction_says_the_truth_looks_like(result) -> None:
    nominal = nominal_truth(load("kuka_kr270"))
    merged = reduce(load("kuka_kr270"), "gravity", "pose")
    expected = complete_map(merged) @ [nominal.get(n, 0.0) for n in merged.stages[2].names]
    off = (result.fit.values - expected) / result.fit.std
    assert np.abs(off).max() < 5.0


def test_a_saved_model_predicts_the_same(result, tmp_path: Path) -> None:
    result.model.save(tmp_path / "model.toml")
    again = load_model(tmp_path / "model.toml")
    assert np.array_equal(predict(again, result.train), predict(result.model, result.train))
    assert again.deviations == result.model.deviations


def test_a_model_knows_what_joints_and_loads_it_was_fitted_to(result) -> None:
    train, seen = result.train, result.model.seen
    assert list(seen) == [*(f"q{j}" for j in range(1, 7)), "fx", "fy", "fz", "mx", "my", "mz"]
    np.testing.assert_array_equal([seen[f"q{j}"][0] for j in range(1, 7)], train.q.min(axis=0))
    np.testing.assert_array_equal(seen["fz"], (train.w[:, 2].min(), train.w[:, 2].max()))


def test_a_start_is_a_path_too_and_nothing_else(result, tmp_path: Path) -> None:
    result.model.save(tmp_path / "model.toml")
    again = identify(load("kuka_kr270"), virtual(), tmp_path / "model.toml")
    assert again.model.parameters == result.model.parameters
    with pytest.raises(UserError, match="expected a start model, found None"):
        identify(load("kuka_kr270"), virtual(), None)


def test_a_table_of_poses_alone_holds_nothing_measured() -> None:
    table = replace(virtual(), kind="none", values=np.full((120, 6), np.nan))
    with pytest.raises(UserError, match="nothing measured"):
        identify(load("kuka_kr270"), table)


def test_joints_alone_compensate_less_and_have_five_parameters(result) -> None:
    table = virtual()
    joints = identify(load("kuka_kr270"), table, "joints")
    assert joints.fit.names == ("c2", "c3", "c4", "c5", "c6")
    assert joints.training.compensated < result.training.compensated


def test_reconstruction_predicts_what_the_reduced_model_predicts(result) -> None:
    physical = identify(load("kuka_kr270"), virtual(), physical=True)
    complete = reconstruct_model(physical, bounds=False)
    reduction = physical.reduction
    values = dict(zip(complete.names, complete.values, strict=True))
    merged = {n: values[n] for n in reduction.stages[3].names}
    model = StiffnessModel(reduction.robot, reduction.stages[2].parameters, values=values)
    w = np.zeros((5, 6))
    w[:, 2] = -1000.0
    q = poses(reduction.robot, 5, 9)
    expected = physical.model.deflection(q, w)
    assert np.abs(model.deflection(q, w) - expected).max() < 1e-9 * np.abs(expected).max() + 1e-10
    assert merged


def test_a_bad_pose_is_reported_by_the_robust_fit() -> None:
    table = virtual(n=40)
    values = np.array(table.values)
    values[table.pose == 7, :3] += 2e-3
    found = identify(load("kuka_kr270"), replace(table, values=values), robust=True)
    assert found.robust is not None
    assert found.robust.poses
    assert found.robust.poses[0].label.endswith("p8")


def test_swapped_axes_are_hinted_at() -> None:
    table = virtual(n=40)
    values = np.array(table.values)
    values[:, [0, 2]] = values[:, [2, 0]]
    found = identify(load("kuka_kr270"), replace(table, values=values))
    assert any("x" in remark and "z" in remark and "axes" in remark for remark in found.remarks)


def test_fewer_poses_than_needed_names_the_parameters_and_what_would_help() -> None:
    with pytest.raises(UserError, match=r"do not determine the model.*needed"):
        identify(load("kuka_kr270"), virtual(n=2))


def test_an_all_zero_wrench_is_refused() -> None:
    table = virtual(n=20)
    with pytest.raises(UserError, match="wrench is zero"):
        identify(load("kuka_kr270"), replace(table, w=np.zeros_like(table.w)))


def test_a_joint_that_never_moves_reduces_the_model_further() -> None:
    robot = load("kuka_kr270")
    table = virtual(n=40)
    q = np.array(table.q)
    q[:, 5] = 0.3
    design = replace(table, q=q, kind="none", values=np.full_like(table.values, np.nan))
    found = identify(
        robot,
        simulate(
            truth_from_table({"format": 1, "robot": "kuka_kr270", "noise": {"sigma_mm": 0.005}}), design, 0
        ),
    )
    assert len(found.fit.names) < 26
    assert any("q6 never move" in remark for remark in found.remarks)


def test_off_line_compensation_puts_the_loaded_tool_where_it_belongs(result) -> None:
    robot = result.model.robot
    q, w = poses(robot, 6, 4), np.tile([0, 0, -2500.0, 0, 0, 0], (6, 1))
    q[:, 4] = np.where(np.abs(q[:, 4]) < 0.3, 0.5, q[:, 4])
    found = compensate(result.model, q, w)
    assert found.solved.all()
    loaded = forward(robot, found.q_cmd)[:, :3, 3] + result.model.deflection(found.q_cmd, w)[:, :3]
    assert np.abs(loaded - forward(robot, q)[:, :3, 3]).max() < 1e-10
    online = compensate_online(result.model, q, w)
    near = forward(robot, online)[:, :3, 3] + result.model.deflection(online, w)[:, :3]
    deflection = np.abs(result.model.deflection(q, w)[:, :3]).max()
    assert np.abs(near - forward(robot, q)[:, :3, 3]).max() < 0.02 * deflection


def test_absolute_positions_of_a_real_ur10_give_plausible_joint_compliances() -> None:
    if not UR10_DATA.is_file():
        pytest.skip("the real UR10 measurements are not here")
    found = identify(load("ur10"), read_table(UR10_DATA), "joints", loads="wrench")
    values = dict(zip(found.fit.names, found.fit.values, strict=True))
    assert 0.4e-5 < values["c2"] < 1.4e-5
    assert 0.5e-5 < values["c3"] < 1.4e-5
    assert found.training.after["positional"].rms < 0.45e-3
    constants = {n: v for n, v in values.items() if n.startswith("geometry_")}
    assert len(constants) > 20
    assert max(map(abs, constants.values())) < 5e-3
    # the probe stands 0.6 mm beside the last axis: a frame that turns about it would have to turn by 3 rad
    assert {"geometry_6_2", "geometry_6_3"} < set(constants)


def test_a_table_of_arrays_is_identified_as_one_from_a_file() -> None:
    robot = load("scara")
    q = poses(robot, 30)
    w = np.random.default_rng(0).normal(size=(30, 6)) * [100, 100, 100, 10, 10, 10]
    reduction = reduce(robot, "wrench", "pose")
    rng = np.random.default_rng(1)
    values = {n: float(rng.uniform(1e-7, 1e-6)) for n in reduction.parameters}
    model = StiffnessModel.of(reduction, values)
    table = measurements(
        q, w, kind="deflection", values=model.deflection(q, w), joint_units=["rad", "rad", "m", "rad"]
    )
    found = identify(robot, table)
    assert found.fit.names == reduction.parameters
    expected = np.array([values[n] for n in found.fit.names])
    assert np.allclose(found.fit.values, expected, rtol=1e-6, atol=1e-14)


def test_a_bad_pose_in_the_start_model_belongs_to_its_table() -> None:
    model = StiffnessModel.of(reduce(load("planar2r")))
    model = model.with_effect(EffectInstance("bad_poses", {"rows": ["p1"]}))
    with pytest.raises(UserError, match="leave these rows out of the table"):
        identify(load("planar2r"), measured(), model)


def test_a_turned_device_sees_every_point_turned_and_the_equations_are_the_derivative() -> None:
    bare = StiffnessModel.of(reduce(load("scara")))
    bare = bare.with_values(dict.fromkeys(bare.parameters, 2e-6))
    rng = np.random.default_rng(2)
    q, w = rng.uniform(-0.2, 0.2, (6, 4)), rng.normal(size=(6, 6)) * 40
    table = with_markers(q, w, ("p1", "p2", "p3"), ("rad", "rad", "m", "rad"))
    plain = predict(bare, table)
    turned = bare.with_effect(EffectInstance("frame_misalignment", {"measurement": "frame"}))
    names = [p.name for p in turned.effect_parameters]
    delta = np.array([0.002, -0.003, 0.0015])
    turned = turned.with_values(dict(bare.values) | dict(zip(names, delta.tolist(), strict=True)))
    seen = predict(turned, table)
    largest = np.abs(plain[:, :3]).max()
    assert largest > 1e-5
    np.testing.assert_allclose(
        seen[:, :3], plain[:, :3] + np.cross(delta, plain[:, :3]), rtol=0, atol=2e-5 * largest
    )
    read = replace(table, kind="deflection", values=np.where(np.arange(6) < 3, seen, np.nan))
    e, step = equations(turned, read), 1e-4
    for name in names:
        k = turned.parameters.index(name)
        ends = [
            predict(turned, table, dict(turned.values) | {name: turned.values[name] + side * step})
            for side in (1, -1)
        ]
        slope = ((ends[0] - ends[1]) / (2 * step))[e.row, e.component]
        np.testing.assert_allclose(e.A[:, k], slope, rtol=5e-3, atol=1e-3 * np.abs(slope).max())


LEVELS = np.array([-2.2, -1.7, -1.2, -0.7, -0.2])
LIBRARY = Path(__file__).parents[1] / "symstiff" / "robot" / "library"


@pytest.mark.parametrize(
    "link", ['beam_axis = "x"', "beam_axis = [1, 0.3, 0.2]", 'beam_axis = [1, 0.3, 0.2]\ntemplate = "full"']
)
def test_a_compliance_for_each_level_stands_for_the_joints_own_about_whatever_axes_its_link_has(link) -> None:
    """Joint 2's deflection is its Jacobian's column; a common share of its levels may be the link's as well."""
    file = (LIBRARY / "kuka_kr270.toml").read_text().replace('beam_axis = "x"', link, 1)
    robot, rng = parse(file.encode()), np.random.default_rng(0)
    q = np.array([rng.uniform(*j.range, size=80) for j in robot.joint]).T
    level, w = np.arange(80) % 5, np.tile([0.0, 0, -2500, 0, 0, 0], (80, 1))
    q[:, 1] = LEVELS[level]
    model = StiffnessModel.of(reduce(robot, "gravity", "pose"))
    model = model.with_values({n: (0.0 if model.units[n] == "rad/N" else 1e-8) for n in model.parameters})
    column = joint_jacobian(robot, q)[:, :, 1]
    clean = (
        model.deflection(q, w)
        + column * (np.linspace(1e-7, 5e-7, 5)[level] * np.sum(column * w, axis=1))[:, None]
    )
    table = measurements(q, w, kind="deflection", values=clean + 1e-9 * rng.normal(size=(80, 6)))
    fit = identify(robot, table, per_level=2).fit
    levels = [v for n, v in zip(fit.names, fit.values, strict=True) if "compensator" in n]
    np.testing.assert_allclose(np.diff(levels), 1e-7, rtol=1e-4)
    assert (
        len(fit.names) == len(model.parameters) + 4
    )  # five levels, one of which the link's compliances made up


def test_levels_are_what_lies_together() -> None:
    """Encoders scatter, and a value may lie on the edge of any grid."""
    rng = np.random.default_rng(2)
    around = np.repeat([-0.5, 0.1000005, 0.7], 9) + 2e-5 * rng.normal(size=27)
    np.testing.assert_allclose(levels_of(around), [-0.5, 0.1, 0.7], atol=5e-5)
    assert levels_of(np.array([0.3, 0.1, 0.3])).tolist() == [0.1, 0.3]
    through = np.linspace(-2.0, 2.0, 3600)
    assert levels_of(through).tolist() == through.tolist()


def test_the_poses_left_to_fit_are_told_where_they_are_too_few() -> None:
    with pytest.raises(
        UserError, match=r"^held_out: 39 of 40 poses held out, 1 left to fit; the measurements do not"
    ):
        identify(load("kuka_kr270"), virtual(), held_out=0.99)


def test_a_joint_without_a_compensator_is_refused_by_name() -> None:
    with pytest.raises(UserError, match="q3 of kuka_kr270 has none: name q2"):
        identify(load("kuka_kr270"), virtual(n=8), per_level=3)
    with pytest.raises(UserError, match="it has no joint for one"):
        by_level(StiffnessModel.of(reduce(load("scara"))), virtual(n=8), 2)


def test_positions_of_one_marker_beside_the_tool_centre_point_determine_what_they_show() -> None:
    robot, rng = load("kuka_kr270"), np.random.default_rng(1)
    q = np.array([rng.uniform(*j.range, size=40) for j in robot.joint]).T
    w = np.tile([0.0, 0, -2500, 0, 0, 0], (40, 1))
    pose = StiffnessModel.of(reduce(robot, "gravity", "pose"))
    pose = pose.with_values(dict.fromkeys(pose.parameters, 1e-8))
    table = measurements(q, w, points=("p1",), kind="deflection", values=np.zeros((40, 6)))
    seen = predict(pose, table)
    seen[:, :3] += 1e-6 * rng.normal(size=(40, 3))
    seen[:, 3:] = np.nan
    result = identify(robot, replace(table, values=seen))
    assert (len(result.fit.names), result.model.measure) == (25, "position")
    assert 0.5 < np.sqrt(result.fit.s0_squared) / 1e-6 < 1.5
    elsewhere = measurements(rng.permuted(q, axis=0), w, points=("p1",), kind="none")
    missed = predict(result.model, elsewhere)[:, :3] - predict(pose, elsewhere)[:, :3]
    assert np.abs(missed).max() < 1e-5


@pytest.mark.parametrize(
    ("component", "loads"),
    [(3, "gravity"), (1, "force"), (2, "force"), (4, "wrench"), (5, "wrench"), (6, "wrench")],
)
def test_every_component_of_the_load_decides_its_class(component, loads):
    w = np.zeros((2, 6))
    w[:, 2] = -100.0
    w[1, component - 1] = 50.0
    table = measurements(np.eye(2, 6), w, kind="deflection", values=np.full((2, 6), 1e-4))
    assert experiment_of(table, load("kuka_kr270")).loads == loads
