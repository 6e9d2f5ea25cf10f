"""Pictures of residuals: histograms by axis before and after, errors by pose."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from symstiff.calibration.rows import predict
from symstiff.calibration.tables.measurements import COMPONENTS
from symstiff.discrepancy.findings.numbers import milli
from symstiff.report.plots import name_poses

if TYPE_CHECKING:
    from symstiff.calibration.identify import Identification
    from symstiff.calibration.tables.measurements import Measurements
    from symstiff.model import StiffnessModel


def draw_residuals(result: Identification) -> Any:
    """A matplotlib Figure: histograms of x, y, z residuals [mm] and the positional error of every pose."""
    from matplotlib.figure import Figure

    table = result.train
    before, residuals, first, last = _sizes(result)
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    axes = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.6))
    for k, name in enumerate(COMPONENTS[:3]):
        known = residuals[np.isfinite(residuals[:, k]), k]
        if known.size:
            axes[k].hist(known, bins=21, color="C0")
            axes[k].set_title(f"{name}: RMS {milli(1e-3 * float(np.sqrt((known**2).mean())))} mm", fontsize=9)
        axes[k].set_xlabel("residual [mm]")
        axes[k].yaxis.get_major_locator().set_params(integer=True)
    axes[0].set_ylabel("rows")
    for values, colour, label in ((before, "0.7", first), (residuals, "C0", last)):
        axes[3].semilogy(
            table.pose, np.linalg.norm(np.nan_to_num(values), axis=1), "o", color=colour, label=label
        )
    axes[3].set(xlabel="pose", ylabel="size of the translation [mm]")
    name_poses(axes[3], table.labels, np.unique(table.pose))
    figure.legend(*axes[3].get_legend_handles_labels(), fontsize=8, loc="outside upper right", ncols=2)
    return figure


def _sizes(result: Identification) -> tuple[Any, Any, str, str]:
    """Translations (M, 3) [mm] before and after, and what they are: of positions beside the rigid robot, placed."""
    if result.train.kind == "absolute":
        e = result.equations
        seen, left = (
            1e3 * e.spread(rows, len(result.train))[:, :3] for rows in (e.y, e.y - e.A @ result.fit.values)
        )
        return seen, left, "placed, rigid and uncalibrated", "geometry and compliances"
    values = 1e3 * result.train.values[:, :3]
    left = values - 1e3 * predict(result.model, result.train)[:, :3]
    return values, left, "deflection", "after compensation"


def draw_models(table: Measurements, models: Mapping[str, StiffnessModel]) -> Any:
    """A matplotlib Figure: positional error of every pose without compensation and with each model [mm]."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3.6), layout="constrained")
    axes = figure.subplots()
    poses = np.arange(1, len(table.labels) + 1)

    def by_pose(errors: np.ndarray) -> np.ndarray:
        size = np.linalg.norm(errors[:, :3], axis=1)
        return np.array([1e3 * np.sqrt((size[table.pose == k] ** 2).mean()) for k in range(len(poses))])

    axes.semilogy(poses, by_pose(table.values), "s-", color="0.6", label="no compensation", ms=4)
    styles = {"J1": ("C1", "o-"), "J2": ("C1", "o--"), "C1": ("C0", "o-"), "C2": ("C0", "o--")}
    for name, model in models.items():
        color, style = styles.get(name, ("C2", "o-"))
        label = f"{name}: {len(model.parameters)} parameters"
        axes.semilogy(
            poses, by_pose(table.values - predict(model, table)), style, color=color, label=label, ms=4
        )
    axes.set(xlabel="pose", ylabel="positional error [mm]", xticks=poses)
    axes.set_title("KR 270, 2.5 kN: what each model leaves of the deflection", fontsize=10)
    axes.grid(True, which="both", axis="y", alpha=0.25)
    figure.legend(fontsize=8, ncols=5, loc="outside lower center")
    return figure
