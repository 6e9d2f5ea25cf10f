"""Fitted compliances that some physically possible robot has: what stands behind a fit, and its values under bounds."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from symstiff.calibration.experiment.readings import ExperimentClass
from symstiff.calibration.fits.constrained import ConstrainedEstimate, constrain
from symstiff.calibration.fits.estimate import Estimate
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction import Reduction, reduce
from symstiff.reduction.complete import complete_map


def reduction_of(model: StiffnessModel, experiment: ExperimentClass) -> Reduction | None:
    """The reduction that a start model came from, where its compliances are the experiment's."""
    found = reduce(model.robot, model.loads, model.measure, experiment.fixed, points=experiment.points)
    return found if found.parameters == model.stiffness_parameters else None


def values_of(
    fit: Estimate, reduction: Reduction | None, physical: bool
) -> tuple[dict[str, float], ConstrainedEstimate | None]:
    """Values by name as fitted, or with an admissible complete set behind them. Raises UserError where none can be."""
    if not physical:
        return dict(zip(fit.names, fit.values.tolist(), strict=True)), None
    known = reduction.parameters if reduction is not None else ()
    if reduction is None or fit.names[: len(known)] != known:
        constrained = _as_they_are(fit)
    else:  # effects stand last, and are free
        beside, sizes = fit.names[len(known) :], np.abs(fit.values[len(known) :])
        P = block_diag(complete_map(reduction), np.eye(len(beside)))
        nominal = dict(zip(beside, sizes.tolist(), strict=True))
        constrained = constrain(fit, P, (*reduction.stages[2].names, *beside), nominal=nominal)
    return dict(zip(constrained.names, constrained.values.tolist(), strict=True)), constrained


def _as_they_are(fit: Estimate) -> ConstrainedEstimate:
    """Under the bounds of the parameters themselves. Raises UserError where these are no whole matrices."""
    try:
        return constrain(fit)
    except UserError as error:
        raise UserError(
            "physical: the compliances of the start model are no whole link matrices, nor those of a reduction "
            f"({error}), as where effects replaced some: start from complete, or leave it out"
        ) from error
