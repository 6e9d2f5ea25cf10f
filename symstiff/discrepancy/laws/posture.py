"""What no virtual joint does by itself: drives that joints share, links that angles soften, mounts that harden."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from symstiff.arrays import TINY, Array
from symstiff.calibration.experiment.situation import Situation
from symstiff.calibration.tables.measurements import Measurements, course
from symstiff.discrepancy.problem import DeviceLaw, Parameter
from symstiff.effects.blocks import all_pairs, block
from symstiff.effects.common import load_of
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, actuated_joint

_PERCENT = 1e-2
_UNITS = ("m/N", "rad/N", "rad/(N*m)")
"""Of a compliance by how many of its two axes turn."""
_WRIST = 3
"""Last joints of an arm: what two of them share is in the catalogue."""


def posture_laws(situation: Situation) -> Iterator[DeviceLaw]:
    """Laws of two joints' loads, of a link's load and a joint's angle, of a mount's whole load.

    Those without an influence are not left out here.
    """
    yield from _shared_drives(situation)
    yield from _softened(situation)
    yield from _mounts(situation)


def _shared_drives(situation: Situation) -> Iterator[DeviceLaw]:
    """Belts and rods: each of two joints turns under the other's load."""
    robot = situation.view.robot
    pairs = [(j, k) for j, k in combinations(range(1, robot.dof + 1), 2) if j <= robot.dof - _WRIST]
    terms = [
        Term(f"{j} {k}", actuated_joint(to), load_of(of)) for j, k in pairs for to, of in ((j, k), (k, j))
    ]
    block = situation.columns(terms, [f"{j} {k}" for j, k in pairs])
    for (j, k), column in zip(pairs, block.T, strict=True):
        title = "compliance of each under the other's load"
        yield DeviceLaw(
            f"joints {j} and {k}", title, (Parameter(title, _unit(robot, j, k)),), column[:, None]
        )


def _unit(robot: Robot, *joints: int) -> str:
    return _UNITS[sum(not robot.joint[j - 1].prismatic for j in joints)]


def _softened(situation: Situation) -> Iterator[DeviceLaw]:
    """All springs of a link softer or stiffer by a wave of one joint's angle; a frame that is off is no spring."""
    view = situation.view
    bent = situation.theta - situation.laws(np.zeros_like(situation.theta))
    for i in range(view.table.dof + 1):
        own = slice(7 * i, 7 * i + 6)
        twist = np.einsum("nrv,nv->nr", view.at_point[:, :, own], bent[:, own])
        for j in range(view.table.dof) if np.any(twist) else ():
            title = f"compliance that follows q{j + 1}"
            for names, waves in _shapes(view.table.q[:, j], view.robot.joint[j].prismatic):
                columns = [view.read(_PERCENT * wave[:, None] * twist) for wave in waves]
                parameters = tuple(Parameter(f"{title}: {name.format(q=f'q{j + 1}')}", "%") for name in names)
                yield DeviceLaw(f"link {i}", title, parameters, np.column_stack(columns))


def _shapes(q: Array, slides: bool) -> Iterator[tuple[tuple[str, str], tuple[Array, Array]]]:
    """Pairs of functions of a joint's variable (N,) with their names."""
    if not slides:
        yield ("sin({q})", "cos({q})"), (np.sin(q), np.cos(q))
        yield ("sin(2*{q})", "cos(2*{q})"), (np.sin(2 * q), np.cos(2 * q))
    elif np.ptp(q) > 0:
        x = (2 * q - q.max() - q.min()) / np.ptp(q)
        yield ("linear over the way", "square over the way"), (x, x**2)


def _mounts(situation: Situation) -> Iterator[DeviceLaw]:
    """A floor or a tool's mount that gives way any way: the more the larger its moment is, the later or the warmer."""
    view = situation.view
    acting = view.tau + view.more
    for i in (0, view.table.dof):
        whole = block(all_pairs)(view.robot, {"link": i}, {})
        columns = situation.columns(list(whole.terms), [p.name for p in whole.parameters])
        moment = np.linalg.norm(acting[:, 7 * i + 3 : 7 * i + 6], axis=1)
        for what, share in _growing(view.table, moment):
            title = f"compliance that grows with the {what}"
            sizes = tuple(
                Parameter(f"{title}: {p.name.rpartition('_')[2]}", p.unit, typical=p.typical)
                for p in whole.parameters
            )
            yield DeviceLaw(f"link {i}", title, sizes, share[view.state, None] * columns)


def _growing(table: Measurements, moment: Array) -> Iterator[tuple[str, Array]]:
    """What a mount may give way with, as shares (N,) of the largest, where they are not all alike."""
    shares = {"load": moment / max(float(moment.max(initial=0.0)), TINY), "session": table.session}
    if np.all(np.isfinite(table.temperature)):
        shares["temperature"] = course(table.temperature)
    yield from ((what, share) for what, share in shares.items() if np.ptp(share) > 0)
