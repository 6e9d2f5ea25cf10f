"""What stood elsewhere: targets, or the device, always, from some time on, or moving on in the session."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import PurePath

import numpy as np

from symstiff.arrays import Array, Mask
from symstiff.calibration.experiment.situation import Situation, View
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.laws.sensors import FLANGE
from symstiff.discrepancy.problem import DeviceLaw, Parameter
from symstiff.effects.common import XYZ, turned

DEVICE = "measuring device"
_WAVES = (1.0, 1.5, 2.0)
"""Times in a session that a device may move to and fro: a drift tells what is slower."""
_SETTLES = 4.0
"""Time constants in a session of a device that warms up."""
_CUTS = 20
"""Moments of a session at which something may have moved, at most."""


def moving_laws(situation: Situation) -> Iterator[DeviceLaw]:
    """Shifts and turns of what is read, and of what reads."""
    view = situation.view
    yield from _always(view)
    yield from _moved_once(situation)
    yield from _turning(situation)
    yield from _swaying(situation)
    yield from _since_unloaded(view)


def _shifted(view: View) -> tuple[tuple[str, Array, str], ...]:
    """What may stand elsewhere: the place, its axes (N, 3, 3) in the device's, and whose they are."""
    fixed = np.tile(np.eye(3), (len(view.table), 1, 1))
    return (FLANGE, view.turn @ view.found.R[:, -1], "tool"), (DEVICE, fixed, "device")


def _always(view: View) -> Iterator[DeviceLaw]:
    """A shift that every load shows alike: the tool, or the device, stood elsewhere when nothing was on it."""
    if view.table.kind == "absolute":
        return
    for place, frame, axes in _shifted(view):
        title = f"shift under any load in the {axes}'s axes"
        columns = tuple(Parameter(f"{title}: {axis}", "m") for axis in "xyz")
        yield DeviceLaw(
            place, title, columns, np.column_stack([read_shifts(view, frame[:, :, k]) for k in range(3)])
        )


def _moved_once(situation: Situation) -> Iterator[DeviceLaw]:
    """Targets, or the device, that moved once and stayed there; a device also that turned."""
    view = situation.view
    about = _turns(situation)
    for when, since in _moments(view.table):
        for place, frame, axes in _shifted(view):
            columns = tuple(Parameter(f"shift {when} in the {axes}'s axes: {axis}", "m") for axis in "xyz")
            block = np.column_stack([read_shifts(view, since[:, None] * frame[:, :, k]) for k in range(3)])
            yield DeviceLaw(place, "shift from some time on", columns, block)
            if place == DEVICE:
                turns = tuple(Parameter(f"turn {when} in the {axes}'s axes: {axis}", "rad") for axis in "xyz")
                rows = since[view.state, None] * about
                if view.table.kind == "absolute":  # what turns about another point is shifted too
                    turns, rows = (*columns, *turns), np.hstack([block, rows])
                yield DeviceLaw(place, "turn from some time on", turns, rows)


def _moments(table: Measurements) -> Iterator[tuple[str, Mask]]:
    """Since when something may stand elsewhere, in words and as rows (N,): since a file, or a moment of the session."""
    files = [k for k in np.unique(table.file) if k > np.min(table.file)] if len(table.files) > 1 else []
    for k in files:
        yield f"from {PurePath(table.files[k]).name} on", table.file >= k
    clock = table.clock
    # where one pose stands alone, before or after, it is a bad pose
    begin = np.sort([clock[table.pose == p].min() for p in np.unique(table.pose)])[2:-1]
    for cut in begin[:: max(1, round(len(begin) / _CUTS))]:
        since = clock >= cut
        if not any(np.array_equal(since, table.file >= k) for k in files):
            yield f"from {100 * np.mean(~since):.0f} % of the session on", since


def _turning(situation: Situation) -> Iterator[DeviceLaw]:
    """A device that turns slowly, about where it stands, as its tripod settles or the sun warms it."""
    session, about = situation.view.table.session, _turns(situation)
    if not np.any(session):
        return
    for zero, when in ((0.0, "since the session began"), (0.5, "through the session, none in its middle")):
        columns = tuple(Parameter(f"turn {when}: {axis}", "rad") for axis in "xyz")
        rows = (session - zero)[situation.view.state][:, None] * about
        yield DeviceLaw(DEVICE, "turn growing with the session", columns, rows)


def _swaying(situation: Situation) -> Iterator[DeviceLaw]:
    """A device that moves to and fro in the session, as the floor under it warms and cools."""
    view = situation.view
    session = view.table.session
    if not np.any(session):
        return
    block, names = _along_axes(view, np.ones(len(session))), [("shift", axis, "m") for axis in "xyz"]
    if view.table.kind == "absolute":
        block, names = (
            np.hstack([block, _turns(situation)]),
            [*names, *(("turn", axis, "rad") for axis in "xyz")],
        )
    for waves in _WAVES:
        angle = (2.0 * np.pi * waves * session)[view.state, None]
        parts = {"sin": np.sin(angle), "cos": np.cos(angle)}
        columns = tuple(
            Parameter(f"{what} to and fro, {waves:g} times in the session, {part}: {axis}", unit)
            for part in parts
            for what, axis, unit in names
        )
        yield DeviceLaw(
            DEVICE, "to and fro in the session", columns, np.hstack([p * block for p in parts.values()])
        )


def _since_unloaded(view: View) -> Iterator[DeviceLaw]:
    """A device that drifts between a visit's reading without load and the others, steadily or ever less in the session.

    The reading without load is taken to come as long before the first load as the next loads follow it.
    """
    session, told = view.table.session, np.isfinite(view.table.time).all()
    if view.table.kind == "absolute" or not told or not np.any(session):
        return
    waited = np.zeros(len(view.table))
    for visit in np.unique(view.table.approach):
        own = view.table.approach == visit
        moments = np.unique(session[own])
        if len(moments) > 1:
            waited[own] = session[own] - moments[0] + float(np.median(np.diff(moments)))
    for slowing, how in ((0.0, "steadily"), (_SETTLES, "ever less in the session")):
        columns = tuple(
            Parameter(f"shift since the reading without load, {how}: {axis}", "m") for axis in "xyz"
        )
        block = _along_axes(view, waited * np.exp(-slowing * session))
        yield DeviceLaw(DEVICE, "shift since the reading without load", columns, block)


def _turns(situation: Situation) -> Array:
    """(M, 3) what turns of the device about its axes change of the readings."""
    view = situation.view
    if view.table.kind == "absolute":
        return np.column_stack([read_shifts(view, np.cross(axis, view.points)) for axis in np.eye(3)])
    return situation.columns([term for k, name in enumerate(XYZ) for term in turned(name, k)], list(XYZ))


def _along_axes(view: View, share: Array) -> Array:
    """(M, 3) rows of shifts along the device's axes, times a share (N,) of every state."""
    return np.column_stack([read_shifts(view, share[:, None] * axis) for axis in np.eye(3)])


def read_shifts(view: View, moves: Array) -> Array:
    """Rows (M,) of shifts (N, 3) of the measured points; attitudes are not moved."""
    return view.read(np.column_stack([moves, np.zeros_like(moves)]))
