"""Figures as files, and those of plans: poses as stick figures, maps of the workspace."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from symstiff.errors import UserError
from symstiff.files import write_file

if TYPE_CHECKING:
    from symstiff.calibration.planning import Geometry, Plan, WorkspaceMap

_SHOWN, _NUMBERED = 60, 30
"""Stick figures drawn, further poses are points only; poses up to which each has its number."""


def save_figure(figure: Any, path: str | Path) -> None:
    """Write a figure as PNG or SVG by the path's ending; the same figure gives the same bytes."""
    import matplotlib

    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("png", "svg"):
        raise UserError(f"{path}: a plot is written as .png or .svg")
    buffer = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    with matplotlib.rc_context({"svg.hashsalt": "symstiff"}):
        figure.savefig(buffer, format=kind, dpi=150, metadata=metadata)
    write_file(path, buffer.getvalue())


def draw_plan(plan: Plan, robot: Geometry) -> Any:
    """Return a matplotlib Figure: a stick figure in every pose, tool centre points and forces."""
    from matplotlib.figure import Figure

    from symstiff.calibration.planning.frames import origins

    points = origins(robot, plan.q)
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    for chain in points[:_SHOWN]:
        foot = np.vstack([[chain[0, 0], chain[0, 1], 0.0], chain])
        axes.plot(*foot.T, "-o", color="0.6", linewidth=1.2, markersize=2.5)
    tips = points[:, -1]
    axes.scatter(*tips.T, color="C0", s=28, depthshade=False, label="tool centre point")
    for k, tip in enumerate(tips if len(tips) <= _NUMBERED else (), start=1):
        axes.text(*tip, f"  {k}", fontsize=7, color="0.15")
    force = plan.w[:, :3]
    longest = np.linalg.norm(force, axis=1).max()
    if longest > 0:
        arrows = force * (0.15 * np.ptp(points.reshape(-1, 3), axis=0).max() / longest)
        axes.quiver(*tips.T, *arrows.T, color="C3", linewidth=1.0, label="force")
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title=f"{plan.robot}: {len(plan)} poses")
    axes.set_aspect("equal")
    axes.xaxis.labelpad = axes.yaxis.labelpad = 9  # clear of the numbers
    axes.legend(loc="upper right", fontsize="small")
    return figure


def draw_map(result: WorkspaceMap, quantity: str = "deflection") -> Any:
    """Return a matplotlib Figure of the slice, seen across the plane in which the tool moves most.

    ``quantity`` is deflection [mm] or stiffness [N/µm].
    """
    from matplotlib.figure import Figure

    shown = {
        "deflection": (1e3 * result.magnitude, "deflection [mm]"),
        "stiffness": (1e-6 * result.stiffness, "stiffness along the force [N/µm]"),
    }
    if quantity not in shown:
        raise UserError(f"quantity {quantity!r}: use deflection or stiffness")
    values, label = shown[quantity]
    spread = np.ptp(result.tip.reshape(-1, 3), axis=0)
    across, up = sorted(np.argsort(-spread, kind="stable")[:2])
    figure = Figure(figsize=(6.5, 5.0), layout="constrained")
    axes: Any = figure.add_subplot()
    mesh = axes.pcolormesh(
        result.tip[..., across], result.tip[..., up], np.ma.masked_invalid(values), shading="gouraud"
    )
    figure.colorbar(mesh, ax=axes, label=label)
    axes.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]", aspect="equal")
    axes.set_title(f"joints {result.joints[0]} and {result.joints[1]} swept")
    return figure
