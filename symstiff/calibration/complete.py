"""From an identified model back to complete link matrices and joint compliances."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from symstiff.arguments import require
from symstiff.calibration.identify import Identification
from symstiff.calibration.simulation.nominal import nominal_truth
from symstiff.errors import UserError
from symstiff.reduction.complete import complete_map
from symstiff.reduction.nearest import Relation, is_definite
from symstiff.reduction.reconstruction import Metric, Reconstruction, reconstruct


def reconstruct_model(
    result: Identification,
    *,
    metric: Metric = "relative",
    relations: Sequence[Relation] = (),
    bounds: bool = True,
) -> Reconstruction:
    """The admissible complete set nearest to a nominal one that predicts the same deflections, with bounds.

    ``metric`` says what nearest is, ``relations`` draw links to what is known of them, as `cantilever_relations` of
    `symstiff.reduction.nearest` to beams (both as of `reconstruct`). Needs an identification that started from the
    complete model. Raises UserError otherwise. A fit with as many rows as parameters and no sigma tells no noise: what
    it has to give up is counted in nominal sizes then.
    """
    require(result, Identification, "an identification", "identify(robot, table) gives one")
    reduction = result.reduction
    if reduction is None or result.fit.names != reduction.parameters:
        raise UserError(
            "complete link matrices need an identification from the complete model without effects: "
            "identify(robot, table)"
        )
    names = reduction.stages[2].names
    nominal = nominal_truth(result.model.robot)
    values = np.array([result.model.values[n] for n in reduction.parameters])
    covariance = result.fit.covariance
    return reconstruct(
        complete_map(reduction),
        values,
        names,
        {n: nominal.get(n, 0.0) for n in names},
        reduced_names=reduction.parameters,
        metric=metric,
        relations=relations,
        covariance=covariance if is_definite(covariance) else None,
        bounds=bounds,
    )
