"""What the data pin down: the range of every complete parameter over all admissible sets that fit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.arrays import Array
from symstiff.display import finite
from symstiff.reduction.admissible import AdmissibleSet
from symstiff.reduction.conic import Constraint, semidefinite, solve
from symstiff.reduction.nearest import Affine


@dataclass(frozen=True, eq=False)
class Bounds:
    """lower, upper: (n,) SI; ±inf where nothing limits the parameter, nan where the solver gave up."""

    names: tuple[str, ...]
    lower: Array
    upper: Array
    scale: Array

    @property
    def pinned(self) -> tuple[str, ...]:
        """Parameters that the data and physics fix: a range below 1e-6 of the nominal size."""
        return tuple(
            n for n, w in zip(self.names, (self.upper - self.lower) / self.scale, strict=True) if w < 1e-6
        )

    @property
    def unbounded(self) -> tuple[str, ...]:
        """Parameters with no upper or no lower limit."""
        free = np.isinf(self.lower) | np.isinf(self.upper)
        return tuple(name for name, is_free in zip(self.names, free, strict=True) if is_free)

    def to_dict(self) -> dict[str, Any]:
        """A JSON-ready record; null where there is no bound, with the unbounded ones listed."""
        rows = zip(self.names, self.lower, self.upper, strict=True)
        return {
            "ranges": {name: [finite(low), finite(high)] for name, low, high in rows},
            "pinned": list(self.pinned),
            "unbounded": list(self.unbounded),
        }


def parameter_bounds(affine: Affine, rules: AdmissibleSet) -> Bounds:
    """Two convex programs a parameter: least and largest value over the admissible part of the affine set.

    Parameters that no equation and no condition ties to the rest are solved in their own small group.
    """
    scale, n = affine.scale, len(affine.scale)
    affine = affine.resized(affine.gain)
    lower, upper = np.full(n, -math.inf), np.full(n, math.inf)
    for members in independent_groups(affine, rules):
        mine = affine.rows[:, members].any(axis=1)
        constraints = (
            [Constraint("zero", affine.rows[mine][:, members], affine.rhs[mine])] if mine.any() else []
        )
        for cone in semidefinite(rules, affine.scale, n):
            if cone.rows[:, members].any():
                constraints.append(Constraint(cone.kind, cone.rows[:, members], cone.rhs, cone.order))
        if not constraints:
            continue
        for position, index in enumerate(members):
            lower[index] = _extreme(constraints, len(members), position, 1.0)
            upper[index] = -_extreme(constraints, len(members), position, -1.0)
    lower, upper = _without_rounding(rules, lower * affine.scale, upper * affine.scale)
    return Bounds(rules.names, lower, upper, scale)


def _without_rounding(rules: AdmissibleSet, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Bounds in order, and none of a diagonal term below zero: the solver keeps neither to the last digit."""
    diagonal = [i for block in rules.blocks for row, column, i in block.entries if row == column]
    for bounds in (lower, upper):
        bounds[diagonal] = np.maximum(bounds[diagonal], 0.0)
    crossed = lower > upper
    return np.where(crossed, upper, lower), np.where(crossed, lower, upper)


def independent_groups(affine: Affine, rules: AdmissibleSet) -> list[list[int]]:
    """Parameters joined by a common equation or block, as lists of indices."""
    ties = [np.flatnonzero(row) for row in affine.rows]
    ties += [np.array([index for _, _, index in block.entries]) for block in rules.blocks]
    groups = [{index} for index in range(len(affine.scale))]
    for tie in ties:
        touched = [group for group in groups if group & set(tie.tolist())]
        groups = (
            [group for group in groups if group not in touched] + [set().union(*touched)]
            if touched
            else groups
        )
    return sorted(sorted(group) for group in groups)


def _extreme(constraints: list[Constraint], width: int, index: int, sign: float) -> float:
    """sign × the least of sign·x_index: −inf where unbounded, nan where the solver gave up."""
    solution = solve(np.zeros(width), sign * np.eye(width)[index], constraints)
    if solution.status == "solved":
        return sign * float(solution.x[index])
    return -math.inf if solution.status == "unbounded" else math.nan
