"""A dry run of one effect, so that parameters that do not fit together are reported when a truth is read."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.simulation.chain import Chain
from symstiff.calibration.simulation.equilibrium import Mechanism, States, response
from symstiff.calibration.simulation.phenomena import Effect, build
from symstiff.errors import UserError

_ROWS = 11  # no list of parameters has this many entries, so that none broadcasts over the rows by chance


def rehearse(effect: Effect, chain: Chain) -> None:
    """Build an effect and evaluate it once. Raises UserError where that fails."""
    added = build(effect, chain, np.zeros((chain.size, chain.size)))
    nothing = np.zeros((chain.size, chain.size))
    mechanism = Mechanism(chain, nothing, added.laws, added.torques, added.wrenches, added.weights)
    row = np.zeros(_ROWS)
    states = States(np.zeros((_ROWS, chain.dof)), np.ones((_ROWS, 6)), row + 1, row, row, row)
    try:
        finite = np.isfinite(response(mechanism, states, np.zeros((_ROWS, chain.size)))).all()
        for reading in added.readings:
            reading(states, np.zeros((_ROWS, 6)), "absolute")
    except (TypeError, ValueError, IndexError) as error:
        raise UserError(
            f"effect {effect.effect}: parameters do not fit together ({error}): check numbers against lists"
        ) from error
    if not finite:
        raise UserError(f"effect {effect.effect}: its law is not finite: check for zeros and huge values")
