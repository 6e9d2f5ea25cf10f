"""Pictures of residuals: histograms by axis before and after, errors by pose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from symstiff.calibration.rows import predict

if TYPE_CHECKING:
    from symstiff.calibration.identify import Identification

AXES = ("x", "y", "z")


def draw_residuals(result: Identification) -> Any:
    """A matplotlib Figure: histograms of x, y, z residuals [mm] and the positional error of every pose."""
    from matplotlib.figure import Figure

    table = result.train
    residuals = 1e3 * (table.values - predict(result.model, table))[:, :3]
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    axes = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.6))
    for k, name in enumerate(AXES):
        known = residuals[np.isfinite(residuals[:, k]), k]
        if known.size:
            axes[k].hist(known, bins=21, color="C0")
            axes[k].set_title(f"{name}: RMS {np.sqrt((known**2).mean()):.3f} mm", fontsize=9)
        axes[k].set_xlabel("residual [mm]")
    before = 1e3 * np.linalg.norm(np.nan_to_num(table.values[:, :3]), axis=1)
    after = np.linalg.norm(np.nan_to_num(residuals), axis=1)
    axes[3].semilogy(table.pose, before, "o", color="0.7", label="deflection")
    axes[3].semilogy(table.pose, after, "o", color="C0", label="after compensation")
    axes[3].set(xlabel="pose", ylabel="positional [mm]")
    axes[3].legend(fontsize=8)
    return figure
