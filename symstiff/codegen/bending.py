"""Loads under which the laws of a model bend: where a gap, a loop or a knee is half crossed.

Far beyond, a law is a straight line: the constants that say where it bends could be wrong and no result would tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy as sp

from symstiff.codegen.names import moments
from symstiff.model import StiffnessModel
from symstiff.symbolic.algebras import NumpyAlgebra
from symstiff.symbolic.program import Program, evaluate

Input = tuple[tuple[float, ...], tuple[float, ...]]
SCALES = tuple(4.0**-k for k in range(7))  # powers of two: a load stays exact in single precision
_SHOWN = 1e-4  # relative change of a deflection from which a constant a quarter greater shows
_WIDTH = 2000  # states in one walk, which keeps an array of that length a temporary


class _Mutated(NumpyAlgebra):
    """The k-th state's constant number ``chosen[k]``, in the order of the walk, is a quarter greater."""

    def __init__(self, chosen: np.ndarray) -> None:
        self.chosen, self.count = chosen, 0

    def number(self, value: sp.Expr) -> Any:
        """The constant, or one a state where some of them have another."""
        here = self.chosen == self.count
        self.count += 1
        return np.where(here, 1.25 * float(value), float(value)) if here.any() else float(value)


def bending(
    model: StiffnessModel,
    values: Mapping[str, float],
    known: Sequence[Input],
    candidates: Sequence[Input],
    rounding: float,
) -> list[Input]:
    """Candidates under smaller loads that show every constant of the laws which no known configuration shows.

    None is taken whose deflection rounding changes by more than ``rounding``, in units of the type's precision.
    """
    program, p = model.deflection_program, np.array(model.vector(values))
    moment = np.array([m.tested for m in moments(model, program)])

    def states(inputs: Sequence[Input]) -> dict[str, np.ndarray]:
        n = len(inputs)
        q, w = np.array([q for q, _ in inputs]), np.array([w for _, w in inputs])
        return {"p": np.tile(p, (n, 1)), "q": q, "w": w, "context": np.tile(moment, (n, 1))}

    scaled = [(q, tuple(s * x for x in w)) for s in SCALES[1:] for q, w in candidates]
    tried = states(scaled)
    safe = _relative(_deflections(program, tried, np.float32), _deflections(program, tried))
    usable = safe <= rounding * np.finfo(np.float32).eps
    hidden = ~_shown(program, states(known)).any(axis=1)
    found: list[Input] = []
    for k in map(int, np.flatnonzero(hidden)):
        if found and (_changes(program, states(found), [k]) > _SHOWN).any():
            continue
        change = np.where(usable, _changes(program, tried, [k])[0], 0.0)
        if change.max() > _SHOWN:
            # the first of the best, to a tenth of a power of ten: the same on every machine
            digits = np.round(np.log10(np.maximum(change, _SHOWN)), 1)
            found.append(scaled[int(digits.argmax())])
    return found


def _shown(program: Program, states: Mapping[str, np.ndarray]) -> np.ndarray:
    """Whether a state shows a constant, (constants, states)."""
    n, counted = len(states["q"]), _Mutated(np.array([-1]))
    evaluate(program, _columns(program, states), counted)
    at_once = max(1, _WIDTH // n)
    chunks = [range(k, min(k + at_once, counted.count)) for k in range(0, counted.count, at_once)]
    shown = (_changes(program, states, chunk) > _SHOWN for chunk in chunks)
    return np.vstack([np.zeros((0, n), bool), *shown])


def _changes(program: Program, states: Mapping[str, np.ndarray], constants: Sequence[int]) -> np.ndarray:
    """Relative changes of deflections by a constant a quarter greater, (constants, states)."""
    n = len(states["q"])
    wide = {name: np.tile(x, (len(constants), 1)) for name, x in states.items()}
    changed = _deflections(program, wide, algebra=_Mutated(np.repeat(constants, n)))
    return _relative(changed, np.tile(_deflections(program, states), (len(constants), 1))).reshape(-1, n)


def _columns(program: Program, states: Mapping[str, np.ndarray]) -> dict[str, list[np.ndarray]]:
    return {v.name: list(states[v.name].T) for v in program.inputs}


def _deflections(
    program: Program, states: Mapping[str, np.ndarray], real: Any = float, algebra: NumpyAlgebra | None = None
) -> np.ndarray:
    """(N, 6), computed in a precision."""
    typed = {name: x.astype(real) for name, x in states.items()}
    found = np.zeros((len(states["q"]), 6))
    with np.errstate(all="ignore"):
        for k, x in enumerate(evaluate(program, _columns(program, typed), algebra or NumpyAlgebra())["dt"]):
            found[:, k] = 0.0 if x is None else x
    return found


def _relative(x: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Greatest difference over the greatest value, of translation or rotation, (N,)."""
    both = [slice(0, 3), slice(3, 6)]
    with np.errstate(all="ignore"):
        shares = [np.abs(x - reference)[:, b].max(1) / np.abs(reference)[:, b].max(1) for b in both]
    worst: np.ndarray = np.nan_to_num(np.fmax(*shares), nan=0.0, posinf=np.inf)
    return worst
