"""What a force sensor and the rig do to a load, and no effect of the catalogue is: crosstalk, pulls, levers, leans."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.experiment.situation import Situation
from symstiff.calibration.tables.loading import load_factor
from symstiff.discrepancy.problem import DeviceLaw, Parameter
from symstiff.symbolic.terms import AXES, WRENCH, Term, VirtualJoint, w

SENSOR, FLANGE = "force sensor", "flange"
_PERCENT = 1e-2
_PAIRS = tuple((a, b) for a in range(3) for b in range(a, 3))


def sensor_laws(situation: Situation) -> tuple[DeviceLaw, ...]:
    """Laws of the load as it is read; those without an influence are not left out here."""
    return (
        *_crosstalk(situation), *_shears(situation), *_pulls(situation), *_beside(situation), *_leans(situation)
    )  # fmt: skip


def _frames(situation: Situation) -> dict[str, Array]:
    """(N, 3, 3) axes that a load may be read in: of a sensor at the flange, of a rig beside the robot."""
    found = situation.view.found.R[:, -1]
    return {"the tool's axes": found, "the base's axes": np.tile(np.eye(3), (len(found), 1, 1))}


def _shears(situation: Situation) -> Iterator[DeviceLaw]:
    """A sensor that reads too much along some direction, forces or moments: any symmetric gain; one axis alone too.

    In the tool's axes also a share of one axis in its two others: in the base's each gain and crosstalk is told
    already.
    """
    for first, kind in ((0, "f"), (3, "m")):
        if not situation.view.table.w[:, first : first + 3].any():
            continue
        for title, frame in _frames(situation).items():
            share = _shares(situation, first, frame)
            name, of_tool = f"gain in {title}", "tool" in title
            columns, parameters = [], []
            for a, b in _PAIRS:
                column = share[a, b] + share[b, a] if a != b else share[a, a]
                which = f"{kind}{'xyz'[a]}" + (f" and {kind}{'xyz'[b]}" if a != b else "")
                columns.append(column)
                parameters.append(Parameter(f"{name}: {which}", "%"))
                if a != b or of_tool:
                    yield DeviceLaw(SENSOR, name, (parameters[-1],), column[:, None])
            yield DeviceLaw(SENSOR, name, tuple(parameters), np.column_stack(columns))
            for b in range(3) if of_tool else ():
                others = [a for a in range(3) if a != b]
                of, *to = (f"{kind}{'xyz'[k]} of {title}" for k in (b, *others))
                leaks = tuple(Parameter(f"crosstalk: {of} in {x}", "%") for x in to)
                yield DeviceLaw(
                    SENSOR, f"crosstalk of {of}", leaks, np.column_stack([share[a, b] for a in others])
                )


def _shares(situation: Situation, first: int, frame: Array) -> Array:
    """(3, 3, M) what a hundredth of component b, along axis a, adds; forces (``first`` 0) or moments (3)."""
    vector = situation.view.table.w[:, first : first + 3]
    local = np.einsum("nji,nj->ni", frame, vector)
    wrenches = []
    for a, b in np.ndindex(3, 3):
        wrench = np.zeros((len(vector), 6))
        wrench[:, first : first + 3] = _PERCENT * local[:, b, None] * frame[:, :, a]
        wrenches.append(wrench)
    return _pushed(situation, wrenches).T.reshape(3, 3, -1)


def _crosstalk(situation: Situation) -> Iterator[DeviceLaw]:
    """A share of one axis of the force sensor in its other axes."""
    loaded = [k for k in AXES if np.any(situation.view.table.w[:, k - 1])]
    terms = [Term(f"{k}{c}", VirtualJoint("load", 0, c), w(k)) for k in loaded for c in AXES if c != k]
    block = situation.columns(terms, [t.parameter for t in terms])
    for n, k in enumerate(loaded):
        source = WRENCH[k - 1]
        names = [WRENCH[c - 1] for c in AXES if c != k]
        columns = tuple(Parameter(f"crosstalk: {source} in {name}", _ratio(name, source)) for name in names)
        unit = np.array([_PERCENT if c.unit == "%" else 1.0 for c in columns])
        yield DeviceLaw(SENSOR, f"crosstalk of {source}", columns, unit * block[:, 5 * n : 5 * n + 5])


def _pulls(situation: Situation) -> Iterator[DeviceLaw]:
    """A force drawn to a fixed point like a hose's: beside the load while it acts, in absolute data all the time."""
    view = situation.view
    absolute = view.table.kind == "absolute"
    if not absolute and not view.table.w.any():
        return
    origin = view.found.T[:, :3, 3]
    fixed = [np.tile(np.arange(6) == k, (len(origin), 1)).astype(float) for k in range(3)]
    pull = np.hstack([-origin, np.zeros_like(origin)])
    columns: tuple[Parameter, ...] = (Parameter("pull towards a fixed point: spring", "N/m"),)
    columns += tuple(
        Parameter(f"pull towards a fixed point: {n} at the base's origin", "N") for n in WRENCH[:3]
    )
    place = FLANGE if absolute else SENSOR
    yield DeviceLaw(place, "pull towards a fixed point", columns, _pushed(situation, [pull, *fixed]))


def _beside(situation: Situation) -> Iterator[DeviceLaw]:
    """A load that acts beside the point of the table, in the tool's axes or in the base's: a hook, a sling."""
    view = situation.view
    force, share = view.table.w[:, :3], np.abs(load_factor(view.table))
    for title, frame in _frames(situation).items():
        wrenches = [np.hstack([0.0 * force, np.cross(frame[:, :, k], force)]) for k in range(3)]
        block = _pushed(situation, wrenches)
        for grown in (False, True) if np.ptp(share) > 0 else (False,):
            name = f"lever of the load in {title}" + (" at the largest one, growing with it" if grown else "")
            columns = tuple(Parameter(f"{name}: {axis}", "m") for axis in "xyz")
            growth = share[view.state][:, None] if grown else 1.0
            yield DeviceLaw(SENSOR, "lever of the load", columns, growth * block)


def _leans(situation: Situation) -> Iterator[DeviceLaw]:
    """A rig whose force leans as the tool stands elsewhere: on a rope from a fixed point, or in a plane in any way."""
    view = situation.view
    size = np.linalg.norm(view.table.w[:, :3], axis=1)[:, None]
    if not size.any():
        return
    tip, axes = view.found.T[:, :3, 3], np.eye(3)
    pure = [_PERCENT * size * axes[a] for a in range(3)]
    always = [Parameter(f"lean of the load: {WRENCH[a]}", "%") for a in range(3)]
    moments = np.zeros_like(tip)
    rope = [-_PERCENT * size * tip, *pure]
    yield DeviceLaw(
        SENSOR, "lean of the load", (Parameter("lean of the load: towards a point", "%/m"), *always),
        _pushed(situation, [np.hstack([force, moments]) for force in rope]),
    )  # fmt: skip
    for a, b in ((0, 1), (1, 2), (2, 0)):
        along = [(k, c) for k in (a, b) for c in (a, b)]
        forces = [*(pure[k] * tip[:, c, None] for k, c in along), pure[a], pure[b]]
        by = [Parameter(f"lean of the load: {WRENCH[k]} by {'xyz'[c]}", "%/m") for k, c in along]
        yield DeviceLaw(
            SENSOR, "lean of the load", (*by, always[a], always[b]),
            _pushed(situation, [np.hstack([force, moments]) for force in forces]),
        )  # fmt: skip


def _pushed(situation: Situation, wrenches: list[Array]) -> Array:
    """(M, k) what wrenches (N, 6) at the tool centre point add to the data."""
    view = situation.view
    loads = [
        sum((view.load_of(VirtualJoint("load", 0, c), wrench[:, c - 1]) for c in AXES), np.zeros(()))
        for wrench in wrenches
    ]
    return np.column_stack([
        np.einsum("mv,mv->m", view.J, situation.slope(load)[view.state]) for load in loads
    ])  # fmt: skip


def _ratio(of: str, to: str) -> str:
    """Unit of one component of a wrench over another."""
    return "%" if of[0] == to[0] else "m" if of[0] == "m" else "1/m"
