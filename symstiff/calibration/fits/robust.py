"""Robust identification: Huber weights by iteration, the scale by the median, and a report of outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from symstiff.arrays import Array
from symstiff.calibration.fits.compact import checked, compact
from symstiff.calibration.fits.components import doubt_of
from symstiff.calibration.fits.estimate import Estimate, estimate, interval_factor
from symstiff.calibration.fits.outliers import UNTESTABLE, HuberFit, Suspect, pose_suspects, row_suspects
from symstiff.calibration.fits.rank import combinations, resolved_root
from symstiff.calibration.fits.shared import Blocks, SharedError, shared_error
from symstiff.display import finite
from symstiff.reduction.svd import svd

HUBER = 1.345  # of the scale: 95 % efficient on normal noise
_MAD_TO_SIGMA = 1.482602218505602
_ROUNDS = 200


@dataclass(frozen=True, eq=False)
class RobustEstimate:
    """A Huber fit: `estimate` holds values and their deviations; weights: (M,) in (0, 1].

    scale: noise of a whitened row by the median absolute residual (1 where sigma was right); rows, poses:
    suspects, worst first.
    """

    estimate: Estimate
    weights: Array
    scale: float
    rows: tuple[Suspect, ...]
    poses: tuple[Suspect, ...]
    iterations: int
    converged: bool

    def to_dict(self) -> dict[str, Any]:
        """A JSON-ready record."""

        def listed(suspects: tuple[Suspect, ...]) -> list[dict[str, Any]]:
            return [
                {"label": s.label, "size": s.size, "weight": s.weight, "p_value": s.p_value} for s in suspects
            ]

        return self.estimate.to_dict() | {
            "robust": {
                "scale": finite(self.scale),
                "iterations": self.iterations,
                "converged": self.converged,
                "rows": listed(self.rows),
                "poses": listed(self.poses),
            }
        }


def robust_estimate(
    A: Array,
    y: Array,
    sigma: Array | None = None,
    names: Sequence[str] | None = None,
    *,
    groups: npt.ArrayLike | None = None,
    labels: Sequence[str] | None = None,
    row_labels: Sequence[str] | None = None,
    units: Sequence[str] | None = None,
    blocks: npt.ArrayLike | Blocks | None = None,
    estimated: bool = False,
    significance: float = 0.01,
) -> RobustEstimate:
    """Identify with Huber's loss on whitened residuals and report which rows and poses do not fit.

    A: (M, P), y, sigma, blocks, estimated as in `estimate`; groups: (M,) pose index of every row, with labels by index;
    row_labels: (M,); significance: chance that a clean data set shows any suspect row (and any suspect pose). Residuals
    beyond HUBER·scale count linearly. Raises UserError as `estimate`. Source: Huber, Robust Statistics.
    """
    start = estimate(A, y, sigma, names, units=units, blocks=blocks, estimated=estimated)
    A, y, sigma, _ = checked(A, y, sigma, start.names)
    _, s, Vt = svd(start.compact.R, full=True)
    root = resolved_root(start.compact, s, Vt, start.rank.rank)
    Q = (A if sigma is None else A / sigma[:, None]) @ root
    fit = _huber(Q, y if sigma is None else y / sigma)
    if fit.iterations:
        start = _with_fit(start, A, y, sigma, root, Q, fit, blocks, estimated)
    rows = row_suspects(Q, fit, row_labels, significance, start.shared)
    poses = (
        ()
        if groups is None
        else pose_suspects(Q, fit, np.asarray(groups), labels, significance, start.shared)
    )
    return RobustEstimate(start, fit.weights, fit.scale, rows, poses, fit.iterations, fit.converged)


def _huber(Q: Array, target: Array) -> HuberFit:
    """Iterate weights and scale in an orthonormal basis, where the weighted system is well conditioned."""
    rows, rank = Q.shape
    weights, scale, iterations, converged = np.ones(rows), 0.0, 0, rows <= rank
    free = np.sqrt(np.maximum(1.0 - np.sum(Q**2, axis=1), 0.0))  # what a residual keeps of its row's noise
    told = free > np.sqrt(UNTESTABLE)
    floor = 1e-12 * float(np.sqrt(np.mean(target**2)))
    system = np.eye(rank)
    solution = Q.T @ target
    residual = target - Q @ solution
    while not converged and iterations < _ROUNDS:
        scale = _MAD_TO_SIGMA * float(np.median(np.abs(residual[told]) / free[told]))
        if scale <= floor:
            break
        iterations += 1
        weights = 1.0 / np.maximum(np.abs(residual) / (HUBER * scale), 1.0)
        system = Q.T @ (weights[:, None] * Q)
        previous, solution = solution, np.asarray(np.linalg.solve(system, Q.T @ (weights * target)), float)
        residual = target - Q @ solution
        # In this basis every coordinate has the noise's standard deviation.
        converged = bool(np.max(np.abs(solution - previous)) < 1e-5 * scale)
    return HuberFit(solution, residual, weights, system, scale, iterations, converged or scale <= floor)


def _with_fit(
    start: Estimate,
    A: Array,
    y: Array,
    sigma: Array | None,
    root: Array,
    Q: Array,
    fit: HuberFit,
    blocks: npt.ArrayLike | Blocks | None,
    estimated: bool,
) -> Estimate:
    """The least-squares record with the robust values and Huber's covariance in place of its own."""
    values = root @ fit.solution
    variance, scatter, covariance, shared = _huber_covariance(root, Q, fit, blocks, sigma)
    freedom = np.full(len(values), float(start.dof))
    if estimated and sigma is not None:
        doubt = doubt_of(A, scatter * sigma, sigma, root)
        covariance, freedom = covariance + doubt.covariance, doubt.freedom
    std = np.where(np.isinf(start.std), np.inf, np.sqrt(np.diag(covariance)))
    half = std * interval_factor(start.confidence, freedom)
    return replace(
        start,
        values=values,
        std=std,
        lower=values - half,
        upper=values + half,
        covariance=covariance,
        residuals=y - A @ values,
        whitened=fit.residual,
        s0_squared=float(fit.residual @ fit.residual) / start.dof,
        unit_variance=variance,
        freedom=freedom,
        compact=compact(A, y, sigma, fit.weights),
        fit_p=None,
        shared=shared,
        combinations=combinations(start.rank, start.names, start.compact.scale, values, covariance),
    )


def _huber_covariance(
    root: Array,
    Q: Array,
    fit: HuberFit,
    blocks: npt.ArrayLike | Blocks | None,
    sigma: Array | None,
) -> tuple[float, Array, Array, SharedError | None]:
    """Huber's variance of a row, what its fit scatters by (M,), the covariance (P, P), the error that rows share."""
    limit, (rows, rank) = HUBER * fit.scale, Q.shape
    share = float(np.mean(np.abs(fit.residual) <= limit))
    clipped = np.clip(fit.residual, -limit, limit)
    correction = 1.0 + rank / rows * (1.0 - share) / share
    variance = correction**2 * (float(np.sum(clipped**2)) / (rows - rank)) / share**2
    scatter = clipped / share
    # least squares of these pseudo-values is Huber's fit, and they scatter as its estimate does
    shared = None if blocks is None else shared_error(Q, Q @ fit.solution + scatter, blocks, sigma)
    if shared is None:
        return variance, scatter, variance * (root @ root.T), None
    own = correction**2 * shared.variance
    return variance, scatter, own * (root @ Q.T @ shared.covariance_times(Q) @ root.T), shared
