"""From complete parameters to the identifiable set: links and joints apart, as after M2."""

from __future__ import annotations

import numpy as np

from symstiff.reduction.physical import Parameter
from symstiff.reduction.reduce import Reduction
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.program import Builder


def complete_map(reduction: Reduction) -> np.ndarray:
    """P of π″ = P·π (rank × parameters after M2): both sets predict the same deflections.

    A joint that M3 absorbed adds c·u·uᵀ to the link before it, u its axis in that link's elastic frame (seed M3).
    """
    before, after = reduction.stages[2], reduction.stages[3]
    chain, column = ElasticChain(reduction.robot), {name: k for k, name in enumerate(after.names)}
    matrix = after.matrix.astype(float)
    for row, p in enumerate(before.parameters):
        if after.stands_for[p.name] is None:
            for name, share in _shares(chain, p).items():
                if name in column:
                    matrix[row, column[name]] = share
    return np.asarray(reduction.projection @ matrix.T)


def _shares(chain: ElasticChain, p: Parameter) -> dict[str, float]:
    """Entries of u·uᵀ by the names of the link's parameters."""
    b = Builder("axes", ())
    axes = chain.elastic_axes(b, p.body - 1)
    values = {c.symbol: c.exact for c in b.constants}
    u = [float(axis[2].xreplace(values)) for axis in axes]
    shift = 0 if p.prismatic else 3
    entries = [(r, c) for r in range(3) for c in range(r, 3) if u[r] and u[c]]
    return {f"k{p.body - 1}_{r + 1 + shift}{c + 1 + shift}": u[r] * u[c] for r, c in entries}
