"""Pictures of a diagnosis as SVG text that stands in an HTML page without any outside resource."""

from __future__ import annotations

import io
import re
import unicodedata
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.arrays import Array, Index
from symstiff.calibration.tables.measurements import COMPONENTS
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.numbers import decimals_between, milli
from symstiff.report import sizes
from symstiff.report.tables import by_state, standardised

BEFORE, AFTER, NOISE, LAW = "#9aa7b4", "#1f6f8b", "#8f6a09", "#c0392b"
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
_LABELS = 30
"""Poses up to which each has its label."""
_LABEL, _LETTER, _USUAL = 14, 0.06, 3
"""Letters of a pose's label under a map, the height [in] of each, which stands upright, and those that any map has."""


@dataclass(frozen=True)
class Picture:
    """A picture with its caption."""

    svg: str
    caption: str


@contextmanager
def drawing(name: str, width: float, height: float) -> Iterator[tuple[Any, list[str]]]:
    """A figure; its SVG text is appended to the list when all is drawn."""
    import matplotlib
    from matplotlib.figure import Figure

    out: list[str] = []
    with (
        matplotlib.rc_context({**_STYLE, "svg.hashsalt": f"symstiff {name}"}),
        warnings.catch_warnings(),
    ):
        warnings.filterwarnings("ignore", "Glyph .* missing")  # the reader's browser writes the text
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure, out
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    out.append(inline(buffer.getvalue(), re.sub(r"\W+", "-", name)))


def inline(svg: str, name: str) -> str:
    """SVG for the body of an HTML page: no prologue, no metadata, no name spaces (HTML knows them), ids of its own."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    svg = re.sub(r'(href="|url\()#', rf"\1#{name}-", svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.S)
    return re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg)


def draw_gap(finding: Finding) -> Picture:
    """Root mean squares before and after, on the poses used and on held-out ones, against the noise."""
    r = finding.rms
    grown = len(finding.steps) > 1
    rows = [("all poses", r.before, r.after)]
    if r.held_out_before is not None and r.held_out_after is not None:
        rows.append(("held-out poses", r.held_out_before, r.held_out_after))
    with drawing("gap", 7.2, 0.75 + 0.62 * len(rows)) as (figure, out):
        axes = figure.subplots()
        for k, (_, before, after) in enumerate(rows):
            decimals = decimals_between(before, after) if grown else None
            bars = ((-0.19, before, BEFORE), (0.19, after, AFTER)) if grown else ((0.0, before, BEFORE),)
            for shift, value, colour in bars:
                axes.barh(k + shift, 1e3 * value, 0.34, color=colour)
                right = max(value, r.noise) if 0.8 * r.noise < value < 1.15 * r.noise else value
                axes.annotate(
                    sizes.size(value, finding, decimals), (1e3 * right, k + shift), va="center", fontsize=8,
                    xytext=(4, 0), textcoords="offset points",
                )  # fmt: skip
        axes.axvline(1e3 * r.noise, color=NOISE, linewidth=1.4, linestyle="--")
        noise = sizes.size(r.noise, finding, decimals_between(r.before, r.after))
        axes.annotate(
            f"noise {noise}", (1e3 * r.noise, -0.62), color=NOISE, fontsize=8,
            xytext=(3, 0), textcoords="offset points",
        )  # fmt: skip
        axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
        axes.set(
            xlabel=f"root mean square of a coordinate [{sizes.unit(finding)}]", ylim=(len(rows) - 0.45, -0.8)
        )
        axes.margins(x=0.16)
    who = "Grey: the start model; blue: with what was added." if grown else "Bars: the start model."
    shares = ", what a pose's rows share included" if sizes.shares(finding) else ""
    return Picture(out[0], f"{who} Dashed: the noise{shares}.")


def draw_histograms(finding: Finding) -> Picture:
    """Residuals of every axis before and after."""
    grown = len(finding.steps) > 1
    first, last = (by_state(finding, s.residual) for s in (finding.steps[0], finding.steps[-1]))
    shown = [k for k in range(6) if np.isfinite(first[:, k]).any()]
    columns = min(len(shown), 3)
    lines = -(-len(shown) // columns)
    with drawing("histograms", 9.0, 2.2 * lines) as (figure, out):
        grid = figure.subplots(lines, columns, squeeze=False).ravel()
        for axes, k in zip(grid, shown, strict=False):
            a, b = (1e3 * x[np.isfinite(x[:, k]), k] for x in (first, last))
            reach = max(np.abs(a).max(), np.abs(b).max(), 1e-9)
            bins = np.linspace(-reach, reach, 25)
            axes.hist(a, bins=bins, color=BEFORE, alpha=0.75, label="before")
            if grown:
                axes.hist(b, bins=bins, color=AFTER, alpha=0.75, label="after")
            unit = "mm" if k < 3 else "mrad"
            rms = [np.sqrt(np.mean(x**2)) for x in (a, b)]
            change = f" → {milli(1e-3 * rms[1])}" if grown else ""
            axes.set(xlabel=f"{COMPONENTS[k]} [{unit}]", title=f"RMS {milli(1e-3 * rms[0])}{change} {unit}")
            axes.locator_params(axis="x", nbins=5)
            axes.yaxis.get_major_locator().set_params(integer=True)
        for axes in grid[len(shown) :]:
            axes.set_visible(False)
        if grown:
            grid[0].legend(fontsize=8)
        grid[0].set_ylabel("rows")
    which = "Residuals before (grey) and after (blue)" if grown else "Residuals of the start model"
    return Picture(out[0], f"{which}, all rows of an axis together.")


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
    longest = _letters([_short(table.labels[p]) for p in poses])
    height = 0.75 + len(views) * (0.45 + 0.2 * len(shown)) + _LETTER * max(longest - _USUAL, 0)
    with drawing("map", min(9.0, 2.2 + 0.45 * len(poses)), height) as (figure, out):
        grid = figure.subplots(len(views), 1, squeeze=False, sharex=True).ravel()
        for axes, view, title in zip(grid, views, ("before", "after"), strict=False):
            image = axes.imshow(view, aspect="auto", cmap="YlOrRd", vmin=0, vmax=top, interpolation="nearest")
            axes.set_yticks(range(len(shown)), [COMPONENTS[k] for k in shown])
            if len(views) > 1:
                axes.set_title(title, loc="left")
        axes = grid[len(views) - 1]
        name_poses(axes, [table.labels[p] for p in poses], np.arange(len(poses)))
        axes.set_xlabel("pose")
        figure.colorbar(image, ax=list(grid), label="residual / noise", shrink=0.9)
    return Picture(
        out[0],
        "Root mean square of the residuals of a pose and axis in units of the noise (1: nothing but noise); "
        f"the darkest colour stands for {top:.2g} and more.",
    )


def _root_mean(z: Array) -> float:
    known = z[np.isfinite(z)]
    return float(np.sqrt(known.mean())) if len(known) else float("nan")


def name_poses(axes: Any, labels: Sequence[str], places: Index) -> None:
    """The labels of poses below an axis, at their places on it; of many some."""
    some = places[:: max(1, -(-len(places) // _LABELS))]
    # a pose may be called $5 or x_1$: no formula
    axes.set_xticks(some, [_short(labels[p]) for p in some], rotation=90, fontsize=7, parse_math=False)


def _short(label: str) -> str:
    """A long label by its begin and its end, where numbers stand."""
    half = _LABEL // 2
    return label if len(label) <= _LABEL else f"{label[: half - 1]}…{label[-half:]}"


def _letters(labels: Sequence[str]) -> int:
    """Letters of the longest label; those of wide scripts count twice."""
    return max(sum(1 + (unicodedata.east_asian_width(c) in "WF") for c in label) for label in labels)
