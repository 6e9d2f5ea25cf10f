"""What a plugin's law may be made of, all the way to C; what nothing can compute is refused in a line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import sympy as sp

from symstiff.calibration.simulation.chain import chain_of, joint_index
from symstiff.calibration.simulation.chain import posture as posture_of
from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.generate import generate
from symstiff.codegen.runtime import compiled
from symstiff.effects import Effect, EffectInstance, EffectParameter, Realisation, catalogue, registry
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only
from symstiff.robot import load
from symstiff.symbolic.algebras import evaluate_numpy
from symstiff.symbolic.terms import AXES, Term, VirtualJoint, actuated_joint, link_joint, q, tau, up, w

ROBOT = "ur10"
GEAR = actuated_joint(2)
Law = Callable[[], sp.Expr]


def grown(
    monkeypatch: pytest.MonkeyPatch, law: sp.Expr, at: VirtualJoint = GEAR, name: str = "tilt_2_c",
    robot: str = ROBOT,
) -> StiffnessModel:  # fmt: skip
    """A model of joints with a law of a plugin."""
    c = EffectParameter(name, "rad/(N*m)", -1e-3, 1e-3, 1e-6)
    effect = Effect(
        "tilt", "Tilt", "A gear that feels how it hangs.", frozenset({"deflection"}),
        lambda robot: ({"joint": 2},), lambda robot, where, shape: Realisation((c,), (Term(c.name, at, law),)),
    )  # fmt: skip
    known = {**catalogue(), "tilt": effect}
    monkeypatch.setattr(registry, "catalogue", lambda: known)
    model = joints_only(load(robot)).with_effect(EffectInstance("tilt", {"joint": 2}))
    return model.with_values(dict.fromkeys(model.parameters, 0.0) | {"c2": 2e-6, name: 3e-6})


@pytest.mark.parametrize("name", ["tilt_2_c", "w_tilt_2_c", "tau_tilt_2_c"])
def test_a_parameter_may_be_called_like_a_load(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Without load only loads are zero, and no parameter whose name begins as theirs do."""
    model = grown(monkeypatch, tau(GEAR), name=name)
    angles = np.array([[0.3, -1.1, 0.9, 0.4, 0.7, 0.2]])
    by_columns = model.deflection(angles, np.eye(6)).T
    C = evaluate_numpy(model.compliance_program, p=model.vector(), q=angles)["C"][0]
    np.testing.assert_allclose(C, by_columns, atol=1e-12 * np.abs(by_columns).max())


@pytest.mark.parametrize("body", [0, 2, 6])
def test_a_law_may_know_the_vertical(monkeypatch: pytest.MonkeyPatch, body: int) -> None:
    model = grown(monkeypatch, tau(GEAR) * up(body, 2))
    rng = np.random.default_rng(1)
    angles, wrench = rng.uniform(-2, 2, (7, 6)), rng.normal(size=(7, 6)) * 50
    chain = chain_of(load(ROBOT))
    rigid = posture_of(chain, angles, np.zeros((7, chain.size)))
    k = joint_index(2)
    lever = rigid.at(np.array([float(x) for x in load(ROBOT).tool.xyz])) - rigid.origin[:, k]
    J = np.hstack([np.cross(rigid.axis[:, k], lever), rigid.axis[:, k]])
    upright = rigid.after[0][:, body, 2, 1]  # the vertical's share along the second axis of the frame
    theta = (2e-6 + 3e-6 * upright) * np.einsum("nr,nr->n", J, wrench)
    by_hand = J * theta[:, None]
    np.testing.assert_allclose(model.deflection(angles, wrench), by_hand, atol=1e-15)
    A = model.observation(angles, wrench)
    np.testing.assert_allclose(A @ model.vector(model.values), by_hand, atol=1e-15)
    soft = np.einsum("nr,ns,n->nrs", J, J, 2e-6 + 3e-6 * upright)
    p = np.tile(model.vector(model.values), (7, 1))
    np.testing.assert_allclose(evaluate_numpy(model.compliance_program, p=p, q=angles)["C"], soft, atol=1e-15)


def test_a_law_that_knows_the_vertical_is_code_that_passes_its_test(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if find_compiler() is None:
        pytest.skip("no C compiler")
    made = generate(grown(monkeypatch, tau(GEAR) * up(3, 1)), tmp_path / "code")
    assert made.verification.selftest is not None


ONE_WAY = {
    "joints": (actuated_joint(2), actuated_joint(4)),
    "link": (link_joint(3, AXES[1]), link_joint(3, AXES[5])),
    "link, backwards": (link_joint(3, AXES[5]), link_joint(3, AXES[1])),
}
"""Where a law acts, and whose load it follows."""


@pytest.mark.parametrize("place", ONE_WAY)
def test_what_follows_anothers_load_one_way_has_a_stiffness_that_is_not_symmetric(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, place: str
) -> None:
    """No spring does so, a plugin may."""
    at, by = ONE_WAY[place]
    model = grown(monkeypatch, 300 * tau(by), at)
    angles = np.array([[0.3, -1.1, 0.9, 0.4, 0.7, 0.2]])
    by_columns = model.deflection(angles, np.eye(6)).T
    assert np.abs(by_columns - by_columns.T).max() > 0.1 * np.abs(by_columns).max()
    C = evaluate_numpy(model.compliance_program, p=model.vector(), q=angles)["C"][0]
    np.testing.assert_allclose(C, by_columns, atol=1e-12 * np.abs(by_columns).max())


def test_code_of_a_stiffness_that_is_not_symmetric_passes_its_test_and_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    if find_compiler() is None:
        pytest.skip("no C compiler")
    model = grown(monkeypatch, tau(actuated_joint(4)))
    soft = {f"c{j}": 1e-6 * j for j in range(1, 7)}
    made = generate(model.with_values(dict(model.values) | soft), tmp_path / "code")
    assert made.verification.selftest is not None
    assert made.verification.bounds["stiffness"] < 1e-12
    assert "K is not symmetric" in (tmp_path / "code" / "ur10.h").read_text()


STEPS = {
    "sign": lambda: sp.sign(tau(GEAR)),
    "sign beside a slope": lambda: tau(GEAR) + 50 * sp.sign(tau(GEAR)),
    "sign of an angle and a load": lambda: sp.sign(tau(GEAR) / 100 + q(2)) * tau(GEAR),
    "Abs": lambda: sp.Abs(tau(GEAR)),
    "root of Abs": lambda: sp.sqrt(sp.Abs(tau(GEAR))),
    "sign of the wrench": lambda: sp.sign(w(1)) * tau(GEAR),
}
"""Laws with a step or a kink, some where there is no load."""


@pytest.mark.parametrize("law", STEPS)
def test_a_law_with_a_step_is_code_that_agrees_with_the_model(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, law: str
) -> None:
    if find_compiler() is None:
        pytest.skip("no C compiler")
    model = grown(monkeypatch, STEPS[law]())
    model = model.with_values(dict(model.values) | {f"c{j}": 1e-6 * j for j in range(1, 7)})
    assert generate(model, tmp_path / "code").verification.selftest is not None
    rng = np.random.default_rng(3)
    angles, wrench = rng.uniform(-2, 2, (9, 6)), rng.normal(size=(9, 6)) * 50
    expected, plain = (
        model.deflection(angles, wrench),
        model.with_values(dict(model.values) | {"tilt_2_c": 0.0}),
    )
    assert np.abs(expected - plain.deflection(angles, wrench)).max() > 1e-7
    np.testing.assert_allclose(compiled(model).deflection(angles, wrench), expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    ("law", "kept"), [("sign", 0), ("sign beside a slope", 1), ("Abs", 0), ("root of Abs", 0)]
)
def test_a_step_without_load_leaves_the_compliance_of_what_is_smooth_there(
    monkeypatch: pytest.MonkeyPatch, law: str, kept: int
) -> None:
    angles = np.array([[0.3, -1.1, 0.9, 0.4, 0.7, 0.2]])
    model, smooth = grown(monkeypatch, STEPS[law]()), joints_only(load(ROBOT))
    smooth = smooth.with_values(dict.fromkeys(smooth.parameters, 0.0) | {"c2": 2e-6 + kept * 3e-6})
    C, expected = (evaluate_numpy(m.compliance_program, p=m.vector(), q=angles)["C"] for m in (model, smooth))
    np.testing.assert_allclose(C, expected, atol=1e-18)


def test_what_follows_the_wrench_has_the_compliance_of_its_deflections(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = grown(monkeypatch, 0.7 * w(1) + w(6) * sp.cos(q(3)))
    angles = np.array([[0.3, -1.1, 0.9, 0.4, 0.7, 0.2]])
    C = evaluate_numpy(model.compliance_program, p=model.vector(), q=angles)["C"][0]
    np.testing.assert_allclose(C, model.deflection(angles, np.eye(6)).T, atol=1e-18)
    assert np.abs(C - C.T).max() > 0.1 * np.abs(C).max()


@pytest.mark.parametrize(
    ("law", "why"),
    [
        (lambda: tau(GEAR) * up(7, 1), "depends on up_7_1, which this robot has not"),
        (lambda: tau(actuated_joint(9)), "depends on tau_joint9"),
        (lambda: sp.Symbol("foo") * tau(GEAR), "depends on foo"),
        (lambda: sp.Max(tau(GEAR), 0), "uses Max: use Abs, "),
        (lambda: sp.Piecewise((tau(GEAR), q(2) > 0), (0, True)), "uses Piecewise"),
        (lambda: tau(GEAR) ** q(2), "has the power q_2"),
        (lambda: sp.I * tau(GEAR), "holds I, which is no number"),
        (lambda: sp.oo * tau(GEAR), "holds oo, which is no number"),
    ],
)
def test_a_law_that_nothing_can_compute_is_refused(
    monkeypatch: pytest.MonkeyPatch, law: Law, why: str
) -> None:
    with pytest.raises(UserError) as refused:
        grown(monkeypatch, law())
    assert why in str(refused.value)


def test_a_law_that_is_no_number_under_a_load_is_named_where_code_is_made(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Also beside an effect that stands for a compliance, which the law alone would have."""
    law, robot = sp.asin(tau(GEAR) / 10), "kuka_kr270"
    spring = EffectInstance("gravity_compensator", {"joint": 2}, {"angle_1": -2.0, "angle_2": -1.0})
    gap = EffectInstance("backlash", {"joint": 3})
    for model in (
        grown(monkeypatch, law).with_effect(gap),
        grown(monkeypatch, law, robot=robot).with_effect(spring),
    ):
        with pytest.raises(
            UserError, match=r"^the law of tilt at joint 2 gives no finite number under loads"
        ):
            generate(model, tmp_path / "code")


def test_a_factor_may_be_a_plain_number(monkeypatch: pytest.MonkeyPatch) -> None:
    model = grown(monkeypatch, 1)
    still = model.deflection(np.zeros(6), np.zeros(6))
    np.testing.assert_allclose(still, grown(monkeypatch, sp.Integer(1)).deflection(np.zeros(6), np.zeros(6)))
    assert np.abs(still).max() > 1e-7


def test_a_law_at_a_joint_that_the_robot_does_not_have_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match="acts at joint9, which ur10 does not have"):
        grown(monkeypatch, tau(GEAR), actuated_joint(9))


def test_laws_in_latex_say_what_they_give() -> None:
    model = joints_only(load(ROBOT))
    for effect, where, line in (
        ("payload_error", {"load": "payload"}, r"\Delta W_{\mathrm{body6,1}} &= "),
        ("force_sensor_bias", {"load": "force_sensor"}, r"\Delta W_{3} &= "),
        ("frame_misalignment", {"measurement": "frame"}, r"\delta t_{2} &= \Delta t_{"),
        ("backlash", {"joint": 2}, r"\Delta\theta_{\mathrm{joint2}} &= \mathrm{backlash}_{"),
    ):
        assert line in model.with_effect(EffectInstance(effect, where))._repr_latex_()
