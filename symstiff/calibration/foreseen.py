"""What `identify` would leave undetermined in the data of a plan, foreseen from plausible compliances."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.fits.estimate import estimate
from symstiff.calibration.rows import at_points
from symstiff.calibration.simulation.nominal import nominal_truth
from symstiff.calibration.tables.measurements import Measurements
from symstiff.model import StiffnessModel
from symstiff.reduction import Reduction
from symstiff.reduction.complete import complete_map

_DOUBT = 2.0  # times by which a robot may well be stiffer than one of its size usually is


def doubtful(
    reduction: Reduction, table: Measurements, components: int, sigma: tuple[float, float]
) -> tuple[str, ...]:
    """Parameters that the noise is likely to drown in deflections at the rows of ``table``.

    ``components`` of each row are read (3 or 6), with standard deviations ``sigma`` of translations [m] and rotations
    [rad]. The decision is that of the fit, for a robot as stiff as its size lets expect.
    """
    model = StiffnessModel.of(reduction)
    nominal = nominal_truth(model.robot)
    values = complete_map(reduction) @ [nominal.get(name, 0.0) for name in reduction.stages[2].names]
    seen = at_points(model, table, model.observation(table.q, table.w))[:, :components]
    A = seen.reshape(-1, len(values))
    noise = np.tile(np.repeat(sigma, 3)[:components], len(table))
    return estimate(A, A @ values, _DOUBT * noise, model.parameters).rank.affected
