"""A robot as a table for reading: its DH rows, the links behind them, base and tool."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.display import html_table

if TYPE_CHECKING:
    from symstiff.robot.exact import Exact
    from symstiff.robot.schema import Link, Placement, Robot

_COLUMNS = ("i", "joint", "a [m]", "α [rad]", "d [m]", "θ [rad]", "range", "joint compliance", "link i")


def robot_html(robot: Robot) -> str:
    """The DH table with joint ranges, known joint compliances and the links' elastic frames."""
    rows = [(0, "–", *[""] * 6, _link(robot.base.link))]
    for i, joint in enumerate(robot.joint, start=1):
        variable = f"q{i}"
        low, high = joint.range
        d, theta = _sum(joint.d, variable, joint.prismatic), _sum(joint.theta, variable, not joint.prismatic)
        unit = "m/N" if joint.prismatic else "rad/(N·m)"
        compliance = f"{joint.compliance:.4g} {unit}" if joint.compliance else "–"
        span = f"{low:.4g} … {high:.4g} {'m' if joint.prismatic else 'rad'}"
        numbers = (_exact(joint.a), _exact(joint.alpha), d, theta, span, compliance)
        rows.append((i, joint.type, *numbers, _link(joint.link)))
    caption = f"{robot.title or robot.name}: {robot.convention} DH convention"
    note = f"base: {_placement(robot.base)}; tool: {_placement(robot.tool)}. {robot.source}"
    return html_table(_COLUMNS, rows, caption, [note])


def _sum(offset: Exact, variable: str, moves: bool) -> str:
    if not moves:
        return _exact(offset)
    return f"{_exact(offset)} + {variable}" if offset else variable


def _exact(value: Exact) -> str:
    """A length as a decimal, an angle as a multiple of π."""
    return str(value).replace("*pi", "π").replace("pi", "π") if value.pi else f"{float(value):g}"


def _link(link: Link) -> str:
    axis = link.beam_axis
    if axis is None:
        return link.template
    along = axis if isinstance(axis, str) else f"({', '.join(_exact(v) for v in axis)})"
    return f"{link.template} along {along}" if link.template != "rigid" else "rigid"


def _placement(placement: Placement) -> str:
    moved = [f"xyz ({', '.join(_exact(v) for v in placement.xyz)}) m"]
    if any(placement.rpy):
        moved.append(f"rpy ({', '.join(_exact(v) for v in placement.rpy)}) rad")
    return ", ".join(moved)
