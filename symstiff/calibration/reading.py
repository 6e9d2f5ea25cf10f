"""Identified models for reading: a line, and a table of a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.display import html_table, unit_text

if TYPE_CHECKING:
    from symstiff.calibration.identify import Identification
    from symstiff.calibration.residuals import ResidualTable


def identification_line(result: Identification) -> str:
    """``kuka_kr270: 26 parameters, 2.702 to 0.031 mm rms``."""
    model = result.model
    left = _left(result.training)
    return f"{model.robot.name}: {len(model.parameters)} parameters{f', {left}' if left else ''}"


def identification_html(result: Identification) -> str:
    """The fitted parameters, what is left, and the remarks."""
    fit = result.fit
    rows = [
        (n, f"{v:.4g}", f"{s:.2g}", unit_text(u))
        for n, v, s, u in zip(fit.names, fit.values, fit.std, fit.units, strict=True)
    ]
    held_out = _left(result.validation) if result.validation is not None else ""
    caption = identification_line(result) + (f"; held-out poses {held_out}" if held_out else "")
    return html_table(("parameter", "value", "±", "unit"), rows, caption, result.remarks)


def _left(residuals: ResidualTable) -> str:
    """Residuals before and after the fit; of rotations where no position was measured."""
    for part, unit in (("positional", "mm"), ("rotational", "mrad")):
        if part in residuals.before:
            before, after = (1e3 * t[part].rms for t in (residuals.before, residuals.after))
            return f"{before:.3f} to {after:.3f} {unit} rms"
    return ""
