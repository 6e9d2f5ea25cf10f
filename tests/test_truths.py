"""What a truth may contain: nominal compliances, every effect in every shape, noise, and its file."""

import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from elastic_arm import compliance_matrix, poses

from symstiff.calibration.simulation import (
    SHAPES,
    Effect,
    Noise,
    Truth,
    clean_response,
    describe_effects,
    load_truth,
    nominal_truth,
    simulate,
    truth_from_table,
)
from symstiff.calibration.tables.measurements import measurements
from symstiff.calibration.tables.table import read_table, write_table
from symstiff.cli.calibrate import run_simulate
from symstiff.robot import load

# Nominal compliances.


def test_nominal_compliances_have_the_size_of_real_robots():
    kr = load("kuka_kr270")
    # stretched forward, upper arm up: working postures of the seed's experiment
    q = poses(kr, 60, 1) * [1, 0.35, 0.3, 1, 1, 1] + [0, -0.9, 0.3, 0, 0, 0]
    w = np.tile([0, 0, -2500.0, 0, 0, 0], (60, 1))
    rms = np.sqrt((clean_response(Truth(kr, nominal_truth(kr)), q, w)[:, :3] ** 2).sum(axis=1).mean())
    assert 4e-3 < rms < 8e-3
    ur = load("ur10")
    w = np.tile([0, 0, -100.0, 0, 0, 0], (60, 1))
    rms = np.sqrt(
        (clean_response(Truth(ur, nominal_truth(ur)), poses(ur, 60, 1), w)[:, :3] ** 2).sum(axis=1).mean()
    )
    assert 0.3e-3 < rms < 2.5e-3


@pytest.mark.parametrize("name", ["kuka_kr270", "ur10", "scara", "franka_panda", "planar2r"])
def test_nominal_link_matrices_are_those_of_elastic_bodies(name):
    robot = load(name)
    values = nominal_truth(robot)
    assert all(values[f"c{j + 1}"] > 0 for j in range(robot.dof))
    k = compliance_matrix(values, robot.dof)
    assert np.linalg.eigvalsh(k).min() > -1e-12 * np.abs(k).max()
    for i, link in enumerate(robot.links):
        if link.template == "beam" and not link.compliance:
            assert values[f"k{i}_26"] > 0 > values[f"k{i}_35"]


# Effects.

EXAMPLES = {
    ("gravity_compensator", "per_angle"): {"c": [1e-7, 2e-7], "angles": [-1.0, 1.0]},
    ("transmission_error", "harmonics"): {"a": [1e-4, 2e-4], "b": [1e-4, 0], "harmonics": [1, 13]},
    ("gravity_compensator", "spring"): {"rate": 7e6},
    ("link_asymmetry", "tilted"): {"angle": 0.1},
    ("bad_poses", "shift"): {"shift": [1e-3, 0, 0], "poses": ["p2"]},
    ("force_sensor_bias", "constant"): {"bias": [10, 0, 0, 0, 0, 0]},
    ("force_sensor_bias", "tool"): {"bias": [10, 0, 0, 0, 0, 0]},
    ("force_sensor_bias", "drifting"): {"bias": [10, 0, 0, 0, 0, 0]},
    ("geometric_error", "constant"): {"shift": [1e-3, 0, 0, 0, 0, 1e-3]},
    ("link_weight", "lumped"): {"mass": 50, "com": [-0.2, 0, 0]},
    ("link_weight", "before_springs"): {"mass": 50, "com": [-0.2, 0, 0]},
    ("payload_error", "tool"): {"dm": 10},
    ("payload_error", "load"): {"dm": 10},
    ("nonlinear_stiffness", "polynomial"): {"c2": 1e-10, "c3": 1e-14},
    ("configuration_dependent_link", "sine"): {"fraction": 0.2},
    ("local_bump", "position"): {"a": 1e-3, "center": -1.2, "width": 1.0},
    ("local_bump", "compliance"): {"c": 2e-7, "center": -1.2, "width": 1.0},
    ("base_slip", "threshold"): {"c": 1e-7, "threshold": 500},
    ("load_product", "product"): {"c": 1e-10},
    ("load_product", "magnitude"): {"c": 1e-10},
}
NEEDS = {"joint": {"joint": 2}, "joints": {"joints": [2, 3]}, "link": {"link": 2}}


def example(key):
    shape = SHAPES[key]
    if key in EXAMPLES:
        values = EXAMPLES[key]
    else:
        small = {"entries": {"66": 1e-7, "24": 2e-8}, "c": 2e-7, "rate": 1e-5, "rotation": [0.01, 0, 0.02]}
        values = {name: small.get(name, 1e-3) for name in shape.amplitudes}
    where = NEEDS.get(shape.place)
    return Effect(key[0], where, key[1], values)


def responses(truth, kind):
    robot = truth.robot
    q = np.repeat(poses(robot, 4, 11), 2, axis=0)
    w = np.random.default_rng(12).normal(size=(8, 6)) * [2000, 2000, 2000, 300, 300, 300]
    context = {"kind": kind, "time": np.arange(1, 9) * 100.0, "temperature": np.linspace(20, 25, 8)}
    return clean_response(truth, q, w, context | {"branch": [1, -1] * 4})


BARE = Truth(load("kuka_kr270"), nominal_truth(load("kuka_kr270")))


@pytest.mark.parametrize("key", [k for k in SHAPES if k[0] != "large_deflection"], ids="-".join)
def test_every_effect_shows_in_some_data_and_scales_to_nothing(key):
    effect = example(key)
    shown = 0.0
    for kind in ("deflection", "absolute"):
        without = responses(BARE, kind)
        change = np.abs(responses(BARE.with_effects(effect), kind) - without).max()
        rest = np.abs(responses(BARE.with_effects(effect.scaled(0.0)), kind) - without).max()
        assert math.isfinite(change)
        assert rest < 1e-13
        shown = max(shown, change)
    assert shown > 1e-6


@pytest.mark.parametrize(
    ("effect", "where"), [("transmission_error", {"joint": 2}), ("joint_offset", {"joint": 3})]
)
def test_what_the_load_does_not_touch_cancels_in_deflections(effect, where):
    values = {"a": 2e-4, "harmonics": 10} if effect == "transmission_error" else {"offset": 2e-4}
    truth = BARE.with_effects(Effect(effect, where, values=values))
    change = np.abs(responses(truth, "deflection") - responses(BARE, "deflection"))[:, :3].max()
    assert change < 2e-5  # second order: 2e-4 rad times some 10 mm
    assert np.abs(responses(truth, "absolute") - responses(BARE, "absolute"))[:, :3].max() > 1e-4


def test_the_compensator_spring_pulls_by_the_derivative_of_its_energy():
    """A stiff arm on one soft joint: its static turn is c·(−dU/dq), U the energy of the stretched spring."""
    L, ax, ay, s0, rate, c = 0.18, 0.7, 0.12, 0.45, 4e5, 1e-11
    robot = load("planar2r")
    effect = Effect(
        "gravity_compensator", {"joint": 1}, "spring",
        {"rate": rate, "L": L, "ax": ax, "ay": ay, "s0": s0, "preload": 1},
    )  # fmt: skip

    def energy(q):
        s = math.hypot(L * math.cos(q) + ax, L * math.sin(q) + ay)
        return rate * (s - s0) ** 2 / 2

    def height(truth, q):
        return clean_response(truth, [[q, 0.0]], [[0.0] * 6], {"kind": "absolute"})[0]

    q = 0.7
    truth = Truth(robot, {"c1": c})
    moved = height(truth.with_effects(effect), q) - height(truth, q)
    torque = -(energy(q + 1e-5) - energy(q - 1e-5)) / 2e-5
    reach = sum(float(j.a) for j in robot.joint)
    assert np.linalg.norm(moved[:3]) == pytest.approx(abs(c * torque) * reach, rel=1e-5)


def test_every_shape_is_listed_with_its_parameters():
    lines = describe_effects().splitlines()
    assert len(lines) == len(SHAPES)
    assert "backlash (tanh); where = {joint = …}; gap, knee = 5.0" in lines


# Truth files and tables.

TRUTH = """
format = 1
robot = "kuka_kr270"
[compliance]
c2 = 0.3e-6
k2_12 = 1e-9
[[effect]]
effect = "backlash"
where = {joint = 3}
gap = 2e-4
[noise]
sigma_mm = [0.02, 0.02, 0.04]
growth_ppm = 5
approach_mm = 0.02
quantum_mm = 0.001
[environment]
interval = 20
warming = 3
"""


def design(rows=6):
    robot = load("kuka_kr270")
    q = np.repeat(poses(robot, rows, 3), 2, axis=0)
    w = np.tile([[0, 0, -1000.0, 0, 0, 0], [0, 0, -2500.0, 0, 0, 0]], (rows, 1))
    return measurements(q, w, points=("p1", "tcp"), point=[0, 1] * rows)


def test_a_truth_and_poses_give_a_table_without_a_trace_of_the_truth(tmp_path):
    (tmp_path / "truth.toml").write_text(TRUTH)
    write_table(design(), tmp_path / "poses.csv")
    run_simulate(tmp_path / "truth.toml", tmp_path / "poses.csv", tmp_path / "data.csv", 0.01, 5)
    data = read_table(tmp_path / "data.csv")
    assert data.kind == "deflection"
    text = (tmp_path / "data.csv").read_text()
    assert not any(word in text for word in ("backlash", "gap", "truth", "seed", "effect"))
    run_simulate(tmp_path / "truth.toml", tmp_path / "poses.csv", tmp_path / "again.csv", 0.01, 5)
    assert (tmp_path / "again.csv").read_text() == text
    run_simulate(tmp_path / "truth.toml", tmp_path / "poses.csv", tmp_path / "other.csv", 0.01, 6)
    assert (tmp_path / "other.csv").read_text() != text


def test_noise_has_the_stated_size_and_approach_errors_are_common_to_a_pose():
    truth = replace(BARE, noise=Noise(sigma_mm=(0.02, 0.02, 0.05), approach_mm=(0.1, 0.1, 0.1)))
    table = design(400)
    clean = simulate(replace(BARE, noise=Noise()), table, 1)
    noisy = simulate(truth, table, 1)
    error = (noisy.values - clean.values)[:, :3].reshape(400, 2, 3) * 1e3
    within = error[:, 0] - error[:, 1]
    assert np.allclose(within.std(axis=0), np.sqrt(2) * np.array([0.02, 0.02, 0.05]), rtol=0.15)
    assert np.allclose(error.mean(axis=1).std(axis=0), 0.1, rtol=0.15)
    assert np.allclose(noisy.sigma[:, :3], np.array([2e-5, 2e-5, 5e-5]))
    assert np.isnan(clean.sigma).all()


def test_the_reading_without_load_is_common_to_a_points_deflections_in_a_pose():
    noise = Noise(sigma_mm=(0.02, 0.02, 0.02), unloaded_mm=(0.1, 0.1, 0.1))
    table = design(400)
    table = replace(table, points=("tcp", "p1"), point=np.arange(len(table)) // 2 % 2)
    for pose in (table.pose, table.pose // 2 * 2):  # one point a pose, then two
        made = replace(table, pose=pose)
        clean = simulate(replace(BARE, noise=Noise()), made, 1)
        error = (simulate(replace(BARE, noise=noise), made, 1).values - clean.values)[:, :3]
        error = error.reshape(400, 2, 3) * 1e3
        assert np.allclose((error[:, 0] - error[:, 1]).std(axis=0), np.sqrt(2) * 0.02, rtol=0.15)
        assert np.allclose(error.mean(axis=1).std(axis=0), 0.1, rtol=0.15)
        assert abs(np.corrcoef(error[::2].ravel(), error[1::2].ravel())[0, 1]) < 0.1
    absolute = replace(BARE, kind="absolute")
    values = [
        simulate(replace(absolute, noise=n), design(5), 1).values
        for n in (Noise(), replace(noise, sigma_mm=(0.0,) * 3))
    ]
    np.testing.assert_array_equal(*values)


def test_a_joint_that_settles_anew_moves_all_points_of_a_reading_alike_and_each_reading_otherwise():
    told = 'format = 1\nrobot = "planar2r"\n[noise]\nsettling_mrad = {}\n'
    rng = np.random.default_rng(2)
    q, w = rng.uniform(-2, 2, (200, 2)), rng.normal(size=(200, 6)) * [50, 50, 0, 0, 0, 0]
    table = measurements(
        np.repeat(q, 4, axis=0),
        np.repeat(np.stack([0.5 * w, w], axis=1).reshape(400, 6), 2, axis=0),
        pose=np.repeat(np.arange(200), 4),
        points=("tcp", "p1"),
        point=[0, 1] * 400,
    )
    table = replace(table, time=30.0 * np.arange(len(table)))  # one marker after the other
    still, moved = (
        simulate(truth_from_table(tomllib.loads(told.format(size))), table, 1) for size in ("0", "[0.2, 0]")
    )
    error = (moved.values - still.values)[:, :3].reshape(200, 2, 2, 3)
    angles = []
    for k, forearm in enumerate((0.7, 0.8)):  # to the tool, and to the marker beyond it
        x = np.cos(q[:, :1]) + forearm * np.cos(q.sum(axis=1, keepdims=True))
        y = np.sin(q[:, :1]) + forearm * np.sin(q.sum(axis=1, keepdims=True))
        angles.append((error[:, :, k, 1] * x - error[:, :, k, 0] * y) / (x**2 + y**2))
    np.testing.assert_allclose(angles[0], angles[1], atol=2e-6)
    assert angles[0].std() == pytest.approx(2e-4, rel=0.1)
    assert abs(np.corrcoef(angles[0].T)[0, 1]) < 0.2


@pytest.mark.parametrize(
    "effect",
    [
        '"transmission_error"\nwhere = {joint = 1, harmonics = [7]}\na = 1e-4\nharmonics = 7',
        '"force_sensor_bias"\nwhere = {load = "force_sensor"}\nbias = 1',
    ],
)
def test_a_place_as_a_verdict_tells_it_may_stand_in_a_truth(tmp_path, effect):
    (tmp_path / "truth.toml").write_text(f'format = 1\nrobot = "planar2r"\n[[effect]]\neffect = {effect}\n')
    assert load_truth(tmp_path / "truth.toml").effects


def test_a_number_stands_for_each_number_of_a_list():
    alike = [
        responses(
            BARE.with_effects(Effect("link_weight", {"link": 2}, values={"mass": 50, "com": com})), "absolute"
        )
        for com in (0.1, [0.1, 0.1, 0.1])
    ]
    np.testing.assert_array_equal(*alike)


def test_a_truth_can_be_built_without_a_file():
    a = truth_from_table(tomllib.loads(TRUTH))
    assert a.compliance["k2_12"] == 1e-9
    assert a.effects[0].scaled(2).values == {"gap": 4e-4}
    assert a.environment is not None


def test_a_truth_finds_its_robot_beside_it(tmp_path):
    text = 'format = 1\nname = "stick"\n[[joint]]\na = 1\nalpha = 0\nd = 0\n[joint.link]\nbeam_axis = "x"\n'
    (tmp_path / "stick.toml").write_text(text)
    (tmp_path / "truth.toml").write_text('format = 1\nrobot = "stick.toml"\n')
    assert load_truth(tmp_path / "truth.toml").robot.name == "stick"


def test_a_truth_may_begin_with_a_byte_order_mark(tmp_path):
    (tmp_path / "truth.toml").write_text('format = 1\nrobot = "planar2r"\n', encoding="utf-8-sig")
    assert load_truth(tmp_path / "truth.toml").robot.name == "planar2r"


def test_a_drift_without_a_shape_sits_where_it_is_put():
    rate = {"rate": [1e-6, 0, 0]}
    device = BARE.with_effects(Effect("thermal_drift", {"measurement": "frame"}, values=rate))
    moved = responses(device, "deflection") - responses(BARE, "deflection")
    assert np.allclose(moved[:, 0], np.arange(1, 9) * 1e-4, rtol=1e-9)
    link = BARE.with_effects(Effect("thermal_drift", {"link": 2}, values=rate))
    grown = responses(link, "deflection") - responses(BARE, "deflection")
    assert np.allclose(np.linalg.norm(grown[:, :3], axis=1), np.arange(1, 9) * 1e-4, rtol=1e-2)
