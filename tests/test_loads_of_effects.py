"""Loads that an effect adds act on compliances that come from the same data: their columns have to hold."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.fits.decomposition import column_space
from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose, first_assembly
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.robot import load

PAYLOAD = Effect("payload_error", None, "tool", {"dm": 20.0, "dmc": [1.5, -0.8, -3.6]})
HEAVY = Effect("payload_error", None, "tool", {"dm": 100.0, "dmc": [7.5, -4.0, -18.0]})
SHIFT = [1.6e-4, -1.3e-4, -5.8e-5, -1.5e-4, -1.2e-4, 9.2e-5]
GEOMETRY = Effect("geometric_error", {"link": 2}, "constant", {"shift": SHIFT})
EXACT = Noise(sigma_mm=(0.0, 0.0, 0.0))
MISSED = Noise(sigma_mm=(0.014, 0.014, 0.014), approach_mm=(0.04, 0.04, 0.04))
"""Poses that are missed by three times the noise, for all of their load cases."""


def experiment(*effects: Effect, noise: Noise, seed: int = 1) -> Measurements:
    """Absolute positions of three markers, three loads a pose."""
    robot, rng = load("kuka_kr270"), np.random.default_rng(5)
    values = {n: v * float(np.exp(0.25 * rng.normal())) for n, v in nominal_truth(robot).items()}
    limits = np.array([j.range for j in robot.joint])
    q = rng.uniform(limits[:, 0], limits[:, 1], (15, 6))
    w = rng.normal(size=(15, 6)) * [900, 900, 900, 200, 200, 200]
    each, n = 9, 15 * 9
    table = measurements(
        np.repeat(q, each, axis=0),
        np.repeat(w, each, axis=0) * np.tile(np.repeat([1 / 3, 2 / 3, 1.0], 3), 15)[:, None],
        pose=np.repeat(np.arange(15), each),
        points=("p1", "p2", "p3"),
        point=np.tile(np.arange(3), n // 3),
        kind="absolute",
    )
    return simulate(Truth(robot, values, effects, noise), table, seed)


def start() -> StiffnessModel:
    return StiffnessModel.of(reduce(load("kuka_kr270"), "wrench", "position"))


def left(signal: np.ndarray, A: np.ndarray, block: np.ndarray) -> float:
    """Share of a signal (M,) outside the model that an effect's columns leave."""
    basis = column_space(A)
    rest = signal - basis @ (basis.T @ signal)
    own = column_space(block - basis @ (basis.T @ block), 1e-7)
    return float(np.sum((rest - own @ (own.T @ rest)) ** 2) / np.sum(rest**2))


@pytest.mark.parametrize("others", [(), (GEOMETRY,)])
def test_a_payload_has_its_own_columns_though_the_robot_misses_its_poses(others: tuple[Effect, ...]) -> None:
    """Also where another effect stands in the data that no model holds yet."""
    table = experiment(PAYLOAD, *others, noise=MISSED)
    signal = experiment(PAYLOAD, noise=EXACT).values - experiment(noise=EXACT).values
    found = first_assembly(start(), table)
    block = next(c for c in found.candidates if c.effect == "payload_error").columns({})
    view = found.situation.view
    assert left(signal[view.state, view.component], found.problem.A, block) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("others", [(), (GEOMETRY,)])
def test_a_payload_far_above_the_noise_is_no_weight_of_a_link(others: tuple[Effect, ...]) -> None:
    table = experiment(HEAVY, *others, noise=MISSED)
    finding = diagnose(Task(load("kuka_kr270"), table))
    assert {e.effect for e in finding.named} == {"payload_error", *(e.effect for e in others)}
    mass = next(e for e in finding.named if e.effect == "payload_error").parameters["payload_error_payload_m"]
    assert abs(mass.value - 100.0) < 3.0 * mass.std
    assert mass.std < 3.0


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("name", "force"), [("kuka_kr270", 2000.0), ("franka_panda", 30.0)])
def test_a_sensors_bias_has_its_own_columns_where_the_experiment_had_no_load(
    name: str, force: float, axis: int
) -> None:
    """Vertical forces do not tell how soft the wrist is against the lateral force that the sensor keeps to itself."""
    robot, rng = load(name), np.random.default_rng(3)
    limits = np.array([j.range for j in robot.joint])
    q = np.repeat(rng.uniform(limits[:, 0], limits[:, 1], (30, robot.dof)), 3, axis=0)
    down = np.tile([0.0, 0.0, -force, 0.0, 0.0, 0.0], (90, 1)) * np.tile([1 / 3, 2 / 3, 1.0], 30)[:, None]
    design = measurements(q, down, pose=np.repeat(np.arange(30), 3), joint_units=["rad"] * robot.dof)
    bias = [0.1 * force if k == axis else 0.0 for k in range(6)]
    hidden = Effect("force_sensor_bias", None, "constant", {"bias": bias})
    with_it, without, table = (
        simulate(Truth(robot, nominal_truth(robot), effects, noise), design, 1)
        for effects, noise in (((hidden,), EXACT), ((), EXACT), ((), Noise(sigma_mm=(0.01,) * 3)))
    )
    found = first_assembly(StiffnessModel.of(reduce(robot, "gravity", "position")), table)
    block = next(c for c in found.candidates if c.effect == "force_sensor_bias").columns({})
    view = found.situation.view
    signal = (with_it.values - without.values)[view.state, view.component]
    assert left(signal, found.problem.A, block) < 0.005
