"""Tables, identified models and plans for reading: a line each, and a table of a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.display import html_table

if TYPE_CHECKING:
    from symstiff.calibration.identify import Identification
    from symstiff.calibration.measurements import Measurements
    from symstiff.calibration.planning import Plan
    from symstiff.calibration.residuals import ResidualTable

_ROWS = 8
"""Rows of a long table that are shown."""


def measurements_line(table: Measurements) -> str:
    """``deflection: 45 rows, 15 poses, 6 joints, points p1 p2 p3``."""
    poses = len(set(table.pose.tolist()))
    points = f", points {' '.join(table.points)}" if table.points != ("tcp",) else ""
    kind = "poses and loads" if table.kind == "none" else table.kind
    return f"{kind}: {len(table)} rows, {poses} poses, {table.dof} joints{points}"


def measurements_html(table: Measurements) -> str:
    """The first rows as their file has them."""
    from symstiff.calibration.writing import columns

    found = columns(table.select(slice(_ROWS)))
    shown = [
        [cell if isinstance(cell, str) else round(float(cell), 6) for cell in row]
        for row in zip(*found.values(), strict=True)
    ]
    more = len(table) - len(shown)
    return html_table(list(found), shown, measurements_line(table), f"and {more} more" if more else "")


def identification_line(result: Identification) -> str:
    """``kuka_kr270: 26 parameters, 2.702 to 0.031 mm rms``."""
    model = result.model
    left = _left(result.training)
    return f"{model.robot.name}: {len(model.parameters)} parameters{f', {left}' if left else ''}"


def identification_html(result: Identification) -> str:
    """The fitted parameters, what is left, and the remarks."""
    fit = result.fit
    rows = [
        (n, f"{v:.4g}", f"{s:.1g}", u)
        for n, v, s, u in zip(fit.names, fit.values, fit.std, fit.units, strict=True)
    ]
    held_out = _left(result.validation) if result.validation is not None else ""
    caption = identification_line(result) + (f"; held-out poses {held_out}" if held_out else "")
    return html_table(("parameter", "value", "±", "unit"), rows, caption, "; ".join(result.remarks))


def _left(residuals: ResidualTable) -> str:
    """Residuals before and after the fit; of rotations where no position was measured."""
    for part, unit in (("positional", "mm"), ("rotational", "mrad")):
        if part in residuals.before:
            before, after = (1e3 * t[part].rms for t in (residuals.before, residuals.after))
            return f"{before:.3f} to {after:.3f} {unit} rms"
    return ""


def plan_line(plan: Plan) -> str:
    """``kuka_kr270, criterion D: 15 poses for 26 parameters``."""
    return (
        f"{plan.robot}, criterion {plan.criterion}: {len(plan)} poses for {len(plan.parameters)} parameters"
    )


def plan_html(plan: Plan) -> str:
    """The deviations that the plan promises."""
    rows = [(name, f"{std:.2g}") for name, std in zip(plan.parameters, plan.std, strict=True)]
    note = f"as good as {plan.over_random:.2f} times as many random poses"
    return html_table(("parameter", "predicted ±, SI units"), rows, plan_line(plan), note)
