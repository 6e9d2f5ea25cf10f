"""The virtual experiment against a physics engine, finite differences, and the laws of elasticity."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from elastic_arm import (
    ARM,
    arm,
    compliance_matrix,
    differentiated_jacobian,
    mujoco_model,
    mujoco_rest,
    poses,
    random_truth,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from symstiff.calibration import simulation
from symstiff.calibration.simulation import Effect, Truth, clean_response, nominal_truth, prepare
from symstiff.calibration.simulation.chain import chain_of
from symstiff.calibration.simulation.equilibrium import States, equilibrium, response
from symstiff.calibration.simulation.nominal import linear_compliance
from symstiff.errors import UserError
from symstiff.robot import from_table, library, load
from symstiff.robot.table import to_table
from symstiff.symbolic.numeric import kinematics


def test_a_small_load_gives_the_linear_deflection_of_a_finite_difference_jacobian():
    robot = arm()
    truth = random_truth(robot, 1, weights=False)
    k = compliance_matrix(truth.compliance, 3)
    w = np.random.default_rng(2).normal(size=(4, 6)) * 1e-2
    q = poses(robot, 4, 3)
    expected = []
    for row in range(4):
        j = differentiated_jacobian(q[row])
        expected.append(j @ k @ j.T @ w[row])
    expected = np.array(expected)
    got = clean_response(truth, q, w)
    assert np.abs(got - expected).max() < 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("stated", [True, False], ids=["beams stated", "beams by default"])
@pytest.mark.parametrize("name", library())
def test_the_linear_model_of_the_package_is_the_limit_of_small_loads(name, stated):
    """Two programs that share nothing but the robot file, in both DH conventions."""
    robot = load(name)
    if not stated:
        table = to_table(robot)
        for joint in table["joint"]:
            joint.get("link", {}).pop("beam_axis", None)
        robot = from_table(table, name)
    truth = Truth(robot, nominal_truth(robot), weights=False)
    q, w = poses(robot, 5, 3), np.random.default_rng(2).normal(size=(5, 6)) * 1e-3
    j, k = kinematics(robot, q).J_theta, linear_compliance(chain_of(robot), dict(truth.compliance))
    expected = np.einsum("nav,vu,nbu,nb->na", j, k, j, w)
    assert np.abs(clean_response(truth, q, w) - expected).max() < 2e-6 * np.abs(expected).max()


def test_gaps_that_close_at_once_still_have_an_equilibrium():
    robot = load("kuka_kr270")
    gaps = [Effect("backlash", {"joint": j}, values={"gap": 5e-4, "knee": 1e-3}) for j in range(1, 7)]
    w = np.random.default_rng(2).normal(size=(60, 6)) * 1000
    moved = clean_response(Truth(robot, nominal_truth(robot), tuple(gaps)), poses(robot, 60, 3), w)
    assert np.isfinite(moved).all()


def test_the_error_of_the_linear_model_grows_with_the_square_of_the_load():
    robot = arm()
    truth = random_truth(robot, 4, weights=False)
    q, w = poses(robot, 5, 5), np.random.default_rng(6).normal(size=(5, 6)) * 50
    linear = clean_response(truth, q, w * 1e-5) * 1e5
    errors = [np.linalg.norm(clean_response(truth, q, w * f) - f * linear, axis=1) for f in (0.5, 1.0, 2.0)]
    assert np.allclose(errors[1] / errors[0], 4, rtol=0.1)
    assert np.allclose(errors[2] / errors[1], 4, rtol=0.1)


@pytest.mark.parametrize("size", [1e-6, 2e-4])  # deflections of some 0.1 mm, and of some 10 mm
def test_equilibria_agree_with_a_physics_engine_weights_included(size):
    mujoco = pytest.importorskip("mujoco", reason="the physics engine MuJoCo is not installed")
    robot = arm()
    truth = random_truth(robot, 7, size=size)
    k = compliance_matrix(truth.compliance, 3)
    rng = np.random.default_rng(8)
    for q in poses(robot, 2, 9):
        w = np.concatenate([rng.normal(size=3) * 100, rng.normal(size=3) * 20])
        model = mujoco_model(mujoco, q)
        (p1, r1), (p0, r0) = mujoco_rest(mujoco, model, w, k), mujoco_rest(mujoco, model, w * 0, k)
        expected = np.concatenate([p1 - p0, Rotation.from_matrix(r1 @ r0.T).as_rotvec()])
        got = clean_response(truth, q[None], w[None])[0]
        assert np.linalg.norm(got[:3] - expected[:3]) < 1e-6 * np.linalg.norm(expected[:3])
        assert np.linalg.norm(got[3:] - expected[3:]) < 1e-6 * np.linalg.norm(expected[3:])


def test_planar_2r_sags_as_the_engine_says():
    mujoco = pytest.importorskip("mujoco", reason="the physics engine MuJoCo is not installed")
    robot = load("planar2r")
    a1, a2 = (float(j.a) for j in robot.joint)
    truth = Truth(robot, {"c1": 2e-4, "c2": 3e-4})
    q, w = np.array([0.4, -0.9]), np.array([30.0, -80.0, 0, 0, 0, 0])
    got = clean_response(truth, q[None], w[None])[0]
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler boundmass="0" boundinertia="0"/><option gravity="0 0 0"/><worldbody>'
        '<body><joint axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        f'<body pos="{a1} 0 0"><joint axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        f'<site name="tcp" pos="{a2} 0 0"/></body></body></worldbody></mujoco>'
    )
    data, theta = mujoco.MjData(model), np.zeros(2)
    jp, jr = np.zeros((3, 2)), np.zeros((3, 2))
    places = []
    for _ in range(60):
        data.qpos[:] = q + theta
        mujoco.mj_forward(model, data)
        mujoco.mj_jacSite(model, data, jp, jr, 0)
        places.append(data.site_xpos[0].copy())
        theta = np.array([2e-4, 3e-4]) * (jp.T @ w[:3])
    expected = places[-1] - places[0]
    assert np.linalg.norm(got[:3] - expected) < 1e-6 * np.linalg.norm(expected)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_forces_do_the_work_that_the_springs_store(seed):
    """A force that grows at a fixed direction is conservative: its work is the springs' energy."""
    robot = arm()
    truth = random_truth(robot, seed, size=3e-5, weights=False)
    k = compliance_matrix(truth.compliance, 3)
    rng = np.random.default_rng(seed)
    q, force = poses(robot, 1, seed), np.zeros((1, 6))
    force[0, :3] = rng.normal(size=3) * 100
    nodes, weights = np.polynomial.legendre.leggauss(12)
    levels = (nodes + 1) / 2
    moved = clean_response(truth, np.repeat(q, 13, axis=0), force * np.append(levels, 1.0)[:, None])[:, :3]
    along = moved @ force[0, :3]
    work = along[-1] - weights @ along[:-1] / 2  # ∫F·dx = F·x − ∫x·dF
    zero = np.zeros(1)
    theta = equilibrium(prepare(truth).mechanism, States(q, force, zero + 1, zero, zero, zero))[0]
    energy = theta @ np.linalg.solve(k, theta) / 2
    assert work == pytest.approx(energy, rel=1e-7)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_two_small_loads_are_reciprocal(seed):
    """Betti: the work of the first load on the second's deflection is that of the second on the first's."""
    robot = arm()
    truth = random_truth(robot, seed, weights=False)
    w = np.random.default_rng(seed).normal(size=(2, 6)) * 0.1
    q = np.repeat(poses(robot, 1, seed), 2, axis=0)
    d = clean_response(truth, q, w)
    scale = np.linalg.norm(w) * np.linalg.norm(d)
    assert abs(w[0] @ d[1] - w[1] @ d[0]) < 1e-5 * scale


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_the_same_arm_in_modified_dh_bends_the_same(seed):
    """A standard chain regrouped: the turn and shift along x that ends a row opens the next one."""
    rows = ARM["joint"]
    modified = [
        {**row, "a": before["a"] if before else 0, "alpha": before["alpha"] if before else 0}
        for before, row in zip([None, *rows], rows, strict=False)
    ]
    # What ended the last row has no next row: a robot whose last a and alpha are zero shows the equality.
    straight = [*rows[:2], {**rows[2], "a": 0, "alpha": 0}]
    modified[2]["link"] = straight[2]["link"]
    a, b = arm(joint=straight), arm(joint=modified, convention="modified")
    truth = random_truth(a, seed)
    q, w = poses(a, 3, seed), np.random.default_rng(seed).normal(size=(3, 6)) * 50
    assert np.allclose(
        clean_response(truth, q, w), clean_response(replace(truth, robot=b), q, w), rtol=1e-9, atol=1e-15
    )


def test_a_soft_arm_is_solved_by_newton_steps_where_fixed_point_steps_diverge():
    robot = load("planar2r")
    truth = Truth(robot, {"c1": 0.01, "c2": 0.02})
    q, w = np.array([[0.3, 0.4]]), np.array([[400.0, 0, 0, 0, 0, 0]])
    mechanism, zero = prepare(truth).mechanism, np.zeros(1)
    states = States(q, w, zero + 1, zero, zero, zero)
    theta = equilibrium(mechanism, states)
    assert np.abs(theta).max() > 0.1
    assert np.abs(theta - response(mechanism, states, theta)).max() < 1e-9


def test_a_load_without_equilibrium_is_refused():
    truth = Truth(load("planar2r"), {"c1": float("1e300")})
    with pytest.raises(UserError, match="equilibrium"):
        clean_response(truth, [[0.3, 0.4]], [[1e5, 1e5, 0, 0, 0, 0]])


def test_a_nominal_link_has_the_terms_of_its_template_alone():
    robot = load("ur10")
    table = to_table(robot)
    rows = ["*.....", ".*...*", "......", "......", "......", ".*...*"]
    table["template"] = [{"name": "planar", "pattern": rows}]
    table["joint"][1]["link"] |= {"template": "planar", "compliance": {"66": 4e-8, "55": 1e-7}}
    values = nominal_truth(from_table(table, "ur10"))
    assert sorted(n for n in values if n.startswith("k2_")) == ["k2_11", "k2_22", "k2_26", "k2_66"]
    assert values["k2_66"] == 4e-8


@pytest.mark.parametrize("known", [{"66": 1e-9}, {"22": 1e-3}, {"22": 1e-12, "55": 1e-3}, {"26": 1e-5}])
def test_a_nominal_link_beside_known_terms_gives_back_no_more_energy_than_it_takes(known):
    table = to_table(load("ur10"))
    table["joint"][0].setdefault("link", {})["compliance"] = known
    values = nominal_truth(from_table(table, "ur10"))
    K = np.zeros((6, 6))
    for name, value in values.items():
        if name.startswith("k1_"):
            a, b = int(name[3]) - 1, int(name[4]) - 1
            K[a, b] = K[b, a] = value
    assert all(values[f"k1_{key}"] == value for key, value in known.items())
    size = np.sqrt(np.diag(K))
    assert np.linalg.eigvalsh(K / np.outer(size, size)).min() > 0.1


def test_the_simulator_shares_no_code_with_what_it_checks():
    folder = Path(simulation.__file__).parent
    rooms = {
        found
        for file in folder.glob("*.py")
        for found in re.findall(r"^\s*from symstiff\.(\w+)", file.read_text(), re.MULTILINE)
    }
    assert rooms == {"arguments", "arrays", "calibration", "errors", "robot"}  # types of arrays are no code
