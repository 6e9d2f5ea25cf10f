"""On-line identification: recursive least squares in C, its columns scaled by their typical size."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from symstiff.codegen.emit import base_context, environment
from symstiff.codegen.text import CAlgebra, context_names
from symstiff.errors import UserError
from symstiff.symbolic.algebras import evaluate_numpy

if TYPE_CHECKING:
    from symstiff.codegen.functions import Functions
    from symstiff.codegen.options import Options
    from symstiff.model import StiffnessModel

_POSES = 200
_FRAMES = 500  # bytes for return addresses, saved registers and scalars, as measured and rounded up


def emit_rls(functions: Functions, options: Options) -> dict[str, bytes]:
    """Source and header of the recursive estimator."""
    model = functions.model
    size = len(model.stiffness_parameters)
    if not size:
        raise UserError("target rls: the model has no compliances to identify: remove rls from --targets")
    literal = CAlgebra(options.single).literal
    others = len(model.effect_parameters) + len(context_names(functions.deflection))
    factors = max(size * (size - 1) // 2, 1)  # C has no empty arrays
    state = 2 * size + factors + others + 2
    by_difference = size + others + 12 if not model.is_linear else 0
    real = 4 if options.single else 8
    context = base_context(functions, options) | {
        "factors": factors,
        "state": state * real,
        # a copy of the state, the observation matrix, the predicted deflection and what one component takes
        "stack": (state + 10 * size + 6 + by_difference) * real + _FRAMES,
        "scales": [literal(s) for s in column_scales(model)],
        "least_forgetting": literal(0.5),
        # loads that effects add act on the compliances, which the observation of the bare wrench does not know
        "columns_by_difference": not model.is_linear,
    }
    jinja = environment()
    return {
        f"{model.robot.name}_rls.{end}": jinja.get_template(f"c/rls.{end}.j2").render(context).encode()
        for end in "hc"
    }


def column_scales(model: StiffnessModel) -> list[float]:
    """Typical size of each column of the observation matrix [N, N·m], as a power of two."""
    rng = np.random.default_rng(2)
    q = np.array([rng.uniform(*joint.range, size=_POSES) for joint in model.robot.joint]).T
    w = rng.uniform(-1000, 1000, (_POSES, 6)) * [1, 1, 1, 0.2, 0.2, 0.2]
    A = evaluate_numpy(model.observation_program, q=q, w=w)["A"]
    sizes = np.sqrt(np.mean(A**2, axis=(0, 1)))
    return [2.0 ** round(math.log2(s)) if s > 0 else 1.0 for s in sizes]
