"""Plausible complete compliances of a robot of which only the geometry is known.

The rule. Every link is a thin aluminium tube, fixed at one end, as long as the distance between its DH
frames (the pedestal: its height; the last link: up to the tool centre point; at least its own diameter).
Diameters taper linearly from 14 % of the reach at the base to 5 % at the tool; the wall is 6 % of the
diameter. The tip compliance of such a beam (bending, shear, torsion, tension) fills the eight terms in the
link's elastic frame. Joints without a known compliance get 1e-5 rad/(N·m)·(1.3 m/reach)^4.4 in the first
half of the arm, half as much again at joint 3 and eight times as much in the wrist, at most ten times the
largest known one: a UR10 has 1e-5 at a reach of 1.3 m, a KR 270 0.3e-6 at 2.9 m. Last, all links are scaled
by one factor so that they carry 35 % of the deflection (rms over poses within the limits under a vertical
force), as on heavy robots. What the robot file knows stands, what it does not know goes with it, and entries
that a link's template has as zero are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from symstiff.arguments import A_ROBOT, require
from symstiff.calibration.simulation.chain import Chain, chain_of, joint_index, posture
from symstiff.robot import Robot
from symstiff.robot.schema import Link

_YOUNG, _SHEAR, _SHEAR_AREA = 70e9, 26e9, 0.5
_BASE_DIAMETER, _TOOL_DIAMETER, _WALL = 0.14, 0.05, 0.06
_LINK_SHARE = 0.35
_SHOULDER, _REACH, _POWER = 1e-5, 1.3, 4.4
_WRIST, _ELBOW = 8.0, 1.5
_POSES = 64
_BEAM = ("*.....", ".*...*", "..*.*.", "...*..", "..*.*.", ".*...*")
_COUPLING = 0.75  # greatest k_ab²/(k_aa·k_bb) of a beam: one that only bends


def nominal_truth(robot: Robot) -> dict[str, float]:
    """Return complete compliances by name (``k<i>_<ab>``, ``c<j>``) that suit the robot's size, SI units."""
    require(robot, Robot, *A_ROBOT)
    chain = chain_of(robot)
    reach = _reach(chain)
    joints = _joints(robot, reach)
    beams = [_within(robot, link, _beam(chain, i, reach)) for i, link in enumerate(robot.links)]
    factor = _balance(chain, joints, _named(beams))
    links = []
    for link, beam in zip(robot.links, beams, strict=True):
        known = _within(robot, link, {key: float(value) for key, value in link.compliance.items()})
        links.append(_beside({key: value * factor for key, value in beam.items()}, known))
    return _named(links) | joints


def linear_compliance(chain: Chain, values: dict[str, float]) -> np.ndarray:
    """Arrange named compliances as the (V, V) matrix of the virtual joints."""
    matrix = np.zeros((chain.size, chain.size))
    for name, value in values.items():
        if name.startswith("c"):
            v = joint_index(int(name[1:]))
            matrix[v, v] = value
        else:
            link, _, entry = name[1:].partition("_")
            row, column = 7 * int(link) + int(entry[0]) - 1, 7 * int(link) + int(entry[1]) - 1
            matrix[row, column] = matrix[column, row] = value
    return matrix


def _reach(chain: Chain) -> float:
    """Farthest horizontal or vertical stretch from joint 1's axis: lengths beyond the first offset."""
    lengths = np.hypot(chain.a, chain.d)
    lengths[0] = abs(chain.a[0])
    strokes = sum(max(map(abs, j.range)) for j in chain.robot.joint if j.prismatic)
    return float(max(lengths.sum() + np.linalg.norm(chain.tool) + strokes, 1e-3))


def _joints(robot: Robot, reach: float) -> dict[str, float]:
    typical = _SHOULDER * (_REACH / reach) ** _POWER
    known = [float(j.compliance) for j in robot.joint if j.compliance and not j.prismatic]
    result = {}
    for k, joint in enumerate(robot.joint):
        wrist = k >= max(3, robot.dof // 2)
        value = typical * (_WRIST if wrist else _ELBOW if k == 2 else 1.0)
        if known:
            value = min(max(value, min(known)), max(known) if wrist else min(known) * _ELBOW)
        if joint.prismatic:
            value = typical * (reach / 4) ** 2
        result[f"c{k + 1}"] = float(joint.compliance) or value
    return result


def _beam(chain: Chain, link: int, reach: float) -> dict[str, float]:
    along = link / max(chain.dof, 1)
    diameter = reach * (_BASE_DIAMETER + (_TOOL_DIAMETER - _BASE_DIAMETER) * along)
    length = max(_length(chain, link), diameter)
    inner = diameter * (1 - 2 * _WALL)
    area = math.pi / 4 * (diameter**2 - inner**2)
    inertia = math.pi / 64 * (diameter**4 - inner**4)
    bending = length / (_YOUNG * inertia)
    side = bending * length**2 / 3 + length / (_SHEAR_AREA * _SHEAR * area)
    return {
        "11": length / (_YOUNG * area),
        "22": side,
        "26": bending * length / 2,
        "33": side,
        "35": -bending * length / 2,
        "44": length / (_SHEAR * 2 * inertia),
        "55": bending,
        "66": bending,
    }


def _within(robot: Robot, link: Link, entries: dict[str, float]) -> dict[str, float]:
    """Those of a link's entries that its template has; a coupling needs both of its rows."""
    rows: dict[str, tuple[str, ...]] = {"full": ("*" * 6,) * 6, "beam": _BEAM, "rigid": ("." * 6,) * 6}
    rows |= {own.name: tuple(own.pattern) for own in robot.template}
    has = [[entry == "*" for entry in row] for row in rows[link.template]]
    places = {key: (int(key[0]) - 1, int(key[1]) - 1) for key in entries}
    return {
        key: value
        for key, value in entries.items()
        if all(has[a][b] for a in places[key] for b in places[key])
    }


def _beside(beam: dict[str, float], known: dict[str, float]) -> dict[str, float]:
    """A link's entries with the known ones among them: rows are scaled so that the body stays elastic (k ≥ 0)."""
    scale = {
        key[0]: math.sqrt(known.get(key, value) / value) for key, value in beam.items() if key[0] == key[1]
    }
    for key, value in known.items():
        free = [c for c in key if c * 2 not in known]
        most = math.sqrt(_COUPLING * beam[key[0] * 2] * beam[key[1] * 2]) * scale[key[0]] * scale[key[1]]
        if free and 0.0 < most < abs(value):
            scale |= {c: scale[c] * (abs(value) / most) ** (1 / len(free)) for c in free}
    return {key: value * scale[key[0]] * scale[key[1]] for key, value in beam.items()} | known


def _named(links: Sequence[dict[str, float]]) -> dict[str, float]:
    return {f"k{i}_{key}": value for i, link in enumerate(links) for key, value in link.items()}


def _length(chain: Chain, link: int) -> float:
    if link == 0:
        return float(np.linalg.norm(chain.base[:3, 3]))
    length = math.hypot(chain.a[link - 1], chain.d[link - 1])
    return length + float(np.linalg.norm(chain.tool)) if link == chain.dof else length


def _balance(chain: Chain, joints: dict[str, float], links: dict[str, float]) -> float:
    """Return the factor that gives the links their share of the deflection."""
    rng = np.random.default_rng(270)
    limits = chain.robot.ranges
    q = rng.uniform(limits[:, 0], limits[:, 1], (_POSES, chain.dof))
    now = posture(chain, q, np.zeros((_POSES, chain.size)))
    tip = now.at(chain.tool)[:, None] - now.origin
    columns = np.where(chain.translational[:, None], now.axis, np.cross(now.axis, tip))
    tau = columns[:, :, 2]

    def rms(values: dict[str, float]) -> float:
        moved = np.einsum("nvi,nv->ni", columns, tau @ linear_compliance(chain, values))
        return float(np.sqrt(np.mean(moved**2)))

    by_joints, by_links = rms(joints), rms(links)
    if by_joints == 0.0 or by_links == 0.0:
        return 1.0
    return _LINK_SHARE / (1 - _LINK_SHARE) * by_joints / by_links
