"""The compact layout: the virtual-joint Jacobian unrolled, the observation and compliance matrices by loops.

A column of J_v is a pair of vectors, (axis, 0) or (axis × lever, axis); equal vectors are stored once. Loads are
τ_v = J_vᵀ·W, and every term π·τ_by at virtual joint ``at`` adds J_at·τ_by to a column of A (seed eq. 5, 12) and
π·J_at·J_byᵀ to the compliance (seed eq. 2).

Less code for more instructions: the README has the figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp

from symstiff.model import StiffnessModel
from symstiff.symbolic.algebras import count
from symstiff.symbolic.builder import Builder
from symstiff.symbolic.chain import frames, jacobian_columns
from symstiff.symbolic.passes import q_vector
from symstiff.symbolic.program import Program
from symstiff.symbolic.terms import tau

ZERO = (sp.S.Zero,) * 3


@dataclass(frozen=True)
class Compact:
    """columns: vectors of J as a Program (q → ``v``, the first one zero); joints: offsets in ``v`` of both halves of
    every virtual joint's column; terms: (parameter, at, by), indices of the C array ``k`` and of ``joints``."""

    columns: Program
    joints: tuple[tuple[int, int], ...]
    terms: tuple[tuple[int, int, int], ...]

    def operations(self, function: str) -> dict[str, int]:
        """Additions, multiplications, … of ``observation`` or ``compliance``."""
        counts = count(self.columns)
        loads = 6 * len(self.joints) if function == "observation" else 0
        each = 6 if function == "observation" else 36
        multiplications = each if function == "observation" else each + 6
        counts["add"] += loads + each * len(self.terms)
        counts["mul"] += loads + multiplications * len(self.terms)
        return counts


def compact(model: StiffnessModel) -> Compact:
    """Columns and index tables of a model's compliances."""
    chain, names = model.chain, model.stiffness_parameters
    of_load = {tau(v): v for v in chain.virtual_joints}
    terms = [t for t in model.terms if t.parameter in names]
    used = {t.at for t in terms} | {of_load[t.factor] for t in terms}
    joints = [v for v in chain.virtual_joints if v in used]
    b = Builder("columns", (q_vector(chain),))
    columns = jacobian_columns(chain, b, frames(chain, b))
    vectors: list[Sequence[sp.Expr]] = [ZERO]
    offsets = []
    for joint in joints:
        halves = columns[joint][:3], columns[joint][3:]
        for half in halves:
            if half not in vectors:
                vectors.append(half)
        offsets.append((3 * vectors.index(halves[0]), 3 * vectors.index(halves[1])))
    b.output("v", (3 * len(vectors),), [x for vector in vectors for x in vector])
    return Compact(
        b.build(),
        tuple(offsets),
        tuple((names.index(t.parameter), joints.index(t.at), joints.index(of_load[t.factor])) for t in terms),
    )
