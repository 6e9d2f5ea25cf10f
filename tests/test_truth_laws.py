"""The laws of a virtual experiment one by one, on a planar arm, against numbers worked out by hand."""

import math

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Truth, clean_response, nominal_truth
from symstiff.robot import load

ARM = Truth(load("planar2r"), {})
JOINT, JOINTS = {"joint": 1}, {"joints": [1, 2]}


def turn(effect, moment, q=(0.0, 0.0), **context):
    """Rotation about z [rad] under a moment that loads both joints alike."""
    rows = {name: [value] for name, value in context.items()}
    w = [[0, 0, 0, 0, 0, moment]]
    seen = clean_response(ARM.with_effects(effect), [q], w, rows) - clean_response(ARM, [q], w, rows)
    return seen[0, 5]


@pytest.mark.parametrize(
    ("effect", "shape", "values", "moment", "context", "expected"),
    [
        ("joint_compliance", "linear", {"c": 1e-5}, 100, {}, 1e-3),
        ("nonlinear_stiffness", "polynomial", {"c2": 1e-7, "c3": 1e-9}, -100, {}, -2e-3),
        ("nonlinear_stiffness", "tanh", {"a": 1e-3, "tau0": 100}, 100, {}, 0.761594156e-3),
        ("nonlinear_stiffness", "two_slope", {"c": 1e-5, "knee": 60}, 100, {}, 6e-4),
        ("nonlinear_stiffness", "two_slope", {"c": 1e-5, "knee": 60}, -30, {}, -3e-4),
        ("nonlinear_stiffness", "power", {"a": 1e-3, "tau0": 100, "exponent": 0.5}, -25, {}, -5e-4),
        ("backlash", "tanh", {"gap": 2e-4, "knee": 1}, 100, {}, 1e-4),
        ("backlash", "ramp", {"gap": 2e-4, "knee": 200}, -100, {}, -0.5e-4),
        ("backlash", "arctan", {"gap": 2e-4, "knee": 100}, 100, {}, 0.5e-4),
        ("hysteresis", "constant", {"width": 2e-4, "knee": 1}, 100, {"branch": 1}, -1e-4),
        ("hysteresis", "constant", {"width": 2e-4, "knee": 1}, 100, {"branch": -1}, 1e-4),
        ("hysteresis", "constant", {"width": 2e-4, "knee": 1}, 100, {}, 0),
        ("hysteresis", "sqrt", {"width": 2e-4, "knee": 1, "tau_ref": 400}, 100, {"branch": -1}, 0.5e-4),
        ("hysteresis", "loop", {"width": 2e-4, "knee": 1, "tau_max": 200}, -100, {"branch": 1}, 0.75e-4),
        ("creep", "exponential", {"c": 1e-5, "T": 100}, 100, {"time": 100}, 0.632120559e-3),
        ("thermal_softening", "linear", {"c": 1e-6}, 100, {"temperature": 25}, 5e-4),
    ],
)
def test_a_joint_gives_way_as_its_law_says(effect, shape, values, moment, context, expected):
    got = turn(Effect(effect, JOINT, shape, values), moment, **context)
    assert got == pytest.approx(expected, rel=1e-8, abs=1e-15)


@pytest.mark.parametrize(
    ("effect", "shape", "values", "q", "expected"),
    [
        ("wrist_coupling", "linear", {"c": 1e-5}, (0, 0), 2e-3),
        ("wrist_coupling", "saturating", {"c": 1e-5, "tau0": 100}, (0, 0), 2 * 0.761594156e-3),
        ("load_product", "product", {"c": 1e-7}, (0, 0), 1e-3),
        ("load_product", "magnitude", {"c": 1e-7}, (0, 0), 1e-3),
        ("angle_dependent_compliance", "cosine", {"c": 1e-5, "order": 2}, (1, math.pi / 6), 0.5e-3),
    ],
)
def test_two_joints_share_a_law(effect, shape, values, q, expected):
    got = turn(Effect(effect, JOINTS, shape, values), 100, q)
    assert got == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(
    ("effect", "shape", "values", "q", "expected"),
    [
        ("gravity_compensator", "cosine", {"c": 1e-5}, math.pi / 3, 0.5e-3),
        ("gravity_compensator", "per_angle", {"c": [1e-5, 2e-5], "angles": [-1, 1]}, 0.8, 2e-3),
        ("local_bump", "compliance", {"c": 1e-5, "center": 0.5, "width": 0.1}, 0.6, 1e-3 / math.e),
    ],
)
def test_a_compliance_depends_on_the_joints_own_angle(effect, shape, values, q, expected):
    got = turn(Effect(effect, JOINT, shape, values), 100, (q, 0))
    assert got == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(
    ("effect", "shape", "values", "q", "expected"),
    [
        ("joint_offset", "constant", {"offset": 2e-4}, 0.3, 2e-4),
        ("transmission_error", "harmonics", {"a": 1e-3, "b": 2e-3, "harmonics": 3}, 0.5, 1.138969390e-3),
        ("transmission_error", "triangle", {"a": 1e-3, "harmonic": 2}, math.pi / 8, 0.5e-3),
        ("transmission_error", "triangle", {"a": 1e-3, "harmonic": 2}, 3 * math.pi / 4, -1e-3),
        ("local_bump", "position", {"a": 1e-3, "center": 0.5, "width": 0.1}, 0.6, 1e-3 / math.e),
    ],
)
def test_a_joint_stands_off_by_its_error(effect, shape, values, q, expected):
    """Positions tell: the tool goes round axis 1 by the error, at the arm's length."""
    truth, w = ARM.with_effects(Effect(effect, JOINT, shape, values)), [[0.0] * 6]
    reach = sum(float(j.a) for j in ARM.robot.joint)
    off = clean_response(truth, [(q, 0)], w, {"kind": "absolute"})
    on = clean_response(ARM, [(q, 0)], w, {"kind": "absolute"})
    gap = np.linalg.norm((off - on)[0, :3])
    assert gap == pytest.approx(2 * reach * math.sin(abs(expected) / 2), rel=1e-7)


def test_an_unknown_weight_at_the_tool_cancels_unless_it_hangs_with_the_load():
    robot = load("kuka_kr270")
    truth = Truth(robot, nominal_truth(robot))
    q, down = [[0.2, -1.0, 0.5, 0.3, 0.4, 0.1]], np.array([[0, 0, -1000.0, 0, 0, 0]])
    plain = clean_response(truth, q, down)
    heavier = clean_response(truth, q, down - [0, 0, 10 * 9.80665, 0, 0, 0])
    on_load = clean_response(
        truth.with_effects(Effect("payload_error", shape="load", values={"dm": 10})), q, down
    )
    on_tool = clean_response(
        truth.with_effects(Effect("payload_error", shape="tool", values={"dm": 10})), q, down
    )
    assert np.allclose(on_load, heavier, rtol=1e-9, atol=1e-15)
    assert np.abs(on_tool - plain).max() < 1e-2 * np.abs(heavier - plain).max()


@pytest.mark.parametrize(
    ("effect", "values", "context"),
    [
        ("creep", {"c": 2e-7, "T": 100}, {"time": [50.0]}),
        ("thermal_softening", {"c": 1e-8}, {"temperature": [35.0]}),
    ],
)
def test_a_joint_that_softens_does_so_under_the_arms_weight_too_which_cancels(effect, values, context):
    """Both readings of a deflection are made at one time: what is seen is the load's part, to first order."""
    q, down = [[0.2, -1.0, 0.5, 0.3, 0.4, 0.1]], np.array([[0, 0, -500.0, 0, 0, 0]])
    bare = load("kuka_kr270")
    heavy = [j.model_copy(update={"link": j.link.model_copy(update={"mass": 150.0})}) for j in bare.joint]
    added = []
    for robot in (bare, bare.model_copy(update={"joint": tuple(heavy)})):
        truth = Truth(robot, nominal_truth(robot))
        softer = truth.with_effects(Effect(effect, {"joint": 2}, values=values))
        context = {"kind": "deflection", **context}
        added.append(clean_response(softer, q, down, context) - clean_response(truth, q, down, context))
    assert np.abs(added[0]).max() > 1e-5
    assert np.allclose(added[1], added[0], atol=0.05 * np.abs(added[0]).max())


def test_a_sensor_error_is_a_wrong_load():
    robot = load("ur10")
    truth = Truth(robot, nominal_truth(robot))
    q, w = [[0.2, -1.0, 0.5, 0.3, 0.4, 0.1]], np.array([[10, -20, -50.0, 1, 2, -3]])
    bias = [1.0, 2, 3, 0.1, 0.2, 0.3]
    got = clean_response(truth.with_effects(Effect("force_sensor_bias", values={"bias": bias})), q, w)
    assert np.allclose(got, clean_response(truth, q, w + bias), rtol=1e-9, atol=1e-15)
    turned = Effect("force_sensor_misalignment", values={"rotation": [0, 0, math.pi / 2]})
    expected = clean_response(truth, q, [[20, 10, -50.0, -2, 1, -3]])
    assert np.allclose(clean_response(truth.with_effects(turned), q, w), expected, rtol=1e-9, atol=1e-15)
