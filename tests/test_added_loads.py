"""Effects that add loads (a wrong payload, a biased sensor) together with laws that see them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy import workflow
from symstiff.discrepancy.bridge.growth import fit, grow
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured

BIAS = {
    "effect": "force_sensor_bias",
    "shape": "constant",
    "bias": [25.0, -12.0, 8.0, 3.0, -2.0, 2.0],
}


def _experiment(model: StiffnessModel) -> Measurements:
    """Loads in three steps up and down again, read from the model's own code path; noise far below."""
    rng = np.random.default_rng(0)
    poses, steps = 25, np.array([1 / 3, 2 / 3, 1.0, 2 / 3, 1 / 3])
    limits = np.array([j.range for j in model.robot.joint])
    q = np.repeat(rng.uniform(limits[:, 0], limits[:, 1], (poses, 6)), 5, axis=0)
    w = rng.normal(size=(poses, 6)) * [60, 60, 60, 10, 10, 10]
    w = np.repeat(w, 5, axis=0) * np.tile(steps, poses)[:, None]
    branch = np.tile([1.0, 1.0, 1.0, -1.0, -1.0], poses)
    values = model.deflection(q, w, context={"branch": branch})
    pose = np.repeat(np.arange(poses), 5)
    table = measurements(
        q, w, values=values, pose=pose, kind="deflection", branch=branch, joint_units=["rad"] * 6
    )
    return replace(table, sigma=np.full((len(table), 6), 1e-6))


@pytest.mark.slow
def test_a_fit_puts_loads_and_laws_together_as_the_code_does() -> None:
    robot = load("ur10")
    model = grow(
        StiffnessModel.of(reduce(robot, "wrench")),
        [
            EffectInstance("force_sensor_bias", {"load": "force_sensor"}),
            EffectInstance("nonlinear_stiffness", {"joint": 2}, {"load": 100.0, "power": 3.0}),
            EffectInstance(
                "hysteresis", {"joint": 3}, {"width": 2.0, "load": 60.0, "power": 0.5, "weights": 0.0}
            ),
        ],
    )
    hidden = {p.name: 2e-5 if p.is_joint else 1e-6 for p in model.compliances if not p.is_coupling}
    hidden |= {
        f"force_sensor_bias_force_sensor_{k}": v
        for k, v in zip(("fx", "fy", "fz", "mx", "my", "mz"), (7.0, -2.0, -1.3, -2.0, 2.3, 2.7), strict=True)
    }
    hidden |= {"nonlinear_stiffness_2_c": 1e-4, "hysteresis_3_width": 5e-5}
    found = fit(model, _experiment(model.with_values(hidden))).model.values
    for name in [n for n in hidden if n[0] not in "ck"]:
        assert found[name] == pytest.approx(hidden[name], rel=0.01), name


@pytest.fixture(scope="module")
def finding() -> Finding:
    return diagnose(Task(load(ROBOT), measured({**HARDENING, "a": 1.5e-3}, BIAS, poses=10, seed=4)))


def test_a_gear_under_a_biased_sensor_is_found_with_its_size(finding: Finding) -> None:
    assert finding.verdict == "named"
    assert {e.effect for e in finding.named} == {"nonlinear_stiffness", "force_sensor_bias"}
    values = finding.grown.model.values
    for axis, true in zip("xyz", (25.0, -12.0, 8.0), strict=True):
        assert values[f"force_sensor_bias_force_sensor_f{axis}"] == pytest.approx(true, abs=1.5)
    assert finding.rms.after < 0.2 * finding.rms.before
    assert finding.rms.held_out_after is not None
    assert finding.rms.held_out_after < 0.4 * finding.rms.before


@pytest.mark.slow
@pytest.mark.parametrize(("poses", "seed"), [(10, 3), (11, 6), (14, 4)])
def test_looks_go_on_until_the_loads_settle(poses: int, seed: int) -> None:
    """A bias of a third of the loads moves the gear so far that a second look still has another shape of it."""
    found = diagnose(Task(load(ROBOT), measured({**HARDENING, "a": 1.5e-3}, BIAS, poses=poses, seed=seed)))
    assert found.verdict == "named"
    assert {e.effect for e in found.named} == {"nonlinear_stiffness", "force_sensor_bias"}
    assert found.rms.after < 1.2 * 0.02e-3


@pytest.mark.slow
def test_without_the_second_look_the_gap_stays_open(
    finding: Finding, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workflow, "_WORTH", np.inf)
    once = diagnose(Task(load(ROBOT), measured({**HARDENING, "a": 1.5e-3}, BIAS, poses=10, seed=4)))
    assert finding.rms.after < 0.5 * once.rms.after
