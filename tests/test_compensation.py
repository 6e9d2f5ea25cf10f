"""Corrections are small or none: near singular poses and for absurd loads a command stays as it was."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from symstiff.compensation import compensate, compensate_online
from symstiff.effects.instance import EffectInstance
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only
from symstiff.reduction import reduce
from symstiff.robot import load
from symstiff.robot.loading import from_table
from symstiff.symbolic.numeric import forward
from tests.generated_c import model, poses

NEAR = np.array([0.1, -1.0, 1.2, 0.3, 1e-6, -0.2])  # axes 4 and 6 almost on one line
REGULAR = np.array([0.1, -1.0, 1.2, 0.3, 0.5, -0.2])
LOAD = np.array([0.0, 0.0, -2500.0, 0.0, 0.0, 0.0])


def test_a_command_near_a_singular_pose_stays_as_it_was() -> None:
    m = model("kuka_kr270")
    q, w = np.array([NEAR, REGULAR]), np.tile(LOAD, (2, 1))
    online = compensate_online(m, q, w)
    np.testing.assert_array_equal(online[0], NEAR)
    assert 0 < np.abs(online[1] - REGULAR).max() < 0.05
    found = compensate(m, q, w)
    assert not found.remarks
    assert found.solved.tolist() == [False, True]
    np.testing.assert_array_equal(found.q_cmd[0], NEAR)
    np.testing.assert_array_equal(found.after[0], found.before[0])
    assert np.abs(found.after[1]).max() < 1e-10


def test_without_a_load_a_command_stays_as_it_was_to_the_last_bit() -> None:
    m = model("kuka_kr270")
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (40, 6))
    found = compensate(m, q, np.zeros((40, 6)))
    np.testing.assert_array_equal(found.q_cmd, q)
    assert found.solved.all()


SOFT = {
    "k0_11": 2e-6, "k0_22": 2e-6, "k0_33": 2e-6, "k0_44": 7e-6, "k1_22": -2e-6, "k1_55": 6e-6, "k2_11": -2e-6,
    "k2_66": 1e-5, "k3_55": 5e-6, "k3_66": 1e-5, "k4_55": 2e-5, "k5_55": 2e-5,
}  # fmt: skip


def test_a_solution_that_steps_approach_slowly_or_swing_about_is_found() -> None:
    """Beside a wrist singularity whole Newton steps shrink by less than half or grow, though a solution is near."""
    soft = StiffnessModel.of(reduce(load("ur10"), "wrench", "pose"))
    soft = soft.with_values({name: SOFT.get(name, 0.0) for name in soft.parameters})
    q = np.radians(np.tile([10.0, -60, 80, -90, 0, 10], (6, 1)))
    q[:, 4] = np.radians([-0.05, -0.03, -0.02, 0.02, 0.01, 0.0])
    w = np.tile([0.0, 20, -100, 0, 0, 0], (6, 1))
    found = compensate(soft, q, w)
    assert found.kept.tolist() == ["", "", "", "", "too_far", "singular"]
    assert np.abs(found.q_cmd - q).max() < 0.25
    (remark,) = found.remarks
    assert remark.startswith("4 rows beside a singular pose (1, 2, 3, 4): small corrections")
    assert f"by up to {np.abs(found.q_cmd - q).max():.2g} rad" in remark
    meant, there = forward(soft.robot, q[:4]), forward(soft.robot, found.q_cmd[:4])
    bent = soft.deflection(found.q_cmd[:4], w[:4])
    np.testing.assert_allclose(there[:, :3, 3] + bent[:, :3], meant[:, :3, 3], atol=1e-9)
    turned = Rotation.from_rotvec(bent[:, 3:]).as_matrix() @ there[:, :3, :3]
    np.testing.assert_allclose(turned, meant[:, :3, :3], atol=1e-9)
    np.testing.assert_array_equal(found.q_cmd[4:], q[4:])


@pytest.mark.parametrize("force", [1e5, 1e6, 1e8, 1e300])
def test_a_load_that_no_correction_can_answer_is_not_solved(force: float) -> None:
    m = model("kuka_kr270")
    q, w = np.tile(REGULAR, (2, 1)), np.array([[0, 0, -force, 0, 0, 0], LOAD])
    with np.errstate(all="ignore"):
        found = compensate(m, q, w)
        online = compensate_online(m, q, w)
    moved = np.abs(found.q_cmd - q).max(axis=1)
    assert found.solved[1]
    assert moved[1] > 0
    if not found.solved[0]:
        assert moved[0] == 0
        np.testing.assert_array_equal(found.after[0], found.before[0])
    assert (moved <= 0.25).all()
    assert (np.abs(online - q) <= 0.25).all()
    assert force < 1e6 or not found.solved[0]


@pytest.mark.parametrize("robot", ["kuka_kr270", "scara", "franka_panda"])
def test_what_is_solved_has_no_larger_error_than_before(robot: str) -> None:
    m = model(robot)
    q, w = poses(robot, 40)
    found = compensate(m, q, w / 20)
    assert found.solved.mean() > 0.8
    if m.robot.dof >= 6:
        assert np.abs(found.after[found.solved]).max() < 1e-9
    assert np.abs(found.after[:, :3]).sum() < np.abs(found.before[:, :3]).sum()


def test_a_deflection_beyond_all_numbers_is_refused() -> None:
    m = model("kuka_kr270")
    absurd = m.with_values({next(iter(m.parameters)): 1e308})
    with np.errstate(all="ignore"), pytest.raises(UserError, match="beyond all numbers"):
        compensate(absurd, np.array([REGULAR]), np.array([LOAD]) * 1e6)


@pytest.mark.parametrize("what", ["joint", "load"])
def test_a_row_that_is_no_number_among_good_ones_is_refused_by_its_number(what: str) -> None:
    q, w = np.tile(REGULAR, (3, 1)), np.tile(LOAD, (3, 1))
    (q if what == "joint" else w)[1, 2] = np.nan
    for way in (compensate, compensate_online):
        with pytest.raises(UserError, match=r"[qw]: row 1 holds what is no finite number"):
            way(model("kuka_kr270"), q, w)


def test_an_attitude_that_turns_without_end_is_told_as_it_is() -> None:
    m = model("kuka_kr270", "wrench")
    q, w = np.array([REGULAR]), np.array([[0.0, 0.0, 0.0, 1e13, 0.0, 0.0]])
    found = compensate(m, q, w)
    assert not found.solved[0]
    assert found.before[0, 3:] == pytest.approx(m.deflection(q, w)[0, 3:], rel=1e-9)


def test_what_the_measuring_device_does_moves_no_joint() -> None:
    m = model("kuka_kr270")
    drifting = m.with_effect(EffectInstance("thermal_drift", {"measurement": "frame"}, {"T": 3600.0}))
    drifting = drifting.with_values(dict(m.values) | {n: 1e-6 for n in drifting.parameters if "thermal" in n})
    q, w, late = np.array([REGULAR]), np.array([LOAD]), {"time": np.array([36000.0])}
    assert drifting.of_robot().parameters == m.parameters
    np.testing.assert_array_equal(compensate_online(drifting, q, 0.0 * w, context=late), q)
    np.testing.assert_array_equal(compensate(drifting, q, w, context=late).q_cmd, compensate(m, q, w).q_cmd)


LENGTHS = np.array([0.5, 0.4, 0.3, 0.2])


def planar(q: np.ndarray, compliance: float, force: np.ndarray) -> tuple[np.ndarray, float]:
    """Tip (x, y) and angle of an arm of four parallel axes in the plane, its joints bent by a force at the tip."""

    along = LENGTHS[:, None] * np.column_stack([np.cos(np.cumsum(q)), np.sin(np.cumsum(q))])
    levers = np.array([along[k:].sum(axis=0) for k in range(4)])
    bent = compliance * (levers[:, 0] * force[1] - levers[:, 1] * force[0])
    turned = levers[:, ::-1] * [-1.0, 1.0]
    return levers[0] + turned.T @ bent, float(q.sum() + bent.sum())


def test_joints_that_are_redundant_in_a_plane_are_compensated_and_stretched_out_they_are_singular() -> None:
    rigid = {"template": "rigid"}
    joints = [{"a": a, "alpha": 0, "d": 0, "compliance": 1e-5, "link": rigid} for a in LENGTHS.tolist()]
    robot = from_table({"format": 1, "name": "p4r", "base": {"link": rigid}, "joint": joints}, "p4r")
    m = joints_only(robot, "force", "pose", {}).with_values({f"c{i}": 1e-5 for i in range(1, 5)})
    q, force = (
        np.radians([[10.0, 40, 30, -50], [20.0, 0, 0, 0], [20.0, 180, 0, 180]]),
        np.array([100.0, 200.0]),
    )
    found = compensate(m, q, np.array([*force, 0, 0, 0, 0]))
    assert found.solved.tolist() == [True, False, False]
    meant, angle = planar(q[0], 0.0, force)
    there, turned = planar(found.q_cmd[0], 1e-5, force)
    np.testing.assert_allclose(there, meant, atol=1e-12)
    assert turned == pytest.approx(angle, abs=1e-12)
    np.testing.assert_array_equal(found.q_cmd[1:], q[1:])
    online = compensate_online(m, q, np.array([*force, 0, 0, 0, 0]))
    np.testing.assert_array_equal(online, q)  # as the generated code, which asks for one direction a joint


def test_a_model_without_values_is_refused() -> None:
    """It is a start for ``identify``: commands that come back unchanged look like those of a stiff arm."""
    start = StiffnessModel.of(reduce(load("planar2r"), "gravity"))
    for empty in (start.with_values({}), start.with_values(dict.fromkeys(start.parameters, 0.0))):
        for way in (compensate, compensate_online):
            with pytest.raises(UserError, match="values: there are none but zeros, and nothing bends"):
                way(empty, np.zeros((1, 2)), np.array([LOAD]))


def test_loads_and_joints_that_the_model_was_not_reduced_for_are_told() -> None:
    reduced = StiffnessModel.of(reduce(load("planar2r"), "force", fixed={2: 0.5}))
    reduced = reduced.with_values(dict.fromkeys(reduced.parameters, 1e-7))
    within = np.array([[0.1, 0.5]]), np.array([[100.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    assert reduced.fixed
    assert compensate(reduced, *within).remarks == ()
    found = compensate(reduced, [[0.1, 0.7]], [[100.0, 0.0, 0.0, 0.0, 0.0, 10.0]])
    loads, joints = found.remarks
    assert "reduced for force loads (fx, fy, fz), and these have mz too" in loads
    assert "reduced for q2 = 0.5 rad, and these poses have other values" in joints


@pytest.mark.parametrize(("elbow", "remarks"), [(np.pi / 2, 0), (0.01, 1)])
def test_a_joint_that_only_turns_the_tool_makes_no_pose_singular(elbow: float, remarks: int) -> None:
    """As the last one of a SCARA, whose turn counts little where position comes first; a stretched elbow does."""
    soft = joints_only(load("scara"), "wrench", "pose", {}).with_values({"c1": 1e-7, "c2": 1e-7, "c4": 7e-4})
    q = np.array([[0.2, elbow, 0.1, 0.5]])
    found = compensate(soft, q, np.array([[0.0, 0, 0, 0, 0, 40.0]]))
    assert np.abs(found.q_cmd - q).max() > 0.02
    assert len(found.remarks) == remarks
    assert all(remark.startswith("1 row beside a singular pose (1)") for remark in found.remarks)


def test_a_time_beyond_what_was_measured_is_told() -> None:
    drifting = model("planar2r").with_effect(EffectInstance("thermal_drift", {"link": 1}, {"time": 1800.0}))
    drift = {n: 1e-4 for n in drifting.parameters if n.startswith("thermal")}
    drifting = drifting.with_values({**drifting.values, **drift})
    q, w = [[0.1, 1.2]] * 3, [0.0] * 6
    assert not compensate(drifting, q, w, context={"time": [0.0, 600.0, 1800.0]}).remarks
    (remark,) = compensate(drifting, q, w, context={"time": [0.0, 600.0, 9000.0]}).remarks
    assert remark.startswith("1 row at a time beyond what was measured, 0 to 1800 s (first: row 3)")
