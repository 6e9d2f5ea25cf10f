"""What has no name and no virtual joint: gains, device, markers, loads read late, what lifts or slips."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import overload

import numpy as np

from symstiff.arrays import TINY, Array, numbered
from symstiff.calibration.experiment.situation import Situation, View, under_weights
from symstiff.calibration.tables.loading import load_factor
from symstiff.calibration.tables.measurements import Measurements, course
from symstiff.discrepancy.laws.drawing import drawing_laws
from symstiff.discrepancy.laws.moves import DEVICE, moving_laws, read_shifts
from symstiff.discrepancy.laws.posture import posture_laws
from symstiff.discrepancy.laws.sensors import FLANGE, SENSOR, sensor_laws
from symstiff.discrepancy.problem import DeviceLaw, Parameter
from symstiff.symbolic.terms import AXES, Term, VirtualJoint, deflection, link_joint, w

ORDER, FOOT = "order of the loads", "foot of the base"
_PERCENT, _MILLIONTH = 1e-2, 1e-6
_VARIES = 0.3
"""Share of a law's square that must not be constant within a pose."""
_GROWTH = (1, 2)
"""Powers of the distance by which a reading may grow beyond its scale: refraction."""
_TURNS = (1, 2)
"""Waves per turn of an encoder of the measuring device that runs out of true."""

_LEVELS = 8
"""Sizes of loads up to which one of them may be another weight than the table says."""

_LIFTS = (0.3, 0.5, 0.7)
"""Shares of the largest tilting moment from which a foot lifts, and of the largest force from which a flange slips."""


@dataclass(frozen=True, eq=False)
class DeviceLaws(Sequence[DeviceLaw]):
    """The laws that compete with the catalogue at no virtual joint, computed when one is asked for: fits need none."""

    situation: Situation

    @cached_property
    def _laws(self) -> tuple[DeviceLaw, ...]:
        return _found(self.situation)

    def __len__(self) -> int:
        """How many have an influence."""
        return len(self._laws)

    @overload
    def __getitem__(self, index: int) -> DeviceLaw: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[DeviceLaw, ...]: ...
    def __getitem__(self, index: int | slice) -> DeviceLaw | tuple[DeviceLaw, ...]:
        """One or some of them."""
        return self._laws[index]


def _found(situation: Situation) -> tuple[DeviceLaw, ...]:
    """The laws; those without an influence are left out."""
    view = situation.view
    found = [
        *_gains(situation),
        *_loads_that_differ(situation),
        *_strains(situation),
        *sensor_laws(situation),
        *_markers(view),
        *_late(situation),
        *_foot(view),
        *_slips(view),
        *moving_laws(situation),
        *posture_laws(situation),
    ]
    found += _readings(view) if view.table.kind == "absolute" else drawing_laws(situation)
    return tuple(law for law in found if np.any(law.values))


def _gains(situation: Situation) -> Iterator[DeviceLaw]:
    """Force sensor and measuring device that read one axis too large, the more the larger the load is."""
    view = situation.view
    places = {f"{SENSOR} axis {c}": (VirtualJoint("load", 0, c), w(c)) for c in AXES}
    places |= {
        f"reading of axis {c}": (VirtualJoint("measure", 0, int(c)), deflection(int(c)))
        for c in np.unique(view.component) + 1
    }
    block = _PERCENT * situation.columns([Term(n, *place) for n, place in places.items()], list(places))
    gain, grown = (Parameter("gain", "%"),), (Parameter("gain*load", "%"),)
    share, branch = np.abs(load_factor(view.table))[view.state], view.table.branch[view.state]
    every = block[:, : len(AXES)].sum(axis=1)
    for name, column in zip(places, block.T, strict=True):
        yield DeviceLaw(name, "gain", gain, column[:, None])
    rubbed = {"gain*branch": branch, "gain*branch*(1 - load)": branch * (1.0 - share)}
    for name, way in rubbed.items() if np.ptp(branch) > 0 else ():
        yield DeviceLaw(SENSOR, "gain*branch", (Parameter(name, "%"),), (way * every)[:, None])
    for what, gone in _courses(view.table):
        title = f"gain*{what}"
        yield DeviceLaw(SENSOR, title, (Parameter(title, "%"),), (gone[view.state] * every)[:, None])
    if np.ptp(share) > 0:
        for name, column in zip(places, block.T, strict=True):
            yield DeviceLaw(name, "gain*load", grown, (share * column)[:, None])
        yield DeviceLaw(SENSOR, "gain*load", grown, (share * every)[:, None])


def _courses(table: Measurements) -> Iterator[tuple[str, Array]]:
    """How far the session and its temperature have gone (N,), from 0 to 1, where the table tells them."""
    for what, values in (("time", table.time), ("temperature", table.temperature)):
        if np.all(np.isfinite(values)) and np.ptp(values) > 0:
            yield what, course(values)


def _loads_that_differ(situation: Situation) -> Iterator[DeviceLaw]:
    """Loads that are not those of the table: a weight that was not put on, in a pose, or another one in all poses."""
    view = situation.view
    more = _PERCENT * situation.columns([Term("w", VirtualJoint("load", 0, c), w(c)) for c in AXES], ["w"])
    title = "load that differs"
    for number in np.unique(view.table.pose):
        own = (view.table.pose == number)[view.state][:, None]
        yield DeviceLaw(f"pose {view.table.labels[number]}", title, (Parameter(title, "%"),), own * more)
    size = np.round(np.linalg.norm(view.table.w[:, :3], axis=1), 1)
    levels = np.unique(size[size > 0])
    if 2 < len(levels) <= _LEVELS:
        for level in levels:
            own = (size == level)[view.state][:, None]
            yield DeviceLaw(f"load of {level:g} N", title, (Parameter(title, "%"),), own * more)


def _strains(situation: Situation) -> Iterator[DeviceLaw]:
    """A device that reads too much along some direction, as along its beam: any symmetric gain.

    But for a common one, which is that of all compliances.
    """
    read = np.unique(situation.view.component[situation.view.component < 3]) + 1
    terms = {
        (int(a), int(b)): Term(f"{a}{b}", VirtualJoint("measure", 0, int(a)), deflection(int(b)))
        for a in read
        for b in read
    }
    block = situation.columns(list(terms.values()), [t.parameter for t in terms.values()])
    column = dict(zip(terms, _PERCENT * block.T, strict=True))
    pairs = [(a, b) for a, b in terms if a <= b][
        : -1 if len(read) else None
    ]  # the last axis holds the rest to none
    if len(read) > 1:
        last = column[read[-1], read[-1]]
        words = [f"{'xyz'[a - 1]}{'xyz'[b - 1]}" + " beyond the mean" * (a == b) for a, b in pairs]
        gains = [column[a, b] + (column[b, a] if a != b else -last) for a, b in pairs]
        columns = tuple(Parameter(f"gain along a direction: {word}", "%") for word in words)
        yield DeviceLaw(DEVICE, "gain along a direction", columns, np.column_stack(gains))


def _markers(view: View) -> Iterator[DeviceLaw]:
    """A marker that is not where it was told to be, or that gives way under load."""
    points = view.table.point[view.state]
    if len(np.unique(points)) < 2:
        return
    share = np.abs(load_factor(view.table))[view.state][:, None]
    fixed = (view.component[:, None] == np.arange(3)).astype(float)
    turned = np.zeros((len(view.state), 3))
    moved = view.component < 3
    tool = view.turn @ view.found.R[:, -1]
    turned[moved] = tool[view.state[moved], view.component[moved]]
    force = (_force(view) / max(float(np.max(np.abs(view.table.w[:, :3]), initial=0.0)), TINY))[view.state]
    in_tool = np.einsum("mrk,mr->mk", tool[view.state], force)
    axes, by_force, by_gravity = (
        list("xyz"),
        *([f"{a} by {v}{b}" for a in "xyz" for b in "xyz"] for v in "fg"),
    )
    laws = {
        "shift growing with the session in the tool's axes": (
            axes,
            view.table.session[view.state, None] * turned,
        ),
        "shift with the load": (axes, share * fixed),
        "shift with the load in the tool's axes": (axes, share * turned),
        "shift the way of the force": (axes, force * fixed),
        "shift by the force": (by_force, _each(fixed, force)),
        "shift by the force in the tool's axes": (by_force, _each(turned, in_tool)),
    }
    if view.table.kind == "absolute":
        down = -tool[view.state][:, 2]  # of the base's axes, in the tool's
        laws["shift in the tool's axes"] = (axes, turned)
        laws["sag by the way of gravity in the tool's axes"] = (by_gravity, _each(turned, down))
    for k in np.unique(points):
        own = (points == k)[:, None]
        for title, (names, block) in laws.items():
            columns = tuple(Parameter(f"{title}: {name}", "m") for name in names)
            yield DeviceLaw(f"marker {view.table.points[k]}", title, columns, own * block)


def _each(shifts: Array, forces: Array) -> Array:
    """(M, 9) every axis of a shift (M, 3) by every axis of the force (M, 3): any bracket that bends."""
    return np.asarray((shifts[:, :, None] * forces[:, None, :]).reshape(len(shifts), -1))


def _late(situation: Situation) -> Iterator[DeviceLaw]:
    """Readings that still hold a share of what the load before made, pose by pose.

    Not under loads that rise in equal steps: there it is a constant, as a bias or a wrong payload is.
    """
    view = situation.view
    table = view.table
    made = np.einsum("nrv,nv->nr", view.at_point, situation.laws(view.tau + view.more))
    before = np.zeros_like(made) if table.kind == "deflection" else made.copy()
    clock = table.clock
    for pose in np.unique(table.pose):
        for point in np.unique(table.point[table.pose == pose]):
            rows = np.flatnonzero((table.pose == pose) & (table.point == point))
            rows = rows[np.argsort(clock[rows], kind="stable")]
            before[rows[1:]] = made[rows[:-1]]
    change = before - made
    group = numbered(table.pose, table.point)
    constant = np.stack([np.bincount(group, c) / np.bincount(group) for c in change.T], axis=1)[group]
    if np.sum((change - constant) ** 2) > _VARIES * np.sum(change**2):
        yield DeviceLaw(ORDER, "late", (Parameter("late", "%"),), _PERCENT * view.read(change)[:, None])


def _foot(view: View) -> Iterator[DeviceLaw]:
    """A base whose foot lifts: it tilts the way of the moment across its z axis, by what is beyond a threshold."""
    across = [view.index[link_joint(0, axis)] for axis in (4, 5)]
    own = view.table.kind == "deflection" and view.robot.has_weights
    total = ((under_weights(view).tau if own else view.tau) + view.more)[:, across]
    before = total - (view.tau + view.more)[:, across] if own else np.zeros_like(total)
    largest = max(float(np.max(np.linalg.norm(total, axis=1), initial=0.0)), TINY)

    def lifted(moment: Array, lift: float) -> Array:
        size = np.linalg.norm(moment, axis=1, keepdims=True)
        beyond = np.maximum(size - lift * largest, 0.0) / ((1.0 - lift) * largest)
        return np.asarray(beyond * moment / np.maximum(size, TINY))

    for lift in _LIFTS:
        tilt = lifted(total, lift) - lifted(before, lift)
        title = f"tilt beyond {100 * lift:.0f} % of the largest moment"
        shift = np.einsum("mv,mv->m", view.J[:, across], tilt[view.state])
        yield DeviceLaw(FOOT, title, (Parameter(title, "rad"),), shift[:, None])


def _slips(view: View) -> Iterator[DeviceLaw]:
    """A flange that slips the way of the force where this is beyond a threshold."""
    force = _force(view)
    size = np.linalg.norm(force, axis=1, keepdims=True)
    for share in _LIFTS:
        slipped = (size > share * np.max(size, initial=0.0)) * force / np.maximum(size, TINY)
        title = f"slip beyond {100 * share:.0f} % of the largest force"
        yield DeviceLaw(FLANGE, title, (Parameter(title, "m"),), read_shifts(view, slipped)[:, None])


def _readings(view: View) -> Iterator[DeviceLaw]:
    """Errors of a device that stands at the origin of its readings: scale, distance, azimuth and elevation.

    Its z axis is taken for the one that it turns about.
    """
    seen = view.points
    distance = np.maximum(np.linalg.norm(seen, axis=1), 1e-9)
    across = np.maximum(np.linalg.norm(seen[:, :2], axis=1), 1e-9)
    x, y, z = seen.T
    far = (distance / distance.max())[:, None]
    ways = {
        "azimuth": (np.arctan2(y, x), np.column_stack([-y, x, np.zeros_like(x)])),
        "elevation": (np.arctan2(z, across), np.column_stack([-x * z / across, -y * z / across, across])),
    }

    def law(place: str, title: str, unit: str, *moves: Array) -> DeviceLaw:
        names = [title] if len(moves) == 1 else [f"{title}: {part}" for part in ("sin", "cos")]
        columns = tuple(Parameter(name, unit) for name in names)
        return DeviceLaw(place, title, columns, np.column_stack([read_shifts(view, move) for move in moves]))

    yield law(DEVICE, "scale error", "ppm", _MILLIONTH * seen)
    for k in range(3):
        yield law(f"reading of axis {k + 1}", "scale error", "ppm", _MILLIONTH * seen * (np.arange(3) == k))
    for n in _GROWTH:
        yield law(DEVICE, f"scale error growing with distance^{n}", "ppm", _MILLIONTH * seen * far**n)
    yield law(DEVICE, "offset of the distance", "m", seen / distance[:, None])
    yield law(DEVICE, "offset of the elevation", "rad", ways["elevation"][1])
    yield from _bent(view)
    for name, (angle, way) in ways.items():
        for n in _TURNS:
            waves = (f(n * angle)[:, None] * way for f in (np.sin, np.cos))
            yield law(DEVICE, f"{name} error, {n} per turn", "rad", *waves)


def _bent(view: View) -> Iterator[DeviceLaw]:
    """Readings in axes that are not square or alike, or by rays that bend, wherever the device stands.

    Rays bend by the square of their way; the base's z axis is up.
    """
    seen = view.points
    pairs = [(a, b) for a in range(3) for b in range(a, 3)]
    names = tuple(Parameter(f"scale error along a direction: {'xyz'[a]}{'xyz'[b]}", "ppm") for a, b in pairs)
    one = _MILLIONTH * np.eye(3)
    strains = (seen[:, [a]] * one[b] + (seen[:, [b]] * one[a] if a != b else 0.0) for a, b in pairs)
    yield DeviceLaw(
        DEVICE,
        "scale error along a direction",
        names,
        np.column_stack([read_shifts(view, s) for s in strains]),
    )
    seen = seen / max(float(np.linalg.norm(seen, axis=1).max()), 1e-9)
    ways = [*seen.T, np.sum(seen**2, axis=1)]
    names = tuple(Parameter(f"vertical error by the place: {name}", "m") for name in (*"xyz", "distance^2"))
    up = view.turn[:, :, 2]
    columns = [read_shifts(view, way[:, None] * up) for way in ways]
    yield DeviceLaw(DEVICE, "vertical error by the place", names, np.column_stack(columns))


def _force(view: View) -> Array:
    """(N, 3) forces in the device's axes, in which shifts are read."""
    return view.in_device(view.table.w[:, :3])
