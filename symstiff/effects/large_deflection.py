"""The load acts on the deflected pose: a second-order term, known once the compliances are.

Second derivative of a serial chain with virtual joints u before v: an earlier turn rotates a later column,
and a later shift moves the lever of an earlier one. The term has two parts: the curved path of the tool,
½·Σ dJ_v·θ_v, and the change of the loads, J·C·(dJᵀ·W). Its one coefficient is 1. The arm sags already under
what its links weigh: a deflection shows the term at the sum less the sag's own. Where the robot file tells no masses,
the arm is taken to weigh nothing, or one of a few masses along it (a shape's ``mass`` or ``tapered_mass``).
"""

from __future__ import annotations

import numpy as np

from symstiff.effects.arm import (
    ARM_MOVES,
    ASSUMED,
    TAPERS,
    TOLD,
    assumed_weights,
    under_arm,
)
from symstiff.effects.base import Effect, Realisation, Scales, Shape, Situation, Where, at_lever
from symstiff.effects.common import BOTH, parameter
from symstiff.robot.schema import Robot

NAME = "large_deflection"


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    share = parameter(NAME, where, "share", "1", 0.3, 3.0, 1.0)
    return Realisation((share,), (), nominal={share.name: 1.0})


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    return ({}, *assumed_weights(robot, scales))


def _moved(J: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Change (N, 6, V) of the columns J (N, 6, V) with the chain at the deflections theta (N, V)."""
    linear, angular = J[:, :3], J[:, 3:]
    turned = np.cumsum(angular * theta[:, None], axis=2)
    turned = turned - angular * theta[:, None]  # what comes before v only
    total = np.cumsum(linear[:, :, ::-1] * theta[:, None, ::-1], axis=2)[:, :, ::-1]  # v and what comes after
    change = np.cross(turned, linear, axis=1) + np.cross(angular, total, axis=1)
    return np.concatenate([change, np.cross(turned, angular, axis=1)], axis=1)


def _columns(situation: Situation, where: Where, shape: Shape) -> np.ndarray:
    situation = situation.of(under_arm(situation.robot, shape))
    J, theta, sag = situation.J, situation.theta, situation.sag
    change = np.einsum("nrv,nr->nv", _moved(J, theta + sag), situation.wrench)
    for body in situation.bodies:
        moved = _moved(body.columns(J), theta[:, : body.before])
        change[:, : body.before] += np.einsum("nrv,nr->nv", moved, body.wrench)
    point = at_lever(J, situation.offset)
    curved = _curved(point, theta + sag) - _curved(point, sag)
    turn, sagged = (np.einsum("nrv,nv->nr", J[:, 3:], angles) for angles in (theta, sag))
    # a measured rotation is told from the sagged attitude, not from the rigid one
    curved[:, 3:] -= np.cross(turn, sagged) / 2
    return situation.rows(curved + np.einsum("nrv,nv->nr", point, situation.respond(change)))[:, None]


def _curved(J: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Twists (N, 6) by which the path of a point departs from a straight one."""
    return np.asarray(np.einsum("nrv,nv->nr", _moved(J, theta), theta) / 2)


def _alike(robot: Robot, where: Where, shape: Shape) -> str:
    """The sag under a weight that is not told turns levers in proportion to the load, as a compliance does."""
    if robot.has_weights or TAPERS.keys() & shape.keys():
        return ""
    return (
        "the robot file tells no masses: what the arm's own sag adds is in proportion to the load, and may be named as "
        "a compliance of a link or joint: enter masses and centres of mass, and diagnose again"
    )


EFFECT = Effect(
    identifier=NAME,
    title="Large deflection",
    description="The load stands on the deflected robot: levers and directions change by what it has "
    "given way.",
    seen_in=BOTH,
    places=lambda robot: ({"robot": "all"},),
    realise=_realise,
    shapes=_shapes,
    confused_with=("nonlinear_stiffness", "frame_misalignment"),
    separated_by="several load levels; its size is known beforehand",
    told={name: TOLD[name] for name in TAPERS},
    assumed={name: ASSUMED[name] for name in TAPERS},
    moves=lambda robot, shape: {name: ARM_MOVES[name] for name in TAPERS},
    alike=_alike,
    columns=_columns,
)
