"""Identification under physics: some complete admissible parameter set must stand behind the reduced one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, fdtrc

from symstiff.arrays import Array
from symstiff.calibration.fits.estimate import Estimate
from symstiff.display import finite
from symstiff.errors import UserError
from symstiff.reduction.admissible import AdmissibleSet, admissible_set, scales
from symstiff.reduction.conic import Constraint, Solution, dual_matrix, semidefinite, solve
from symstiff.reduction.svd import svd

_PULL = 1e-12
"""Weight of a pull to zero beside the data: it moves nothing that is determined and keeps the rest from drifting."""
_ACTIVE = 1e-6  # sizes: a block whose least eigenvalue is below touches its bound
_COSTS = 1e-3  # ½·chi² per size: a multiplier below is the solver's rounding


@dataclass(frozen=True)
class ActiveBound:
    """A condition that the data press against.

    slack: least eigenvalue, in sizes (nominal ones times a common factor that brings them to the data's
    magnitude); multiplier: rate at which ½·chi² falls as the bound gives way, per size: the trace of the
    condition's multiplier matrix; directions: k(k+1)/2 in which a matrix with k eigenvalues at the bound could go on.
    """

    label: str
    slack: float
    multiplier: float
    directions: int

    def __str__(self) -> str:
        return f"{self.label}: at its bound, where it costs {self.multiplier:.2g} of chi²/2 by its usual size"


@dataclass(frozen=True, eq=False)
class ConstrainedEstimate:
    """A least-squares fit inside the admissible set.

    values: (r,) reduced parameters; complete: (n,) an admissible set with P·complete = values; chi2,
    free_chi2: sums of squares with and without the conditions, in units of the noise and of what rows share; active:
    bounds pressed against, hardest first; multipliers: by block, of its matrix in SI units; implausible_p: no less
    than the chance that noise alone makes the conditions cost as much (small: the data contradict the model).
    """

    names: tuple[str, ...]
    values: Array
    complete_names: tuple[str, ...]
    complete: Array
    chi2: float
    free_chi2: float
    active: tuple[ActiveBound, ...]
    multipliers: dict[str, Array]
    implausible_p: float

    def to_dict(self) -> dict[str, Any]:
        """A JSON-ready record."""
        return {
            "parameters": dict(zip(self.names, map(float, self.values), strict=True)),
            "complete": dict(zip(self.complete_names, map(float, self.complete), strict=True)),
            "chi2": finite(self.chi2),
            "chi2_without_conditions": finite(self.free_chi2),
            "implausible_p": finite(self.implausible_p),
            "active": [{"bound": a.label, "slack": a.slack, "multiplier": a.multiplier} for a in self.active],
        }


def constrain(
    fit: Estimate,
    P: Array | None = None,
    complete_names: Sequence[str] | None = None,
    *,
    nominal: Mapping[str, float] | None = None,
) -> ConstrainedEstimate:
    """Minimise the same sum of squares over the reduced sets that have an admissible complete set.

    fit: the free estimate (its triangular form is reused, so rows are not needed again); P: (r, n) with
    reduced = P·complete, identity where absent; nominal: sizes of the complete parameters. Link matrices
    positive semidefinite, joints ≥ 0. Raises UserError for shapes that do not fit. A second-order-cone or semidefinite
    program in the triangular form: no normal equations.
    """
    complete_names = tuple(fit.names if complete_names is None else complete_names)
    P = np.eye(len(fit.names), len(complete_names)) if P is None else np.asarray(P, dtype=float)
    if P.shape != (len(fit.names), len(complete_names)):
        raise UserError(
            f"mapping of shape {P.shape} does not fit {len(fit.names)} identified and {len(complete_names)} "
            "complete parameters: give the mapping of the same reduction"
        )
    rules = admissible_set(complete_names)
    scale = _sizes(complete_names, nominal, P, fit.values)
    rows, data, rest = _weighed(fit)
    columns = rows @ P * scale  # (k, n)
    size = float(np.linalg.norm(data)) or 1.0
    solution = _solved(columns / size, data / size, rules, scale)
    x = solution.x[: len(scale)]
    chi2 = rest + float(np.sum((columns @ x - data) ** 2))
    free_chi2 = rest + float(np.sum((rows @ fit.values - data) ** 2))
    duals = zip(rules.blocks, solution.duals[1:], strict=True)
    pressure = {block.label: size**2 * dual_matrix(block, dual) for block, dual in duals}
    multipliers = {b.label: pressure[b.label] / np.outer(b.axes(scale), b.axes(scale)) for b in rules.blocks}
    active = _active(rules, scale, scale * x, pressure)
    implausible = _tail(max(chi2 - free_chi2, 0.0), sum(bound.directions for bound in active), fit)
    return ConstrainedEstimate(
        fit.names, P @ (scale * x), complete_names, scale * x, chi2, free_chi2, active, multipliers, implausible
    )  # fmt: skip


def _solved(columns: Array, data: Array, rules: AdmissibleSet, scale: Array) -> Solution:
    """The least squares of columns (k, n) and data (k,), of order one, inside the admissible set of sizes (n,)."""
    k, n = columns.shape
    constraints = [Constraint("zero", np.hstack([columns, -np.eye(k)]), data)]
    constraints += semidefinite(rules, scale, n + k)
    quadratic = np.concatenate([np.full(n, _PULL), np.ones(k)])
    solution = solve(quadratic, np.zeros(n + k), constraints)
    if solution.status != "solved":
        raise ArithmeticError(f"constrained fit: the conic solver stopped with {solution.status}")
    return solution


def _weighed(fit: Estimate) -> tuple[Array, Array, float]:
    """Rows (k, r) and data (k,) whose noise is independent and of variance one, and the sum of squares beyond them.

    The triangular form in the metric of the fit's covariance, which holds what rows share; directions that the fit did
    not resolve keep the rows' own noise.
    """
    form, rank = fit.compact, fit.rank.rank
    U = svd(form.R, full=True)[0]
    own = fit.unit_variance if math.isfinite(fit.unit_variance) and fit.unit_variance > 0 else 1.0
    rows, data = U.T @ (form.R * form.scale), U.T @ form.z
    covariance = rows[:rank] @ fit.covariance @ rows[:rank].T
    if np.isfinite(covariance).all() and np.linalg.eigvalsh(covariance).min(initial=1.0) > 0:
        factor = np.linalg.cholesky(covariance)
        rows[:rank], data[:rank] = np.linalg.solve(factor, rows[:rank]), np.linalg.solve(factor, data[:rank])
    else:  # data without noise, or none left to tell it
        rows[:rank], data[:rank] = rows[:rank] / math.sqrt(own), data[:rank] / math.sqrt(own)
    rows[rank:], data[rank:] = rows[rank:] / math.sqrt(own), data[rank:] / math.sqrt(own)
    return rows, data, form.rest / own


def _tail(cost: float, directions: int, fit: Estimate) -> float:
    """Probability that noise alone makes the conditions cost as much; by F where the residuals tell the noise."""
    if not directions:
        return 1.0
    if fit.fit_p is None and fit.dof > 0:
        return float(fdtrc(directions, fit.dof, cost / directions))
    return float(chdtrc(directions, cost))


def _sizes(names: Sequence[str], nominal: Mapping[str, float] | None, P: Array, values: Array) -> Array:
    """(n,) nominal sizes, all times one factor so that the free solution is of order one in them."""
    scale = scales(names, nominal)
    norms = np.linalg.norm(P * scale, axis=1)
    gain = float(np.max(np.abs(values) / np.where(norms > 0, norms, np.inf), initial=0.0))
    return scale * (gain or 1.0)


def _active(
    rules: AdmissibleSet, scale: Array, values: Array, pressure: Mapping[str, Array]
) -> tuple[ActiveBound, ...]:
    """Blocks at their bound whose multiplier costs something, hardest first."""
    found = []
    for label, size in rules.eigenvalues(values, scale).items():
        at_bound, cost = int(np.sum(size < _ACTIVE)), float(np.trace(pressure[label]))
        if at_bound and cost > _COSTS:
            found.append(ActiveBound(label, float(size[0]), cost, at_bound * (at_bound + 1) // 2))
    return tuple(sorted(found, key=lambda bound: -bound.multiplier))
