"""What is measured at a pose, as whitened rows of the observation matrix: one row, one unit of noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from symstiff.calibration.planning.frames import Geometry, flange_rotation
from symstiff.errors import UserError
from symstiff.robot import Robot

BASELINE = 0.3
"""Distance over which the rotation of a measured body is read from its points [m]."""


@dataclass(frozen=True)
class Measurement:
    """The pose of the tool centre point, or the positions of markers.

    ``offsets`` are the markers' positions relative to the tool centre point in the axes of frame n [m];
    without any, the full pose is measured. ``sigma_t`` [m] and ``sigma_r`` [rad] are standard deviations of
    one component of a translation and of a rotation.
    """

    offsets: tuple[tuple[float, float, float], ...] = ()
    sigma_t: float = 30e-6
    sigma_r: float = 100e-6

    def __post_init__(self) -> None:
        if not (0 < self.sigma_t < np.inf and 0 < self.sigma_r < np.inf):
            raise UserError(
                f"sigma_t = {self.sigma_t:g} m, sigma_r = {self.sigma_r:g} rad: "
                "a standard deviation is positive"
            )

    @cached_property
    def weights(self) -> np.ndarray:
        """Map from the twist in the axes of frame n to the whitened rows that carry all of it, (m, 6).

        Many markers on a rigid body tell no more than six numbers. The rows are the triangular factor of the
        stacked marker rows, so their Gram matrix, hence the information, is that of all markers.
        """
        if not self.offsets:
            return np.diag([1 / self.sigma_t] * 3 + [1 / self.sigma_r] * 3)
        stacked = np.concatenate([marker_rows(np.array(o)) for o in self.offsets]) / self.sigma_t
        if len(stacked) <= 6:
            return stacked
        factor = np.linalg.qr(stacked, mode="r")
        return np.asarray(factor[np.linalg.norm(factor, axis=1) > 1e-9 * np.linalg.norm(factor)])

    @property
    def rows(self) -> int:
        """Number of whitened rows a pose gives, m ≤ 6."""
        return len(self.weights)


def measurement_of(
    robot: Robot, markers: tuple[str, ...] = (), sigma_t: float = 30e-6, sigma_r: float = 100e-6
) -> Measurement:
    """Return the measurement of named markers (``tcp`` is the tool centre point), or of the pose."""
    tool = np.array([float(c) for c in robot.tool.xyz])
    points = [np.array([float(c) for c in robot.marker_position(name)]) - tool for name in markers]
    return Measurement(tuple((float(x), float(y), float(z)) for x, y, z in points), sigma_t, sigma_r)


def marker_rows(offset: np.ndarray) -> np.ndarray:
    """Return the map from a twist to the translation of a point at ``offset``, dt + dr × offset, (3, 6)."""
    x, y, z = offset
    return np.hstack([np.eye(3), np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])])


def whitened_rows(
    measurement: Measurement, robot: Geometry, q: np.ndarray, observation: np.ndarray
) -> np.ndarray:
    """Turn observation matrices (N, 6, P) into whitened rows, (m, N, P): the layout of the exchange."""
    if not measurement.offsets:
        return np.ascontiguousarray(
            np.swapaxes(observation, 0, 1) * np.diag(measurement.weights)[:, None, None]
        )
    rotation = flange_rotation(robot, q)
    local = np.concatenate(
        [np.einsum("nba,nbp->nap", rotation, part) for part in (observation[:, :3], observation[:, 3:])],
        axis=1,
    )
    return np.ascontiguousarray(np.einsum("ma,nap->mnp", measurement.weights, local))


def whitened_rows_symbolic(measurement: Measurement, rotation: Any, observation: Any) -> Any:
    """Return the same rows for one pose as a CasADi expression (m, P); ``rotation`` is frame n's (3, 3)."""
    import casadi as ca

    if not measurement.offsets:
        return ca.mtimes(ca.DM(measurement.weights), observation)
    local = ca.vertcat(ca.mtimes(rotation.T, observation[:3, :]), ca.mtimes(rotation.T, observation[3:, :]))
    return ca.mtimes(ca.DM(measurement.weights), local)
