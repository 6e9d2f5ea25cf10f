"""Joint commands that put the loaded tool where the unloaded one should be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from symstiff.codegen.reference import unit_length
from symstiff.model import StiffnessModel
from symstiff.symbolic.numeric import forward, joint_jacobian

_ROUNDS = 12
_SINGULAR = 1e-10


@dataclass(frozen=True, eq=False)
class Compensated:
    """Corrected commands q_cmd (N, n), what is left of the pose error (N, 6) [m, rad], and which rows were solved."""

    q_cmd: np.ndarray
    before: np.ndarray
    after: np.ndarray
    solved: np.ndarray


def compensate_online(
    model: StiffnessModel, q: np.ndarray, w: np.ndarray, context: Mapping[str, np.ndarray] | None = None
) -> np.ndarray:
    """q_cmd = q − J(q)⁺·Δt(q, W): one step, as the generated C function ``compensate`` (N, n).

    Rows in a singular pose keep their q.
    """
    q = np.atleast_2d(np.asarray(q, dtype=float))
    step, solved = _step(model, q, model.deflection(q, w, context=context))
    return np.where(solved[:, None], q - step, q)


def compensate(
    model: StiffnessModel, q: np.ndarray, w: np.ndarray, context: Mapping[str, np.ndarray] | None = None
) -> Compensated:
    """Solve T(q_cmd)·Δt(q_cmd, W) = T(q) by Newton steps with the nominal Jacobian (off-line compensation).

    Where the robot cannot reach all six coordinates the weighted error that is left is the smallest; ``solved`` is
    False for rows in a singular pose, which keep their q.
    """
    q = np.atleast_2d(np.asarray(q, dtype=float))
    target = forward(model.robot, q)
    command, solved = q.copy(), np.ones(len(q), dtype=bool)
    before = _error(model, target, q, w, context)
    for _ in range(_ROUNDS):
        step, regular = _step(model, command, _error(model, target, command, w, context))
        solved &= regular
        command = np.where(solved[:, None], command - step, q)
        if np.abs(step[solved]).max(initial=0.0) < 1e-13:
            break
    return Compensated(command, before, _error(model, target, command, w, context), solved)


def _error(
    model: StiffnessModel,
    target: np.ndarray,
    q: np.ndarray,
    w: np.ndarray,
    context: Mapping[str, np.ndarray] | None,
) -> np.ndarray:
    """Loaded pose at q minus target, as a twist in base axes (N, 6)."""
    from scipy.spatial.transform import Rotation

    deflection = model.deflection(q, w, context=context)
    pose = forward(model.robot, q)
    turned = Rotation.from_rotvec(deflection[:, 3:]) * Rotation.from_matrix(pose[:, :3, :3])
    away = turned * Rotation.from_matrix(target[:, :3, :3]).inv()
    return np.hstack([pose[:, :3, 3] + deflection[:, :3] - target[:, :3, 3], away.as_rotvec()])


def _step(model: StiffnessModel, q: np.ndarray, twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joint motions that cause a twist: exact, of least norm, or in least squares; and which rows are regular."""
    scale = np.array([1.0, 1.0, 1.0, *[unit_length(model)] * 3])
    J = joint_jacobian(model.robot, q) * scale[None, :, None]
    u, s, vt = np.linalg.svd(J, full_matrices=False)
    regular = s[:, -1] > _SINGULAR * s[:, 0]
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > _SINGULAR * s[:, :1])
    step = np.einsum("nki,nk,njk,nj->ni", vt, inverse, u, twist * scale)
    return step, regular
