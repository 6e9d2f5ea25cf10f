"""Identification from absolute positions: the device's placement and the links' weights enter the equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from symstiff.calibration.estimate import Estimate, estimate
from symstiff.calibration.experiment.current import settled
from symstiff.calibration.measurements import Measurements
from symstiff.calibration.residuals import ResidualTable, residual_table
from symstiff.calibration.rows import Equations, weights
from symstiff.model import StiffnessModel


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
    sigma = table.sigma[view.state, view.component]
    known = sigma if np.isfinite(sigma).all() else None
    constant = [k for k, v in enumerate(view.joints) if v.kind == "link"]
    chosen = [constant[k] for k in _independent(view.J[:, constant])]
    labels = [f"geometry_{view.joints[k].body}_{view.joints[k].axis}" for k in chosen]
    units = ["rad" if view.joints[k].rotational else "m" for k in chosen]
    A = np.hstack([elastic, view.J[:, chosen]])
    e = Equations(A, current.y, known, view.state, view.component)
    names = (*current.names, *labels)
    fit = estimate(e.A, e.y, weights(e), names, units=(*(model.units[n] for n in current.names), *units))
    before = e.spread(e.y, len(table))
    after = e.spread(e.A @ fit.values, len(table))
    return AbsoluteFit(fit, e, residual_table(before, after))


def _independent(columns: np.ndarray) -> list[int]:
    """Columns that span all of them, by pivoted QR of the scaled matrix."""
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(size > 0, size, 1.0)
    triangle, order = scipy.linalg.qr(scaled, mode="r", pivoting=True)
    rank = int((np.abs(np.diag(triangle)) > 1e-6).sum())
    return sorted(int(k) for k in order[:rank])
