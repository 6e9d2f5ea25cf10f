"""Growth with time or temperature, of the measuring frame or of a link along its elastic axes.

Δ = rate·s with s = t/T_end, (T − T₀)/span, or 1 − exp(−t/T) over its value at the end of the session, t counted from
``start`` where the clock does not begin with the session; the three parameters are what has grown at the end of the
session, in metres. A link that warms on one side ``bends``: three more, in radians, about its elastic axes. A pedestal
that grows shifts the whole robot: that is the measuring frame's drift.
"""

from __future__ import annotations

import math

import sympy as sp

from symstiff.effects.base import Effect, Move, Realisation, Scales, Shape, Where
from symstiff.effects.common import BOTH, XYZ, above_zero, exact, link_axes, links, parameter
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import TEMPERATURE, TIME, Term, VirtualJoint

NAME = "thermal_drift"
CONSTANTS = (0.07, 0.15, 0.3, 0.6)
"""Time constants as shares of a session; a warm-up of minutes in one of hours is the smallest."""
BENDING = 1 / 3
"""Odds that a link that warms bends as well: it does so where one side is warmer than the other."""
_SESSION = 3600.0
"""Length of a session where none is told [s]."""
_ROOM = 20.0
"""Temperature that a drift is counted from where none is told [°C]."""


def _realise(robot: Robot, where: Where, shape: Shape) -> Realisation:
    places = [VirtualJoint("measure", 0, a) for a in (1, 2, 3)]
    if "link" in where:
        places = list(link_axes(int(where["link"])))[:3]
    of = "of the link's elastic frame, x along the beam" if "link" in where else "of what is read"
    size = [parameter(NAME, where, x, "m", -5e-3, 5e-3, 1e-4, f"grown along {x} {of}") for x in XYZ]
    if shape.get("bends"):
        if "link" not in where:
            raise ValueError("bends is for links: leave it out")
        places += link_axes(int(where["link"]))[3:]
        size += [
            parameter(NAME, where, f"r{x}", "rad", -5e-3, 5e-3, 1e-4, f"turned about {x} {of}") for x in XYZ
        ]
    clock, warm = _clock(shape), "temperature" in shape
    rest = {"temperature": shape.get("reference", _ROOM)} if warm else {"time": shape.get("start", 0.0)}
    terms = tuple(Term(p.name, at, clock) for p, at in zip(size, places, strict=True))
    over = {"temperature": shape["temperature"]} if warm else {"time": shape.get("time", _SESSION)}
    return Realisation(tuple(size), terms, rest=rest, over=over)


def _clock(shape: Shape) -> sp.Expr:
    """What has grown; the difference of two times is left as it stands, as a late clock would drown it in rounding."""
    if "temperature" in shape:
        return (TEMPERATURE - exact(shape.get("reference", _ROOM))) / above_zero(shape, "temperature")
    span, start = above_zero(shape, "time", _SESSION), exact(shape.get("start", 0.0))
    with sp.evaluate(False):
        if "T" not in shape:
            return (TIME - start if start else TIME) / span
        constant = above_zero(shape, "T")
        end = exact(float(f"{-math.expm1(-float(span) / float(constant)):.9g}"))
        return (1 - sp.exp((start - TIME if start else -TIME) / constant)) / end


def _shapes(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    found: list[Shape] = []
    warm, span = (float(f"{scales.context.get(k, 0.0):.3g}") for k in ("temperature", "time"))
    if warm > 0:
        found.append(
            {"temperature": warm, "reference": float(f"{scales.lowest.get('temperature', _ROOM):.3g}")}
        )
    if span > 0:
        start = round(scales.lowest.get("time", 0.0))
        clock = {"time": span} | ({"start": float(start)} if start else {})
        found.append(clock)
        found += [{**clock, "T": float(f"{f * span:.3g}")} for f in CONSTANTS]
    return (*found, *({**shape, "bends": 1.0} for shape in found if "link" in where))


EFFECT = Effect(
    identifier=NAME,
    title="Thermal drift",
    description="The device's frame, or a link, grows with time or temperature against the start of "
    "the session; a link may bend as well.",
    seen_in=BOTH,
    places=lambda robot: ({"measurement": "frame"}, *links(robot)[1:]),
    realise=_realise,
    shapes=_shapes,
    needs=frozenset({"time or temperature"}),
    confused_with=("thermal_drift", "bad_poses", "frame_misalignment"),
    separated_by="poses repeated early and late in the session, in another order of the joints",
    told={
        "temperature": "per {} K", "reference": "from {} °C", "time": "over {} s", "T": "time constant {} s",
        "start": "from {} s of the clock on", "bends": "bending as well",
    },
    spans=("temperature", "time"),
    moves=lambda robot, shape: {"T": Move(2.0)},
    odds=lambda robot, shape: BENDING if shape.get("bends") else 1.0,
)  # fmt: skip
