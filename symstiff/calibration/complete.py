"""From an identified model back to complete link matrices and joint compliances."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.identify import Identification
from symstiff.calibration.simulation.nominal import nominal_truth
from symstiff.errors import UserError
from symstiff.reduction.complete import complete_map
from symstiff.reduction.reconstruction import Reconstruction, reconstruct


def reconstruct_model(result: Identification, *, bounds: bool = True) -> Reconstruction:
    """The admissible complete set nearest to a nominal one that predicts the same deflections, with bounds.

    Needs an identification that started from the complete model. Raises UserError otherwise.
    """
    reduction = result.reduction
    if reduction is None or result.fit.names != reduction.parameters:
        raise UserError("complete matrices need an identification with --start complete and no added effect")
    names = reduction.stages[2].names
    nominal = nominal_truth(result.model.robot)
    values = np.array([result.model.values[n] for n in reduction.parameters])
    return reconstruct(
        complete_map(reduction),
        values,
        names,
        {n: nominal.get(n, 0.0) for n in names},
        reduced_names=reduction.parameters,
        covariance=result.fit.covariance,
        bounds=bounds,
    )
