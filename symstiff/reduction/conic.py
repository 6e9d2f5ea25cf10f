"""Convex programs over admissible parameters, solved by an interior-point conic solver (Clarabel)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse

from symstiff.arrays import Array
from symstiff.reduction.admissible import AdmissibleSet, Block

_ROOT2 = np.sqrt(2.0)
_STEPS = (0.99, 0.95, 0.9)
"""Largest steps of the solver, as shares of the way to the boundary, in turn."""


@dataclass(frozen=True, eq=False)
class Constraint:
    """rhs − rows·x in a cone: kind "zero", "nonnegative", "ball" (second-order), "psd" (of `order`)."""

    kind: str
    rows: Array
    rhs: Array
    order: int = 0


@dataclass(frozen=True, eq=False)
class Solution:
    """x: (n,); duals: one a constraint; status: "solved", "unbounded", "infeasible" or the solver's word."""

    x: Array
    duals: tuple[Array, ...]
    status: str


def solve(quadratic: Array, linear: Array, constraints: Sequence[Constraint]) -> Solution:
    """Minimise ½·Σ quadratic·x² + linear·x under the constraints; quadratic, linear: (n,), quadratic ≥ 0.

    An interior point that long steps have brought too near the boundary is stuck there: shorter ones are tried then.
    """
    for step in _STEPS:
        found = _solve(quadratic, linear, constraints, step)
        if found.status in ("solved", "unbounded", "infeasible"):
            break
    return found


def _solve(quadratic: Array, linear: Array, constraints: Sequence[Constraint], step: float) -> Solution:
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    settings.max_step_fraction = step
    settings.max_threads = 1
    solver = clarabel.DefaultSolver(
        scipy.sparse.diags_array(quadratic, format="csc"),
        np.asarray(linear, dtype=float),
        scipy.sparse.csc_matrix(np.vstack([c.rows for c in constraints])),
        np.concatenate([c.rhs for c in constraints]),
        [_cone(c) for c in constraints],
        settings,
    )
    result = solver.solve()
    dual = np.array(result.z)
    ends = np.cumsum([len(c.rhs) for c in constraints])
    duals = tuple(np.split(dual, ends[:-1]))
    return Solution(np.array(result.x), duals, _status(str(result.status)))


def semidefinite(
    admissible: AdmissibleSet, scale: Array, width: int, margin: float = 0.0
) -> list[Constraint]:
    """Every block ⪰ margin, on x = parameters/scale in the first n of `width` variables."""
    constraints = []
    for block in admissible.blocks:
        rows, shift = block_rows(block, scale, width)
        constraints.append(Constraint(_kind(block), -rows, -margin * shift, block.size))
    return constraints


def block_rows(block: Block, scale: Array, width: int) -> tuple[Array, Array]:
    """(s, width) rows that turn x into the cone's vector of the scaled block, and the vector of the identity.

    The block is divided by √(scale) of its diagonal from both sides, which makes nominal diagonals one.
    """
    axes = block.axes(scale)
    basis = block.basis() / np.outer(axes, axes)
    rows = np.zeros((len(cone_vector(np.eye(block.size))), width))
    for (_, _, index), E in zip(block.entries, basis, strict=True):
        rows[:, index] = cone_vector(E) * scale[index]
    return rows, cone_vector(np.eye(block.size))


def cone_vector(K: Array) -> Array:
    """A symmetric matrix as the solver's vector: itself, (a + c, a − c, 2b), or the scaled upper triangle."""
    if len(K) == 1:
        return np.asarray(K[0])
    if len(K) == 2:
        return np.array([K[0, 0] + K[1, 1], K[0, 0] - K[1, 1], 2.0 * K[0, 1]])
    return np.concatenate([[*(_ROOT2 * K[:c, c]), K[c, c]] for c in range(len(K))])


def dual_matrix(block: Block, dual: Array) -> Array:
    """A block's multiplier as a positive semidefinite matrix Z with ⟨Z, K⟩ = dual·cone_vector(K)."""
    if block.size == 1:
        return dual.reshape(1, 1)
    if block.size == 2:
        return np.array([[dual[0] + dual[1], dual[2]], [dual[2], dual[0] - dual[1]]])
    Z = np.zeros((block.size, block.size))
    at = 0
    for c in range(block.size):
        Z[:c, c] = Z[c, :c] = dual[at : at + c] / _ROOT2
        Z[c, c] = dual[at + c]
        at += c + 1
    return Z


def _kind(block: Block) -> str:
    return {1: "nonnegative", 2: "ball"}.get(block.size, "psd")


def _cone(constraint: Constraint) -> object:
    import clarabel

    if constraint.kind == "psd":
        return clarabel.PSDTriangleConeT(constraint.order)
    kinds = {
        "zero": clarabel.ZeroConeT,
        "nonnegative": clarabel.NonnegativeConeT,
        "ball": clarabel.SecondOrderConeT,
    }
    return kinds[constraint.kind](len(constraint.rhs))


def _status(word: str) -> str:
    if word in ("Solved", "AlmostSolved"):
        return "solved"
    if word in ("DualInfeasible", "AlmostDualInfeasible"):
        return "unbounded"
    return "infeasible" if word in ("PrimalInfeasible", "AlmostPrimalInfeasible") else word
