"""A dry run of one effect: whether its parameters fit together, and what of an experiment it looks at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.calibration.simulation.chain import Chain
from symstiff.calibration.simulation.equilibrium import Mechanism, States, response
from symstiff.calibration.simulation.phenomena import Additions, Effect, build
from symstiff.errors import UserError

_ROWS = 11  # no list of parameters has this many entries, so that none broadcasts over the rows by chance
CONTEXT = {"time": "time[s]", "temperature": "temperature[degC]", "branch": "branch"}
"""What an effect may follow beside joints and loads, and the column of a table that holds it."""


def rehearse(effect: Effect, chain: Chain) -> None:
    """Build an effect and evaluate it once. Raises UserError where that fails."""
    added = _built(effect, chain)
    try:
        with np.errstate(all="ignore"):
            finite = _is_finite(added, chain, _states(chain))
    except UserError as error:
        raise UserError(f"effect {effect.effect}: {error}") from error
    if not finite:
        raise UserError(f"effect {effect.effect}: its law is not finite: check for zeros and huge values")


def followed(effect: Effect, chain: Chain) -> tuple[str, ...]:
    """What of ``CONTEXT`` an effect follows: it is not finite where that is not a number."""
    added, states, unknown = _built(effect, chain), _states(chain), np.full(_ROWS, np.nan)
    return tuple(name for name in CONTEXT if not _is_finite(added, chain, replace(states, **{name: unknown})))


def _built(effect: Effect, chain: Chain) -> Additions:
    return build(effect, chain, np.zeros((chain.size, chain.size)))


def _states(chain: Chain) -> States:
    row = np.zeros(_ROWS)
    return States(np.zeros((_ROWS, chain.dof)), np.ones((_ROWS, 6)), row + 1, row, row, row)


def _is_finite(added: Additions, chain: Chain, states: States) -> bool:
    nothing = np.zeros((chain.size, chain.size))
    mechanism = Mechanism(chain, nothing, added.laws, added.torques, added.wrenches, added.weights)
    found = [response(mechanism, states, np.zeros((_ROWS, chain.size)))]
    found += [reading(states, np.zeros((_ROWS, 6)), "absolute") for reading in added.readings]
    return all(bool(np.isfinite(x).all()) for x in found)
