"""What no poses and loads tell apart: the redundancy of a model that was not reduced as a whole, as a grown one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.calibration.measurements import Measurements
from symstiff.calibration.rows import equations
from symstiff.model import StiffnessModel
from symstiff.reduction.structural import LOADS, Couplings
from symstiff.reduction.svd import numeric_partition

_FORCE = 100.0
"""Loads where a table has none [N, N·m]."""


def redundant(model: StiffnessModel, table: Measurements) -> Couplings:
    """Parameters whose columns are combinations of others' whatever the poses and loads, with those (seed eq. 21).

    The model's class of loads, the table's markers and components; parameters without a value are the first to go.
    Raises UserError for absolute positions, of which geometry takes a part.
    """
    e = equations(model, _anywhere(model, table))
    scale = np.where(e.component < 3, 1.0, _length(e.A, e.component))
    names = model.parameters
    first = sorted(names, key=lambda n: not model.values.get(n))
    found, _ = numeric_partition(e.A * scale[:, None], names, first)
    return {n: found.couplings.get(n, {}) for n in names if n not in found.kept}


def _anywhere(model: StiffnessModel, table: Measurements) -> Measurements:
    """Rows of a table at random joint variables under random loads, enough of them for all parameters."""
    rng = np.random.default_rng(1)
    count = 2 * len(model.parameters) + 20
    rows = table.select(rng.integers(len(table), size=count))
    low, high = np.array([joint.range for joint in model.robot.joint]).T
    q, w = rng.uniform(low, high, (count, model.robot.dof)), np.zeros((count, 6))
    for joint, value in model.fixed.items():
        q[:, joint - 1] = value
    acting = [c - 1 for c in LOADS[model.loads]]
    size = np.abs(table.w).max(initial=0.0) or _FORCE
    w[:, acting] = rng.normal(scale=size, size=(count, len(acting)))
    return replace(rows, q=q, w=w)


def _length(A: np.ndarray, component: np.ndarray) -> float:
    """Metres that weigh a radian's rows as much as the translations'."""
    turning, moving = (np.linalg.norm(A[c]) for c in (component >= 3, component < 3))
    return float(moving / turning) if moving > 0 and turning > 0 else 1.0
