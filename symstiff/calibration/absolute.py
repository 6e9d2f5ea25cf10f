"""Identification from absolute positions: the device's placement and the links' weights enter the equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from symstiff.calibration.compact import triangular
from symstiff.calibration.decomposition import svd
from symstiff.calibration.estimate import Estimate, estimate
from symstiff.calibration.experiment.current import settled, sigma_of
from symstiff.calibration.measurements import Measurements
from symstiff.calibration.residuals import ResidualTable, residual_table
from symstiff.calibration.rows import Equations, shared_blocks, weights
from symstiff.model import StiffnessModel

_OUTSIDE = 1e-4
"""Least part of a column outside others for it to count."""


@dataclass(frozen=True, eq=False)
class AbsoluteFit:
    """A fit to absolute data: the model's parameters, then the geometry; residuals beyond the rigid robot."""

    fit: Estimate
    equations: Equations
    residuals: ResidualTable


def fit_absolute(model: StiffnessModel, table: Measurements) -> AbsoluteFit:
    """Fit a model to absolute positions, with constant errors of all frames taken along.

    The excess over the rigid robot at its best placement is explained by deflections under load and weight and by an
    independent set of constants at the links' virtual joints (geometry, tool and placement of the device, called
    ``geometry_<link>_<axis>`` [m, rad]); those that a compliance could mimic are left to the geometry.
    """
    current = settled(model, table)
    view = current.situation.view
    elastic = current.A[:, : len(current.names)]
    known = sigma_of(view)
    constant = [k for k, v in enumerate(view.joints) if v.kind == "link"]
    chosen = [constant[k] for k in _independent(view.J[:, constant])]
    count = len(current.names)
    beside = current.A[:, count : count + len(current.hidden)]
    shown = _independent(_outside(beside, np.hstack([elastic, view.J[:, chosen]])))
    hidden = [current.hidden[k] for k in shown]
    labels = [f"geometry_{view.joints[k].body}_{view.joints[k].axis}" for k in chosen]
    units = ["rad" if view.joints[k].rotational else "m" for k in chosen]
    A = np.hstack([elastic, beside[:, shown], view.J[:, chosen]])
    e = Equations(A, current.y, known, view.state, view.component)
    compliances = [*(model.units[n] for n in current.names), *(p.unit for p in hidden)]
    names = (*current.names, *(p.name for p in hidden), *labels)
    fit = estimate(
        e.A,
        e.y,
        weights(e),
        names,
        units=(*compliances, *units),
        blocks=shared_blocks(e, table),
        estimated=known is None,
    )
    before = e.spread(e.y, len(table))
    after = e.spread(e.A @ fit.values, len(table))
    return AbsoluteFit(fit, e, residual_table(before, after))


def _outside(columns: np.ndarray, others: np.ndarray) -> np.ndarray:
    """What of columns, scaled to length one, lies outside the span of others; nothing where that is rounding."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0, size, 1.0)
    length = np.linalg.norm(others, axis=0)
    U, s, _ = svd(others / np.where(length > 0, length, 1.0))
    U = U[:, s > 1e-9 * s[0]]
    left = scaled - U @ (U.T @ scaled)
    return np.asarray(np.where(np.linalg.norm(left, axis=0) > _OUTSIDE, left, 0.0))


def _independent(columns: np.ndarray) -> list[int]:
    """Columns that span all of them, by pivoted QR of the scaled matrix."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0, size, 1.0)
    triangle, order = scipy.linalg.qr(triangular(scaled), mode="r", pivoting=True)
    rank = int((np.abs(np.diag(triangle)) > 1e-6).sum())
    return sorted(int(k) for k in order[:rank])
