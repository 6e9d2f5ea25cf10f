"""The load acts on the deflected pose: a second-order term, known once the compliances are.

Second derivative of a serial chain with virtual joints u before v: an earlier turn rotates a later column,
and a later shift moves the lever of an earlier one. The term has two parts: the curved path of the tool,
½·Σ dJ_v·θ_v, and the change of the loads, J·C·(dJᵀ·W). Its one coefficient is 1.
"""

from __future__ import annotations

import numpy as np

from symstiff.effects.base import Effect, Realisation, Shape, Situation, Where
from symstiff.effects.common import BOTH, parameter
from symstiff.robot.schema import Robot

NAME = "large_deflection"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    share = parameter(NAME, where, "share", "1", 0.3, 3.0, 1.0)
    return Realisation((share,), (), nominal={share.name: 1.0})


def _moved(J: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Change (N, 6, V) of the columns J (N, 6, V) with the chain at the deflections theta (N, V)."""
    linear, angular = J[:, :3], J[:, 3:]
    turned = np.cumsum(angular * theta[:, None], axis=2)
    turned = turned - angular * theta[:, None]  # what comes before v only
    total = np.cumsum(linear[:, :, ::-1] * theta[:, None, ::-1], axis=2)[:, :, ::-1]  # v and what comes after
    change = np.cross(turned, linear, axis=1) + np.cross(angular, total, axis=1)
    return np.concatenate([change, np.cross(turned, angular, axis=1)], axis=1)


def _columns(situation: Situation, where: Where, shape: Shape) -> np.ndarray:
    J, theta = situation.J, situation.theta
    further = situation.respond(np.einsum("nrv,nr->nv", _moved(J, theta), situation.wrench))
    point = J.copy()
    point[:, :3] += np.cross(J[:, 3:], situation.offset[:, :, None], axis=1)
    curved = np.einsum("nrv,nv->nr", _moved(point, theta), theta) / 2
    return situation.rows(curved + np.einsum("nrv,nv->nr", point, further))[:, None]


EFFECT = Effect(
    identifier=NAME,
    title="Large deflection",
    description="The load stands on the deflected robot: levers and directions change by what it has "
    "given way.",
    seen_in=BOTH,
    places=lambda robot: ({"robot": "all"},),
    realise=_realise,
    confused_with=("nonlinear_stiffness", "frame_misalignment"),
    separated_by="several load levels; its size is known beforehand",
    columns=_columns,
)
