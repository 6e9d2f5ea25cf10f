"""A plan as files: the poses table that an experiment starts from, what the plan promises, a picture."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from symstiff.calibration.measurements import Measurements, measurements
from symstiff.calibration.planning.frames import Geometry, origins
from symstiff.calibration.planning.plan import Plan
from symstiff.errors import UserError
from symstiff.files import write_file

_SHOWN = 60  # stick figures drawn; further poses are points only


def poses_table(plan: Plan, robot: Geometry) -> Measurements:
    """Return the plan as a measurement table without measured values: q, wrench, labels p1, p2, …."""
    units = ["m" if prismatic else "rad" for prismatic, *_ in robot.rows]
    return measurements(
        plan.q,
        plan.w,
        labels=[f"p{k + 1}" for k in range(len(plan))],
        pose=np.arange(len(plan)),
        joint_units=units,
    )


def summary(plan: Plan) -> dict[str, Any]:
    """Return what the plan promises as plain values for JSON: criterion, efficiencies, deviations."""
    return {
        "robot": plan.robot,
        "poses": len(plan),
        "criterion": plan.criterion,
        "score": plan.score,
        "expected_error_mm": None if plan.expected_error is None else 1e3 * plan.expected_error,
        "efficiency": {
            # random draws that find no parameter at all make the ratio infinite, which JSON cannot say
            "over_random": plan.over_random if np.isfinite(plan.over_random) else None,
            "over_candidates": plan.over_candidates,
            "of_bound": plan.of_bound,
        },
        "method": plan.method,
        "candidates": plan.candidates,
        "seed": plan.seed,
        "std": {name: float(s) for name, s in zip(plan.parameters, plan.std, strict=True)},
    }


def draw_plan(plan: Plan, robot: Geometry) -> Any:
    """Return a matplotlib Figure: a stick figure in every pose, tool centre points and forces."""
    from matplotlib.figure import Figure

    points = origins(robot, plan.q)
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d")
    for chain in points[:_SHOWN]:
        foot = np.vstack([[chain[0, 0], chain[0, 1], 0.0], chain])
        axes.plot(*foot.T, "-o", color="0.6", linewidth=1.2, markersize=2.5)
    tips = points[:, -1]
    axes.scatter(*tips.T, color="C0", s=28, depthshade=False, label="tool centre point")
    force = plan.w[:, :3]
    longest = np.linalg.norm(force, axis=1).max()
    if longest > 0:
        arrows = force * (0.15 * np.ptp(points.reshape(-1, 3), axis=0).max() / longest)
        axes.quiver(*tips.T, *arrows.T, color="C3", linewidth=1.0, label="force")
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", title=f"{plan.robot}: {len(plan)} poses")
    axes.set_aspect("equal")
    axes.legend(loc="upper right", fontsize="small")
    return figure


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
