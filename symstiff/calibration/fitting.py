"""Fit of a deflection table: least squares or Huber's loss, in rounds where the model is not linear."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from symstiff.calibration.experiment.rounding import without_rounding
from symstiff.calibration.fits.estimate import Estimate, estimate
from symstiff.calibration.fits.robust import HUBER, RobustEstimate, robust_estimate
from symstiff.calibration.fits.shared import Blocks
from symstiff.calibration.rows import (
    Equations,
    context_of,
    equations,
    moved_by_joints,
    predict,
    shared_blocks,
    weights,
)
from symstiff.calibration.tables.measurements import COMPONENTS, Measurements
from symstiff.codegen.runtime import for_poses
from symstiff.model import StiffnessModel, bilinear
from symstiff.slopes import steps_at

_ROUNDS = 50
_SETTLED = 1e-3
"""Last step of every parameter, in its standard deviations, with which a fit has settled."""
_EXACT = 1e-9
"""Change of the predictions, against the largest reading, below which a step is rounding."""
_HALVINGS = 10


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model's parameters fitted to a table; equations: those of the last round; robust: where Huber's loss was taken.

    settled: whether the last round moved nothing any more.
    """

    estimate: Estimate
    equations: Equations
    robust: RobustEstimate | None
    settled: bool = True


def fit_model(
    model: StiffnessModel, table: Measurements, *, robust: bool = False, held: Collection[str] = ()
) -> Fitted:
    """Fit all parameters jointly; Gauss–Newton with damped steps where the model is not linear in them.

    ``held``: parameters that keep the model's values, zero where it has none.
    """
    if model.is_linear:
        return _linearised(model, table, model.values, robust, held)
    values = dict(model.values)
    if robust:
        values |= _without_load_errors(model, table, held)
    for _ in range(_ROUNDS):
        found = _linearised(model, table, values, robust, held)
        fit, e = found.estimate, found.equations
        step = fit.values - _of(fit, values)
        moved = np.abs(step / np.where(fit.std > 0, fit.std, 1.0)).max(initial=0.0)
        if moved < _SETTLED or np.abs(e.A @ step).max() < _EXACT * np.abs(e.y).max():
            return found
        values = _downhill(model, table, values, found)
    return replace(found, estimate=_at(fit, _of(fit, values)), settled=False)


def _of(fit: Estimate, values: Mapping[str, float]) -> np.ndarray:
    """Values of a fit's parameters, in order."""
    return np.array([values.get(n, 0.0) for n in fit.names])


def _linearised(
    model: StiffnessModel,
    table: Measurements,
    values: Mapping[str, float],
    robust: bool,
    held: Collection[str],
) -> Fitted:
    """The fit of the equations at these values, of the parameters that are not held there."""
    e = equations(model, table, values)
    free = np.array([n not in held for n in model.parameters])
    names = tuple(n for n in model.parameters if n not in held)
    A = without_rounding(e.A[:, free], _sizes(model, table, values)[free])
    y = e.y - e.A[:, ~free] @ model.vector(values)[~free]
    blocks = shared_blocks(e, table, model.robot, moved_by_joints(model, table, e))
    return _fit(replace(e, A=A, y=y), table, blocks, names, [model.units[n] for n in names], robust)


def _fit(
    e: Equations, table: Measurements, blocks: Blocks, names: tuple[str, ...], units: list[str], robust: bool
) -> Fitted:
    sigma, estimated = weights(e), e.sigma is None
    if not robust:
        return Fitted(
            estimate(e.A, e.y, sigma, names, units=units, blocks=blocks, estimated=estimated), e, None
        )
    rows = zip(e.row, e.component, strict=True)
    strong = robust_estimate(
        e.A, e.y, sigma, names, units=units, blocks=blocks, estimated=estimated,
        groups=table.pose[e.row], labels=table.labels,
        row_labels=[f"{table.place(int(r))}, {COMPONENTS[c]}" for r, c in rows],
    )  # fmt: skip
    return Fitted(strong.estimate, e, strong)


def _sizes(model: StiffnessModel, table: Measurements, values: Mapping[str, float]) -> np.ndarray:
    """(P,) sizes that move the tool alike; usual ones where the model is linear."""
    if model.is_linear:
        return np.array([model.steps[n] for n in model.parameters])
    evaluator, context = for_poses(model, len(table.q)), context_of(model, table)

    def moved(p: np.ndarray) -> np.ndarray:
        return evaluator.deflection(
            table.q, table.w, values=dict(zip(model.parameters, p, strict=True)), context=context
        )

    return steps_at(model, moved, model.vector(values))


def _without_load_errors(
    model: StiffnessModel, table: Measurements, held: Collection[str]
) -> dict[str, float]:
    """Huber's fit of what the model is linear in, errors of the load and the device as they are: where to begin.

    Beside a bad pose the first round of a joint fit may lead far away.
    """
    errors = {t.parameter for t in model.terms if bilinear(t)}
    fit = _linearised(model, table, model.values, True, errors.union(held)).estimate
    known = zip(fit.names, fit.values, fit.std, strict=True)
    return {n: float(v) for n, v, std in known if np.isfinite(std)}


def _downhill(
    model: StiffnessModel, table: Measurements, values: Mapping[str, float], found: Fitted
) -> dict[str, float]:
    """The values after the whole step, or a half of it, a quarter, …: the first that fits no worse.

    Where none does that is rounding, and the shortest step goes on.
    """
    e, fit = found.equations, found.estimate
    start = _of(fit, values)
    now = _loss(e.y - e.A @ start, found)
    for share in 0.5 ** np.arange(_HALVINGS):
        p = start + share * (fit.values - start)
        after = {**values, **dict(zip(fit.names, p.tolist(), strict=True))}
        left = table.values - predict(model, table, after)
        if _loss(left[e.row, e.component], found) <= now:
            break
    return after


def _loss(residuals: np.ndarray, found: Fitted) -> float:
    """Squares of whitened residuals, or Huber's loss of them at the scale of this round."""
    sigma = weights(found.equations)
    size = np.abs(residuals if sigma is None else residuals / sigma)
    limit = HUBER * found.robust.scale if found.robust is not None and found.robust.iterations else np.inf
    inside = np.minimum(size, limit)
    return float(np.sum(inside * (2.0 * size - inside)))


def _at(fit: Estimate, values: np.ndarray) -> Estimate:
    """The record of a fit moved to other values."""
    by = values - fit.values
    return replace(fit, values=values, lower=fit.lower + by, upper=fit.upper + by)
