"""Derivatives of a model that is not linear in its parameters, by steps that fit the loads at hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import sympy as sp

from symstiff.arrays import Array

if TYPE_CHECKING:
    from symstiff.model import StiffnessModel

Deflection = Callable[[Array], Array]
"""Parameter values (P,) to deflections (N, 6) [m, rad]."""
_BENT, _STRAIGHT = 1e-4, 1.0
"""Share of the deflection by which a step changes it: where a law bends under loads, and where steps of any size do."""
_LEAST = 1e-10
"""Share by which a usual size changes it, below which that is rounding and no step is right."""
_PASSES = 2  # a law that saturates under a usual size tells too small a change at first


def derivative(model: StiffnessModel, deflection: Deflection, p: Array) -> Array:
    """∂Δt/∂π (N, 6, P) at p (P,) by central differences of the model's deflections."""
    columns = []
    for k, size in enumerate(steps_at(model, deflection, p)):
        step = np.zeros(len(p))
        step[k] = size
        columns.append((deflection(p + step) - deflection(p - step)) / (2 * size))
    return np.stack(columns, axis=-1)


def steps_at(model: StiffnessModel, deflection: Deflection, p: Array) -> Array:
    """(P,) a step of every parameter that changes the deflections at p by about the same share; a usual size if none.

    Steps are usual sizes times a power of two, so that rounding does not change them.
    """
    steps = np.array([model.steps[n] for n in model.parameters])
    share = _BENT if any(_degree(t.factor) > 1.0 for t in model.terms) else _STRAIGHT
    now, reach = deflection(p), model.robot.reach
    whole = _size(now, reach)
    for k, usual in enumerate(steps.copy() if whole > 0 else ()):
        for _ in range(_PASSES):
            moved = p.copy()
            moved[k] += steps[k]
            change = _size(deflection(moved) - now, reach) / whole
            if not change * usual / steps[k] > _LEAST:
                break
            steps[k] *= 2.0 ** np.round(np.log2(share / change))
    return steps


def _size(twists: Array, reach: float) -> float:
    """The largest translation [m] of twists (N, 6), or that which a turn makes at a reach."""
    return float(np.abs(twists * np.repeat([1.0, reach], 3)).max(initial=0.0))


def _degree(factor: sp.Expr) -> float:
    """Degree of a factor in the loads on virtual joints; infinite for what is no polynomial at sight."""
    if not any(s.name.startswith("tau_") for s in factor.free_symbols):
        return 0.0
    parts = [_degree(a) for a in factor.args]
    if factor.is_Symbol:
        return 1.0
    return max(parts) if factor.is_Add else sum(parts) if factor.is_Mul else float("inf")
