"""Fits of models that are not linear in their parameters, against a UR10 written out in plain DH rows."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.effects.base import EffectInstance
from symstiff.model import StiffnessModel, joints_only
from symstiff.robot import load

DH = (
    (0, np.pi / 2, 0.1273), (-0.612, 0, 0), (-0.5723, 0, 0),
    (0, np.pi / 2, 0.163941), (0, -np.pi / 2, 0.1157), (0, 0, 0.0922),
)  # fmt: skip
MARKERS = {"p1": (0.05, 0, 0.05), "p2": (-0.025, 0.0433, 0.05), "p3": (-0.025, -0.0433, 0.05)}
COMPLIANCES = 1e-5 * (1 + np.arange(1, 7) / 10)
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


def biased() -> StiffnessModel:
    bare = joints_only(load("ur10"), "wrench", "position", points=tuple(MARKERS))
    return bare.with_effect(EffectInstance("force_sensor_bias", {"load": "force_sensor"}))


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
