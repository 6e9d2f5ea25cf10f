"""What no poses and loads tell apart: the redundancy of a model that was not reduced as a whole, as a grown one is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.calibration.experiment.anywhere import any_loads, any_poses
from symstiff.calibration.rows import equations
from symstiff.calibration.tables.measurements import Measurements
from symstiff.model import StiffnessModel
from symstiff.reduction.structural import Couplings
from symstiff.reduction.svd import numeric_partition

_FORCE = 100.0
"""Loads where a table has none [N, N·m]."""


def redundant(model: StiffnessModel, table: Measurements) -> Couplings:
    """Parameters whose columns are combinations of others' whatever is measured, with those (seed eq. 21).

    At any poses, loads of the model's class, times and temperatures, of the table's markers; parameters without a value
    are the first to go. What has no law at a virtual joint is none of them. Raises UserError for absolute positions, of
    which geometry takes a part.
    """
    e = equations(model, _anywhere(model, table))
    scale = np.where(e.component < 3, 1.0, _length(e.A, e.component))
    lawful = {term.parameter for term in model.terms}
    names = [n for n in model.parameters if n in lawful]
    A = e.A[:, [n in lawful for n in model.parameters]]
    first = sorted(names, key=lambda n: not model.values.get(n))
    found, _ = numeric_partition(A * scale[:, None], names, first)
    return {n: found.couplings.get(n, {}) for n in names if n not in found.kept}


def _anywhere(model: StiffnessModel, table: Measurements) -> Measurements:
    """Rows of a table at random joint variables, loads and moments, enough of them for all parameters.

    All of a translation is read, and of a rotation where any of one is.
    """
    rng = np.random.default_rng(1)
    count = 2 * len(model.parameters) + 20
    rows = table.select(rng.integers(len(table), size=count))
    q = any_poses(model.robot, rng, count, model.fixed)
    w = (np.abs(table.w).max(initial=0.0) or _FORCE) * any_loads(model.loads, rng, count)
    turns = table.measured[:, 3:].any()
    values = np.tile([0.0] * 3 + [0.0 if turns else np.nan] * 3, (count, 1))
    return replace(
        rows, q=q, w=w, values=values,
        time=_around(table.time, rng, count),
        temperature=_around(table.temperature, rng, count),
        branch=np.asarray(rng.choice([-1.0, 1.0], count) * np.abs(rows.branch), dtype=float),
    )  # fmt: skip


def _around(known: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Random moments (count,) in the span of the known ones, or beyond where these are all alike; NaN for none."""
    return np.asarray(known.min() + (np.ptp(known) or 1.0) * rng.uniform(size=count))


def _length(A: np.ndarray, component: np.ndarray) -> float:
    """Metres that weigh a radian's rows as much as the translations'."""
    turning, moving = (np.linalg.norm(A[c]) for c in (component >= 3, component < 3))
    return float(moving / turning) if moving > 0 and turning > 0 else 1.0
