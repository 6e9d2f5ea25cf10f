"""Whether loads, poses and rows can determine the parameters at all, in words that say what to measure."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.fits.rank import RankDecision
from symstiff.display import few
from symstiff.errors import UserError
from symstiff.reduction.admissible import JOINT, LINK
from symstiff.robot.tool import tool_of, with_tool
from symstiff.symbolic.numeric import forward
from symstiff.symbolic.terms import WRENCH

if TYPE_CHECKING:
    from symstiff.model import StiffnessModel
    from symstiff.robot import Robot

_SAME = 1e-9  # m between two tool centre points that are one
_FAR = 100.0  # times the robot file's compliance from which a unit is questioned
_CLEAR = 0.5  # largest deviation, as a share of the value, of a compliance that is compared
_ONE_WAY = 1e-3  # second singular value of loads' directions over the first, below which they are one
_SECOND_ORDER = 5e-6  # m that a deflection leaves by moving the loads' levers, from which that is spoken of
_STILL = 1e-6  # rad, m by which a joint that stands still may be off

_LOADS = {
    "1": "a force along its beam axis",
    "2": "a force across its beam axis (second axis)",
    "3": "a force across its beam axis (third axis)",
    "4": "a torque about its beam axis",
    "5": "a bending moment about its second axis",
    "6": "a bending moment about its third axis",
}


def check_loads(w: Array, place: Callable[[int], str] = lambda row: f"row {row + 1}") -> list[str]:
    """Warnings about wrenches, (N, 6) in N and N·m, that say little; UserError where all are zero.

    ``place`` tells where a row stands.
    """
    w = np.asarray(w, dtype=float)
    sizes = np.linalg.norm(w, axis=1)
    if not len(w) or not sizes.any():
        raise UserError(
            "every wrench is zero: nothing bends without a load, give fx … mz at the tool centre point "
            "in N and N*m"
        )
    loaded = w[sizes > 0] / sizes[sizes > 0, None]
    warnings = []
    if len(loaded) < len(w):
        rows = np.flatnonzero(sizes == 0)
        warnings.append(
            f"{len(rows)} of {len(w)} rows carry no load (first: {place(int(rows[0]))}): they show noise, "
            "or what a load before them left"
        )
    singular = np.linalg.svd(loaded, compute_uv=False)
    if len(singular) == 1 or singular[1] < _ONE_WAY * singular[0]:
        direction = loaded[0] * np.sign(loaded[0][np.argmax(np.abs(loaded[0]))])
        shown = ", ".join(f"{value:.3g}" for value in direction)
        warnings.append(
            f"all loads point along one direction ({shown} in fx … mz): stiffness against other loads "
            "is inferred at best; add loads across it, or reduce the model for this class of loads"
        )
    return warnings


def check_poses(q: Array, w: Array, labels: Sequence[str]) -> list[str]:
    """Warnings about poses that repeat another's configuration and load under a new label.

    q: (N, n) rad or m, w: (N, 6), labels: (N,), a row per pose and load case.
    """
    keys = np.round(np.hstack([np.asarray(q, dtype=float), np.asarray(w, dtype=float)]), 9)
    first: dict[bytes, str] = {}
    copies: dict[str, str] = {}
    for key, label in zip(keys + 0.0, labels, strict=True):
        earlier = first.setdefault(key.tobytes(), label)
        if earlier != label:
            copies.setdefault(label, earlier)
    if not copies:
        return []
    some = ", ".join(f"{label} = {earlier}" for label, earlier in list(copies.items())[:5])
    return [
        f"{len(copies)} pose(s) repeat another's joints and load ({some}{' …' if len(copies) > 5 else ''}): "
        "they lower the noise, and determine no further parameter"
    ]


def check_bends(model: StiffnessModel, origin: str = "the model") -> None:
    """Raise UserError where a model has no values, or none but zeros: a start for ``identify``, which bends nothing."""
    if not any(model.values.values()):
        raise UserError(
            f"{origin}: values: there are none but zeros, and nothing bends: identify first, which takes it as a start "
            "(--start)"
        )


def outside_class(w: Array, loads: str) -> list[str]:
    """A remark where wrenches (N, 6) have components that a model's class of loads leaves out."""
    within = {"gravity": ("fz",), "force": WRENCH[:3]}.get(loads, WRENCH)
    found = [n for n, used in zip(WRENCH, np.any(np.asarray(w) != 0, axis=0), strict=True) if used]
    beyond = [n for n in found if n not in within]
    if not beyond:
        return []
    wider = "wrench" if any(n[0] == "m" for n in found) else "force"
    return [
        f"the model is reduced for {loads} loads ({', '.join(within)}), and these have {', '.join(beyond)} too: what "
        f"they do to the robot is not in the model; use --loads {wider}"
    ]


def nothing_bends(w: Array, model: StiffnessModel) -> list[str]:
    """A remark where there are loads (N, 6), and all compliances of a model are zero, as positions may leave them."""
    if not np.any(w) or model.bends:
        return []
    return [
        "all compliances of the model are zero: what loads do to the robot is not in it; identify with loaded poses, "
        "or deflections"
    ]


def outside_fixed(q: Array, model: StiffnessModel) -> list[str]:
    """A remark where joints (N, n) stand elsewhere than those that a model was reduced for."""
    off = [
        j
        for j, value in model.fixed.items()
        if np.abs(np.asarray(q)[:, j - 1] - value).max(initial=0.0) > _STILL
    ]
    if not off:
        return []
    told = ", ".join(
        f"q{j} = {model.fixed[j]:.6g} {'m' if model.robot.joint[j - 1].prismatic else 'rad'}" for j in off
    )
    return [
        f"the model was reduced for {told}, and these poses have other values: its compliances are sums that hold "
        "there alone; identify with poses that move these joints"
    ]


def check_same_robot(model: StiffnessModel, robot: Robot, origin: str) -> None:
    """Raise UserError where a model was made of another robot, or of one with another geometry.

    The same are a robot file and a model whose tool was moved from that file's to the point that was measured.
    """
    if model.robot.name != robot.name:
        raise UserError(
            f"{origin} is a model of {model.robot.name}, not of {robot.name}: name that robot, or give a model of this"
        )
    apart = geometry_apart(model.robot, robot)
    if apart > _SAME and model.file_tool is not None:
        apart = geometry_apart(with_tool(model.robot, model.file_tool), robot)
    if apart > _SAME:
        raise UserError(
            f"{origin} was made with another geometry than {robot.name}'s robot file: their tool centre points are "
            f"up to {1e3 * apart:.3g} mm apart; give the robot file it was made with, or identify again"
        )


def other_weights(model: StiffnessModel, robot: Robot) -> list[str]:
    """A remark where a model was made with other masses of links than a robot file tells now: it keeps its own."""
    own, told = ([(link.mass, link.com) for link in r.links] for r in (model.robot, robot))
    if own == told:
        return []
    return [
        "the start model holds other masses or centres of mass of links than the robot file, and goes on with its own: "
        "start with complete, or with a model that is made anew, to use those of the file"
    ]


def geometry_apart(one: Robot, other: Robot) -> float:
    """Greatest distance [m] between the tool centre points of two robots at a few joint angles."""
    if one.dof != other.dof:
        return math.inf
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, one.dof))
    away = forward(one, q) - forward(other, q)
    turned = np.abs(away[:, :3, :3]).max() * one.reach
    return float(max(np.linalg.norm(away[:, :3, 3], axis=1).max(), turned))


def check_tool(model: StiffnessModel, robot: Robot) -> None:
    """Raise UserError where a start model's tool is a measured point that the robot file does not tell."""
    if model.file_tool is not None and geometry_apart(model.robot, robot) > _SAME:
        xyz = ", ".join(f"{x:g}" for x in tool_of(model.robot))
        raise UserError(
            f"the start model's tool centre point is a point that was measured, and these tables do not tell whether "
            f"theirs is the same: give a robot file with xyz = [{xyz}] under [tool], or another start"
        )


def of_levers(robot: Robot, deflection: float) -> list[str]:
    """A remark where a deflection [m], rms, moves the loads' levers: its square over the reach is no longer small."""
    left = deflection**2 / robot.reach
    if left < _SECOND_ORDER:
        return []
    return [
        f"deflections of {1e3 * deflection:.3g} mm move the levers of the loads: of the order of {1e3 * left:.2g} mm "
        "is left by that, which no model of the unloaded arm compensates"
    ]


def of_tool(model: StiffnessModel) -> list[str]:
    """A remark on a model whose tool centre point is not that of the robot file."""
    if model.file_tool is None:
        return []
    measured, told = (", ".join(f"{x:g}" for x in xyz) for xyz in (tool_of(model.robot), model.file_tool))
    return [
        f"the model's tool centre point is the point that was measured, xyz = [{measured}] m, and not that of the "
        f"robot file, [{told}]: loads act there, and deflections are told there"
    ]


def unlike_file(model: StiffnessModel, robot: Robot) -> list[str]:
    """A remark where identified joint compliances are far from those of the robot file: a unit is likely wrong."""
    far = []
    for i, joint in enumerate(robot.joint, start=1):
        known, value = joint.compliance or 0.0, model.values.get(f"c{i}", 0.0)
        clear = model.deviations.get(f"c{i}", 0.0) < _CLEAR * abs(value)
        if known > 0 and value > 0 and clear and not 1 / _FAR < value / known < _FAR:
            far.append(f"c{i} {value / known:.2g} times")
    if not far:
        return []
    return [
        f"joint compliances are far from the robot file's ({', '.join(far)}): check the units of loads and "
        "deflections, such as kN under fz[N]"
    ]


def missing_information(
    decision: RankDecision, names: Sequence[str], rows: int, slides: Collection[int] = (),
    unread: Sequence[str] = (),
) -> str | None:  # fmt: skip
    """What the data leave open and what would help; None where every parameter is determined.

    slides: joints; unread: translations that no row holds, which may be what shows a parameter.
    """
    if decision.full:
        return None
    total = len(names)
    cause = f"{decision.rank} of {total} parameter directions are determined"
    if rows < total:
        cause = f"{rows} measured values for {total} parameters; " + cause
    elif decision.rank < decision.numerical_rank:
        cause += f" ({decision.numerical_rank} without noise)"
    silent = [name for name in names if name in set(decision.silent)]
    mixed = [name for name in names if name in set(decision.affected) - set(silent)]
    parts = [cause]
    more = f"{' and '.join(unread)} measured as well" if unread else ""
    if silent:
        why = "in no reading" if unread else "not loaded at all"
        parts.append(
            f"{why}: {few(silent)}; needed: {_needed(silent, slides)}{', or ' if more else ''}{more}"
        )
    if mixed:
        # what shows along one axis alone may be the same there in every pose
        needed = f"{more}, or rotations: more poses alone may not tell them" if more else _separate(mixed)
        parts.append(f"not told apart: {few(mixed)}; needed: {needed}")
    return "; ".join(parts)


def check_determined(
    decision: RankDecision,
    names: Sequence[str],
    rows: int,
    doubts: Sequence[str] = (),
    slides: Collection[int] = (),
    unread: Sequence[str] = (),
) -> None:
    """Raise UserError with `missing_information` where some parameter is not determined.

    ``doubts`` about the model come first: a rounded angle makes parameters that no measurement tells apart.
    """
    message = missing_information(decision, names, rows, slides, unread)
    if message is not None:
        before = "".join(f"{doubt}; " for doubt in doubts)
        raise UserError(
            f"{before}the measurements do not determine the model: {message}, or symstiff diagnose, which leaves them "
            "at zero"
        )


def check_beside_geometry(open_ones: Sequence[str]) -> None:
    """Raise UserError for parameters that absolute positions do not determine beside the geometry."""
    if open_ones:
        shown = ", ".join(open_ones[:8]) + (f" and {len(open_ones) - 8} more" * (len(open_ones) > 8))
        raise UserError(
            f"the positions do not determine {shown} beside geometry and placement: measure more poses and loads, or "
            "deflections (dx[mm] …, loaded minus unloaded), or use symstiff diagnose, which leaves them at zero"
        )


def _needed(names: Sequence[str], slides: Collection[int]) -> str:
    """Loads that would excite parameters that no row contains."""
    wishes: dict[str, None] = {}
    for name in names:
        link, joint = LINK.fullmatch(name), JOINT.fullmatch(name)
        if joint:
            load = "force along" if int(joint[1]) in slides else "moment about"
            wishes[f"a load with a {load} the axis of joint {joint[1]}"] = None
        elif link:
            for axis in dict.fromkeys((link[2], link[3])):
                wishes[f"on link {link[1]} {_LOADS[axis]}"] = None
        else:
            wishes[f"rows in which {name} takes part"] = None
    return ", ".join(wishes)


def _separate(names: Sequence[str]) -> str:
    """Poses that would tell confounded parameters apart: joints between their bodies must differ."""
    bodies = set()
    for name in names:
        link, joint = LINK.fullmatch(name), JOINT.fullmatch(name)
        if link:
            bodies.add(int(link[1]))
        elif joint:
            bodies.add(int(joint[1]))
    if not bodies:
        return "more poses and load directions"
    low, high = min(bodies), max(bodies)
    if low == high:
        return f"loads on link {low} in more directions: turn the joints before it"
    joints = f"joint {high}" if high == low + 1 else f"joints {low + 1} to {high}"
    return f"poses with more values of {joints}, loads in more directions, rotations measured as well"
