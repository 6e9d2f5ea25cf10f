"""Plans for reading: a line, and a table of a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.display import html_table

if TYPE_CHECKING:
    from symstiff.calibration.planning.choice import Plan


def plan_line(plan: Plan) -> str:
    """``kuka_kr270, criterion D: 15 poses for 26 parameters``."""
    return (
        f"{plan.robot}, criterion {plan.criterion}: {len(plan)} poses for {len(plan.parameters)} parameters"
    )


def plan_html(plan: Plan) -> str:
    """The deviations that the plan promises."""
    rows = [(name, f"{std:.2g}") for name, std in zip(plan.parameters, plan.std, strict=True)]
    note = f"as good as {plan.over_random:.2f} times as many random poses"
    return html_table(("parameter", "predicted ±, SI units"), rows, plan_line(plan), [note])
