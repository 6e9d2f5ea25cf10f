"""A link of another length or twist than drawn: constants at its six virtual joints."""

from __future__ import annotations

import sympy as sp

from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.common import ABSOLUTE, link_axes, links, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term

NAME = "geometric_error"
WHAT = ("x", "y", "z", "rx", "ry", "rz")


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    parameters, terms = [], []
    for what, at in zip(WHAT, link_axes(int(where["link"])), strict=True):
        unit, high, typical = ("rad", 0.05, 1e-3) if at.rotational else ("m", 0.02, 1e-3)
        how = "turned about" if at.rotational else "shifted along"
        meant = f"{how} {what[-1]} of the link's elastic frame, x along the beam"
        p = parameter(NAME, where, what, unit, -high, high, typical, meant)
        parameters.append(p)
        terms.append(Term(p.name, at, sp.S.One))
    return Realisation(tuple(parameters), tuple(terms))


EFFECT = Effect(
    identifier=NAME,
    title="Geometric error of a link",
    description="The link's frame is shifted and turned against its drawing, in its elastic axes.",
    seen_in=ABSOLUTE,
    places=links,
    realise=_realise,
    confused_with=("joint_offset", "transmission_error", "frame_misalignment", "payload_error"),
    separated_by="poses over the whole range of the joints next to the link; at the pedestal it is the "
    "placement of "
    "the measuring device, which is always estimated",
)
