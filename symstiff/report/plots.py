"""Pictures of a diagnosis as SVG text that stands in an HTML page without any outside resource."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.discrepancy.growth import contribution
from symstiff.discrepancy.localise import back_project
from symstiff.discrepancy.problem import Array
from symstiff.discrepancy.speech import named
from symstiff.discrepancy.workflow import Finding, Found
from symstiff.effects.base import EffectInstance
from symstiff.report.tables import by_state, standardised

BEFORE, AFTER, NOISE, LAW = "#9aa7b4", "#1f6f8b", "#b8860b", "#c0392b"
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
_STYLE = {
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#666",
    "axes.labelcolor": "#333",
    "xtick.color": "#444",
    "ytick.color": "#444",
    "legend.frameon": False,
    "axes.titlesize": 9,
}


@dataclass(frozen=True)
class Picture:
    """A picture with its caption."""

    svg: str
    caption: str


@contextmanager
def _drawing(name: str, width: float, height: float) -> Iterator[tuple[Any, list[str]]]:
    """A figure; its SVG text is appended to the list when all is drawn."""
    import matplotlib
    from matplotlib.figure import Figure

    out: list[str] = []
    with matplotlib.rc_context({**_STYLE, "svg.hashsalt": f"symstiff {name}"}):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, out
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    out.append(inline(buffer.getvalue()))


def inline(svg: str) -> str:
    """SVG for the body of an HTML page: no prologue, no metadata, no name spaces (HTML knows them)."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg)
    return svg.replace('width="', 'style="max-width:100%;height:auto" width="', 1)


def draw_gap(finding: Finding) -> Picture:
    """Root mean squares before and after, on the poses used and on held-out ones, against the noise."""
    r = finding.rms
    rows = [("all poses", r.before, r.after)]
    if r.held_out_before is not None and r.held_out_after is not None:
        rows.append(("held-out poses", r.held_out_before, r.held_out_after))
    with _drawing("gap", 7.2, 0.75 + 0.62 * len(rows)) as (figure, out):
        axes = figure.subplots()
        for k, (_, before, after) in enumerate(rows):
            for shift, value, colour in ((-0.19, before, BEFORE), (0.19, after, AFTER)):
                axes.barh(k + shift, 1e3 * value, 0.34, color=colour)
                axes.annotate(f" {1e3 * value:.3f}", (1e3 * value, k + shift), va="center", fontsize=8)
        axes.axvline(1e3 * r.noise, color=NOISE, linewidth=1.4, linestyle="--")
        axes.annotate(
            f"noise {1e3 * r.noise:.3f}", (1e3 * r.noise, -0.62), color=NOISE, fontsize=8,
            xytext=(3, 0), textcoords="offset points",
        )  # fmt: skip
        axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
        axes.set(xlabel="root mean square of a coordinate [mm]", ylim=(len(rows) - 0.45, -0.8))
        axes.margins(x=0.12)
    return Picture(
        out[0],
        "Grey: the start model; blue: with what was added. Dashed: the noise, approach error included.",
    )


def draw_histograms(finding: Finding) -> Picture:
    """Residuals of every axis before and after."""
    first, last = (by_state(finding, s.residual) for s in (finding.steps[0], finding.steps[-1]))
    shown = [k for k in range(6) if np.isfinite(first[:, k]).any()]
    columns = min(len(shown), 3)
    lines = -(-len(shown) // columns)
    with _drawing("histograms", 9.0, 2.2 * lines) as (figure, out):
        grid = figure.subplots(lines, columns, squeeze=False).ravel()
        for axes, k in zip(grid, shown, strict=False):
            a, b = (1e3 * x[np.isfinite(x[:, k]), k] for x in (first, last))
            reach = max(np.abs(a).max(), np.abs(b).max(), 1e-9)
            bins = np.linspace(-reach, reach, 25)
            axes.hist(a, bins=bins, color=BEFORE, alpha=0.75, label="before")
            axes.hist(b, bins=bins, color=AFTER, alpha=0.75, label="after")
            unit = "mm" if k < 3 else "mrad"
            rms = [np.sqrt(np.mean(x**2)) for x in (a, b)]
            axes.set(xlabel=f"{COMPONENTS[k]} [{unit}]", title=f"RMS {rms[0]:.3f} → {rms[1]:.3f} {unit}")
        for axes in grid[len(shown) :]:
            axes.set_visible(False)
        grid[0].legend(fontsize=8)
    return Picture(out[0], "Residuals before (grey) and after (blue), all rows of an axis together.")


def draw_map(finding: Finding) -> Picture:
    """Pose × axis: root mean square of the residuals in units of the noise, before and after."""
    table = finding.table
    poses = np.unique(table.pose)
    shown = [k for k in range(6) if table.measured[:, k].any()]
    views = []
    for step in (finding.steps[0], finding.steps[-1]):
        z = standardised(finding, step.residual) ** 2
        views.append(np.array([[_root_mean(z[table.pose == p, k]) for p in poses] for k in shown]))
    if len(finding.steps) == 1:
        views = views[:1]
    top = float(np.clip(np.nanmax(views[0]), 3.0, 12.0))
    with _drawing("map", 9.0, 0.75 + len(views) * (0.45 + 0.2 * len(shown))) as (figure, out):
        grid = figure.subplots(len(views), 1, squeeze=False, sharex=True).ravel()
        for axes, view, title in zip(grid, views, ("before", "after"), strict=False):
            image = axes.imshow(view, aspect="auto", cmap="YlOrRd", vmin=0, vmax=top, interpolation="nearest")
            axes.set_yticks(range(len(shown)), [COMPONENTS[k] for k in shown])
            axes.set_title(title, loc="left")
        axes = grid[len(views) - 1]
        stride = max(1, -(-len(poses) // 30))
        labels = [table.labels[p] for p in poses]
        axes.set_xticks(range(0, len(poses), stride), labels[::stride], rotation=90, fontsize=7)
        axes.set_xlabel("pose")
        figure.colorbar(image, ax=list(grid), label="residual / noise", shrink=0.9)
    return Picture(
        out[0],
        "Root mean square of the residuals of a pose and axis in units of the noise (1: nothing but noise).",
    )


def _root_mean(z: Array) -> float:
    known = z[np.isfinite(z)]
    return float(np.sqrt(known.mean())) if len(known) else float("nan")


@dataclass(frozen=True, eq=False)
class _Points:
    """Deflections of one virtual joint by pose and load case: seen, and by the law."""

    joint: int
    name: str
    delta: Array
    deviation: Array
    tau: Array
    angles: Array
    law: Array
    branch: Array


def draw_law(finding: Finding, effect: Found) -> Picture | None:
    """Deflection of the effect's virtual joint that the data ask for, against load and angle, with its law.

    What the rest of the model explains is taken away: points are the residual after growth plus what the
    effect adds, projected back to the virtual joint.
    """
    values = {n: e.value for n, e in effect.parameters.items()}
    try:
        added = contribution(finding.assembly, effect.instance, values)
    except KeyError:
        return None
    theta = _theta(finding, effect.instance, values)
    if theta is None:
        return _draw_added(finding, effect, added)
    joint, law = theta
    points = _points(finding, joint, finding.steps[-1].residual + added, law)
    if points is None:
        return None
    caption = (
        f"{named(effect.effect, effect.where).capitalize()}: deflection of {points.name} that the data ask for "
        "(points, ± one standard deviation; the rest of the model taken away), and the fitted law (red)."
    )
    return Picture(_draw_points(finding, points, f"law {effect.effect} {effect.where}"), caption)


def draw_unnamed(finding: Finding) -> Picture | None:
    """Where nothing of the catalogue fits: back-projection at the accused virtual joint, best smooth law."""
    law, place = finding.last.law, finding.last.localisation
    problem = finding.assembly.problem
    if place is None:
        return None
    name = law.virtual_joint if law is not None else place.accused
    if name not in problem.virtual_joints:
        if not place.back_projections:
            return None
        name = place.back_projections[0].virtual_joint
    v = problem.virtual_joints.index(name)
    values = law.values if law is not None else np.full(problem.rows, np.nan)
    points = _points(finding, v, finding.steps[-1].residual, values)
    if points is None:
        return None
    caption = f"Deflection of {name} that would explain the residual"
    caption += "" if law is None else f", and the best smooth law (red): Δθ = {law.expression}"
    return Picture(_draw_points(finding, points, "unnamed"), caption + ".")


def _theta(finding: Finding, instance: EffectInstance, values: dict[str, float]) -> tuple[int, Array] | None:
    """The virtual joint that an effect moves most, and its deflection (M,) by the law."""
    view, problem = finding.assembly.situation.view, finding.assembly.problem
    best: tuple[float, int, Array] | None = None
    by_joint: dict[int, Array] = {}
    for term in instance.realise(view.robot).terms:
        if term.at.kind in ("link", "joint"):
            v = view.index[term.at]
            theta = values.get(term.parameter, 0.0) * view.factor(term.factor)
            by_joint[v] = by_joint.get(v, np.zeros(len(view.table))) + theta
    for v, theta in by_joint.items():
        law = theta[view.state]
        assert problem.J is not None
        size = float(np.linalg.norm(problem.J[:, v] * law))
        if best is None or size > best[0]:
            best = size, v, law
    return None if best is None or best[0] == 0 else (best[1], best[2])


def _points(finding: Finding, v: int, partial: Array, law: Array) -> _Points | None:
    problem = finding.assembly.problem
    noise = finding.last.noise
    scale = np.array([noise.by_axis.get(int(a), noise.sigma) or noise.sigma for a in problem.axis])
    seen = back_project(problem, partial / scale, scale, v)
    if seen is None or problem.q is None:
        return None
    cells = np.column_stack([seen.pose, seen.case])
    first = np.array([np.flatnonzero((problem.pose == p) & (problem.case == c))[0] for p, c in cells])
    good = np.isfinite(seen.deviation)
    tight = np.median(seen.deviation[good]) if good.any() else np.inf
    good &= seen.deviation < 6 * tight  # poses that hardly move with this joint say nothing of it
    branch = np.zeros(len(first)) if problem.branch is None else problem.branch[first]
    return _Points(
        v, problem.virtual_joints[v], seen.delta[good], seen.deviation[good], seen.tau[good],
        problem.q[first][good], law[first][good], branch[good],
    )  # fmt: skip


def _draw_points(finding: Finding, points: _Points, name: str) -> str:
    view = finding.assembly.situation.view
    joint = view.joints[points.joint]
    rotates = joint.rotational or (joint.kind == "joint" and not view.robot.joint[joint.body - 1].prismatic)
    unit, factor = ("mrad", 1e3) if rotates else ("µm", 1e6)
    moment = "N·m" if rotates else "N"
    number = joint.body if joint.kind == "joint" else min(max(joint.body, 1), view.robot.dof)
    turning = not view.robot.joint[number - 1].prismatic
    angle = np.degrees(points.angles[:, number - 1]) if turning else points.angles[:, number - 1]
    with _drawing(name, 9.0, 3.0) as (figure, out):
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, x, label in (
            (left, points.tau, f"load τ on {points.name} [{moment}]"),
            (right, angle, f"q{number} [{'°' if turning else 'm'}]"),
        ):
            axes.axhline(0, color="#bbb", linewidth=0.8)
            axes.errorbar(
                x, factor * points.delta, factor * points.deviation, fmt="o", ms=3.4, color=AFTER,
                ecolor="#b9cfd8", elinewidth=0.9, label="data",
            )  # fmt: skip
            order = np.argsort(x)
            axes.plot(x[order], factor * points.law[order], "_", color=LAW, ms=8, mew=1.6, label="fitted law")
            axes.set_xlabel(label)
        left.set_ylabel(f"Δθ of {points.name} [{unit}]")
        left.legend(fontsize=8)
    return out[0]


def _draw_added(finding: Finding, effect: Found, added: Array) -> Picture:
    """For effects that are no law of a virtual joint: what they add to every row, against what is there."""
    problem = finding.assembly.problem
    there = finding.steps[-1].residual + added
    with _drawing(f"added {effect.effect}", 9.0, 2.6) as (figure, out):
        grid = figure.subplots(1, 3, sharey=True)
        for axes, axis in zip(grid, range(3), strict=True):
            rows = problem.axis == axis
            axes.plot(1e3 * added[rows], 1e3 * there[rows], "o", ms=3.2, color=AFTER)
            if rows.any():
                ends = np.array([added[rows].min(), added[rows].max()]) * 1e3
                axes.plot(ends, ends, color=LAW, linewidth=1.4)
            axes.set(xlabel=f"added by the effect, {COMPONENTS[axis]} [mm]")
        grid[0].set_ylabel("asked for by the data [mm]")
    return Picture(
        out[0],
        f"{named(effect.effect, effect.where).capitalize()}: what it adds to a row, and what the data ask for "
        "there (the rest of the model taken away); red: equal.",
    )
