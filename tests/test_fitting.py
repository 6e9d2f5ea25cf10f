"""Fits of models that are not linear in their parameters, against a UR10 written out in plain DH rows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from symstiff.calibration import fitting
from symstiff.calibration.fits.robust import HUBER
from symstiff.calibration.identify import identify
from symstiff.calibration.rows import predict
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel, joints_only
from symstiff.robot import load

DH = (
    (0, np.pi / 2, 0.1273), (-0.612, 0, 0), (-0.5723, 0, 0),
    (0, np.pi / 2, 0.163941), (0, -np.pi / 2, 0.1157), (0, 0, 0.0922),
)  # fmt: skip
MARKERS = {"p1": (0.05, 0, 0.05), "p2": (-0.025, 0.0433, 0.05), "p3": (-0.025, -0.0433, 0.05)}
BIAS = np.array([3, -2, 2, 0.3, -0.1, 0.2])
COMPLIANCES = 1e-5 * (1 + np.arange(1, 7) / 10)
NOISE, BAD = 1e-6, 4
NAMES = [f"force_sensor_bias_force_sensor_{n}" for n in ("fx", "fy", "fz", "mx", "my", "mz")]


def axes_of(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(6, 3) directions and (6, 3) points of the joints' axes, and the pose (4, 4) of the last frame."""
    M, z, o = np.eye(4), [], []
    for angle, (a, alpha, d) in zip(q, DH, strict=True):
        z.append(M[:3, 2].copy())
        o.append(M[:3, 3].copy())
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        M = M @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    return np.array(z), np.array(o), M


def experiment(force: float = 1.0, bad: float = 0.0, seed: int = 0) -> Measurements:
    """Twelve poses, three steps of a load times ``force``, of an arm as much stiffer; one is read ``bad`` [m] off."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(12):
        q, whole = rng.uniform(-2, 2, 6), rng.normal(size=6) * [60, 60, 60, 10, 10, 10]
        z, o, M = axes_of(q)
        for share in (1 / 3, 2 / 3, 1):
            acting = force * (share * whole + BIAS)
            torque = np.sum(z * (np.cross(M[:3, 3] - o, acting[:3]) + acting[3:]), axis=1)
            theta = COMPLIANCES / force * torque
            for marker, xyz in enumerate(MARKERS.values()):
                moved = np.sum(theta[:, None] * np.cross(z, M[:3, :3] @ xyz + M[:3, 3] - o), axis=0)
                moved += NOISE * rng.normal(size=3) + (k == BAD) * bad * np.array([1, -1, 0.5])
                rows.append((q, force * share * whole, marker, moved, k))
    q, w, point, moved, pose = zip(*rows, strict=True)
    unread = np.full((len(q), 3), np.nan)
    return measurements(
        q, w, kind="deflection", values=np.hstack([moved, unread]), points=tuple(MARKERS), point=point, pose=pose,
        sigma=np.hstack([np.full((len(q), 3), NOISE), unread]),
    )  # fmt: skip


def biased() -> StiffnessModel:
    bare = joints_only(load("ur10"), "wrench", "position", points=tuple(MARKERS))
    return bare.with_effect(EffectInstance("force_sensor_bias", {"load": "force_sensor"}))


def whitened(found: StiffnessModel, table: Measurements, p: np.ndarray) -> np.ndarray:
    """Residuals (R,) in their deviations."""
    known = dict(zip(found.parameters, p, strict=True))
    return ((table.values - predict(found, table, known))[:, :3] / NOISE).ravel()


@pytest.mark.slow
def test_a_robust_fit_of_a_force_sensors_bias_survives_a_pose_that_was_read_wrong() -> None:
    found = identify(load("ur10"), experiment(bad=5e-3), biased(), robust=True)
    bias = np.array([found.model.values[n] for n in NAMES])
    assert np.all(np.abs(bias - BIAS) < [0.2, 0.2, 0.2, 0.5, 0.5, 0.5])
    assert bias[0] == pytest.approx(3.0, abs=2.0 * found.model.deviations[NAMES[0]])
    compliances = [found.model.values[f"c{j}"] for j in range(1, 7)]
    np.testing.assert_allclose(compliances, COMPLIANCES, rtol=0.06)
    assert found.robust is not None
    assert found.robust.poses[0].label.endswith("p5")
    assert not any("settle" in r for r in found.remarks)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_robust_fit_is_at_the_least_of_hubers_loss_that_another_solver_finds_from_the_truth(
    seed: int,
) -> None:
    table = experiment(bad=1e-3, seed=seed)
    found = identify(load("ur10"), table, biased(), robust=True)
    assert found.robust is not None
    size = found.fit.std
    best = least_squares(
        lambda x: whitened(found.model, table, x * size), np.append(COMPLIANCES, BIAS) / size,
        loss="huber", f_scale=HUBER * found.robust.scale, xtol=1e-12, ftol=1e-12,
    )  # fmt: skip
    assert np.abs(best.x - found.fit.values / size).max() < 0.01


@pytest.mark.slow
def test_least_squares_end_where_no_step_fits_better() -> None:
    """A bad pose leads plain least squares far away, where undamped steps go to and fro."""
    table = experiment(bad=5e-3)
    found = identify(load("ur10"), table, biased())
    p = found.model.vector()
    size = np.where(np.abs(p) > 0, np.abs(p), 1.0)
    there = float(np.sum(whitened(found.model, table, p) ** 2))
    best = least_squares(lambda x: whitened(found.model, table, x * size), p / size, method="lm")
    assert there < (1.0 + 1e-6) * float(np.sum(best.fun**2))
    assert found.fit.s0_squared * found.fit.dof == pytest.approx(there, rel=1e-6)


@pytest.mark.slow
def test_a_fit_that_did_not_settle_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, "_ROUNDS", 2)
    found = identify(load("ur10"), experiment(bad=5e-3), biased())
    assert any(r.startswith("the fit did not settle") for r in found.remarks)
    np.testing.assert_array_equal(found.fit.values, found.model.vector())


@pytest.mark.slow
@pytest.mark.parametrize("force", [1e-6, 1e6])
def test_a_soft_arm_under_small_loads_is_fitted_as_a_stiff_one_under_large_loads(force: float) -> None:
    usual = identify(load("ur10"), experiment(), biased())
    found = identify(load("ur10"), experiment(force), biased())
    size = np.where(np.arange(12) < 6, 1 / force, force)
    assert found.fit.names == (*(f"c{j}" for j in range(1, 7)), *NAMES)
    np.testing.assert_allclose(found.fit.values / size, usual.fit.values, rtol=1e-5, atol=0)
    np.testing.assert_allclose(found.fit.std / size, usual.fit.std, rtol=1e-3)
    assert found.training.compensated == pytest.approx(usual.training.compensated, abs=1e-6)


@pytest.mark.parametrize("force", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("compiled", [False, True])
def test_the_column_of_a_bias_beside_a_gear_that_saturates_is_its_derivative(
    force: float, compiled: bool
) -> None:
    """Of Σ J_j·(c_j·τ_j + c·τ₀·tanh(τ₃/τ₀)) by a force along z: Σ J_j·(c_j + c·sech²(τ₃/τ₀))·∂τ_j/∂f_z."""
    top, soft, bias = 20.0 * force, 4e-5 / force, force * np.array([3.0, -1.5, 2.1, 0.3, -0.15, 0.24])
    gear = EffectInstance(
        "nonlinear_stiffness", {"joint": 3}, {"load": top, "saturation": 1.0, "weights": 0.0}
    )
    model = biased().with_effect(gear)
    values = {f"c{j}": c / force for j, c in enumerate(COMPLIANCES, start=1)}
    values |= dict(zip(NAMES, bias.tolist(), strict=True)) | {"nonlinear_stiffness_3_c": soft}
    rng = np.random.default_rng(0)
    q, w = rng.uniform(-2, 2, (20, 6)), rng.normal(size=(20, 6)) * [60, 60, 60, 10, 10, 10] * force
    found = (model.compile() if compiled else model).observation(q, w, values=values)
    expected = []
    for angles, wrench in zip(q, w, strict=True):
        z, o, M = axes_of(angles)
        J = np.vstack([np.cross(z, M[:3, 3] - o).T, z.T])
        slope = COMPLIANCES / force
        slope[2] += soft / np.cosh((J.T @ (wrench + bias))[2] / top) ** 2
        expected.append(J @ (slope * J[2]))
    column = found[:, :, model.parameters.index(NAMES[2])]
    assert np.abs(column - expected).max() < 1e-6 * np.abs(expected).max()
