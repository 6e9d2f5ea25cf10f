"""From an identified reduced set back to complete, admissible link matrices and joint compliances.

What the seed leaves as future work (its conclusion): all complete sets π with P·π = π_reduced predict the
same deflections under the measured class of loads; of the admissible ones the nearest to a nominal model is
chosen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from symstiff.arrays import Array
from symstiff.display import finite
from symstiff.errors import UserError
from symstiff.reduction.admissible import (
    AdmissibleSet,
    admissible_set,
    joint_compliances,
    link_matrices,
    scales,
)
from symstiff.reduction.bounds import Bounds, parameter_bounds
from symstiff.reduction.logdet import nearest_logdet
from symstiff.reduction.nearest import (
    Affine,
    Relation,
    deepest,
    in_deviations,
    nearest_relative,
    project_reduced,
)

Metric = Literal["relative", "logdet"]
METRICS: Mapping[Metric, str] = {
    "relative": "sum over parameters of ((k - nominal) / size)^2, size = nominal diagonal or sqrt(k_aa k_bb)",
    "logdet": "sum over blocks of tr(K K0^-1) - log det(K K0^-1) - order (Burg divergence, blind to units)",
}


_ROUNDING = 1e-9
"""Depth below zero, in sizes of the data, that is the solver's rounding."""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A complete parameter set and how far the data determine it.

    values: (n,) SI, in the order of names; reduced: (r,) = P·values; admissible: whether the given reduced
    set has an admissible complete set at all; depth: the largest share of the nominal sizes by which every
    block can be positive at once (negative where not admissible); distance: sqrt(chi²) from the given reduced
    set to the nearest admissible one, in standard deviations (nan without covariance, 0 where admissible);
    shifts: (r,) moves of the reduced parameters, in their standard deviations; metric_value: distance from
    nominal; smallest: relative least eigenvalue by block; bounds: None where not asked for.
    """

    names: tuple[str, ...]
    values: Array
    reduced_names: tuple[str, ...]
    reduced: Array
    admissible: bool
    depth: float
    distance: float
    shifts: Array
    metric: str
    metric_value: float
    smallest: dict[str, float]
    bounds: Bounds | None

    @property
    def links(self) -> dict[int, Array]:
        """Complete 6 × 6 compliance matrices by link, in the link's elastic frame."""
        return link_matrices(self.names, self.values)

    @property
    def joints(self) -> dict[int, float]:
        """Joint compliances by joint."""
        return joint_compliances(self.names, self.values)

    def __str__(self) -> str:
        if self.admissible:
            return f"admissible with depth {self.depth:.2g} of nominal; nearest in the metric {self.metric}"
        far = "" if math.isnan(self.distance) else f", {self.distance:.2g} standard deviations away"
        return (
            f"no admissible complete set predicts the identified deflections; the nearest one is taken{far}"
        )

    def to_dict(self) -> dict[str, Any]:
        """A JSON-ready record."""
        named = zip(self.reduced_names, self.reduced, self.shifts, strict=True)
        return {
            "values": dict(zip(self.names, map(float, self.values), strict=True)),
            "reduced": {name: {"value": float(v), "shift_std": finite(s)} for name, v, s in named},
            "admissible": self.admissible,
            "depth": self.depth,
            "distance_std": finite(self.distance),
            "metric": self.metric,
            "metric_value": self.metric_value,
            "smallest_relative_eigenvalue": self.smallest,
            "bounds": None if self.bounds is None else self.bounds.to_dict(),
        }


def reconstruct(
    P: Array,
    reduced: Array,
    names: Sequence[str],
    nominal: Mapping[str, float],
    *,
    reduced_names: Sequence[str] | None = None,
    covariance: Array | None = None,
    metric: Metric = "relative",
    admissible: AdmissibleSet | None = None,
    relations: Sequence[Relation] = (),
    margin: float = 1e-4,
    bounds: bool = True,
) -> Reconstruction:
    """The admissible complete set in {π : P·π = reduced} nearest to the nominal model.

    P: (r, n) exact mapping of the reduction, of rank r; reduced: (r,) SI; nominal: values by name
    (absent: 0, of a typical size); covariance: (r, r) of `reduced`; relations: soft linear relations such as
    those of a beam (metric "relative" only); margin: share of the nominal size that every block keeps, where
    the data allow it. Where noise leaves no admissible set, `reduced` moves to the nearest one that has one: in
    standard deviations if covariance is given, in nominal sizes otherwise. Raises UserError for shapes and options
    that do not fit, and for a covariance that is not positive definite where that distance is asked for.
    """
    P, reduced = np.asarray(P, dtype=float), np.asarray(reduced, dtype=float)
    reduced_names = tuple(reduced_names or (f"r{i + 1}" for i in range(len(reduced))))
    _check(P, reduced, names, reduced_names, covariance, metric, relations)
    rules = admissible_set(names) if admissible is None else admissible
    scale = scales(names, nominal)
    target = np.array([float(nominal.get(name, 0.0)) for name in names]) / scale
    affine = Affine(P, reduced, scale)
    depth = deepest(affine, rules)
    is_admissible = depth > -_ROUNDING * affine.gain
    moved, inner = affine, min(margin, 0.5 * max(depth, 0.0))
    if not is_admissible:
        moved = Affine(P, project_reduced(affine, rules, covariance, margin), scale)
        inner = 0.5 * min(margin, max(deepest(moved, rules), 0.0))
    if metric == "logdet":
        x, value = nearest_logdet(moved, rules, target)
    else:
        x, value = nearest_relative(moved, rules, target, relations, inner)
    values, shift = scale * moved.restore(x), moved.reduced - reduced
    return Reconstruction(
        names=tuple(names),
        values=values,
        reduced_names=reduced_names,
        reduced=P @ values,
        admissible=is_admissible,
        depth=depth,
        distance=0.0 if is_admissible else _mahalanobis(shift, covariance),
        shifts=np.zeros(len(shift)) if is_admissible else shift / _deviations(covariance, len(shift)),
        metric=f"{metric}: {METRICS[metric]}",
        metric_value=value,
        smallest=rules.smallest(values, scale),
        bounds=parameter_bounds(moved, rules) if bounds else None,
    )


def _check(
    P: Array,
    reduced: Array,
    names: Sequence[str],
    reduced_names: Sequence[str],
    covariance: Array | None,
    metric: str,
    relations: Sequence[Relation],
) -> None:
    """Shapes, rank and finiteness, with what would be right."""
    rows = len(reduced)
    if P.shape != (rows, len(names)) or len(reduced_names) != rows:
        raise UserError(
            f"mapping of shape {P.shape} does not fit {rows} reduced and {len(names)} complete parameters: "
            "give the mapping of the same reduction"
        )
    if not (np.isfinite(P).all() and np.isfinite(reduced).all()):
        raise UserError("reduced parameters or mapping are not finite: identify them first")
    if covariance is not None and np.shape(covariance) != (rows, rows):
        raise UserError(f"covariance of shape {np.shape(covariance)} does not fit {rows} reduced parameters")
    if metric not in METRICS:
        raise UserError(f'metric "{metric}" is not known: give one of {", ".join(METRICS)}')
    if relations and metric != "relative":
        raise UserError(
            f'relations have no weight in the metric "{metric}": leave them out, or give "relative"'
        )
    norms = np.linalg.norm(P, axis=1)
    if rows and (not norms.all() or np.linalg.matrix_rank(P / norms[:, None]) < rows):
        raise UserError(f"mapping has rank below {rows}: its rows contradict or repeat each other")


def _deviations(covariance: Array | None, rows: int) -> Array:
    if covariance is None:
        return np.full(rows, math.nan)
    return np.asarray(np.sqrt(np.diag(covariance)))


def _mahalanobis(shift: Array, covariance: Array | None) -> float:
    """sqrt(shiftᵀ·covariance⁻¹·shift)."""
    return math.nan if covariance is None else float(np.linalg.norm(in_deviations(covariance, shift)))
