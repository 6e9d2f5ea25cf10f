"""A model for reading: its parameters with values, units and meanings, as the table of a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.display import html_table, unit_text

if TYPE_CHECKING:
    from symstiff.model import StiffnessModel


def model_html(model: StiffnessModel) -> str:
    """One row a parameter."""
    meanings = {p.name: p.meaning for p in model.compliances}
    meanings |= {p.name: p.meaning for p in model.effect_parameters}
    known = model.known
    rows = [
        (
            n,
            f"{known[n]:.4g}",
            f"{model.deviations[n]:.2g}" if n in model.deviations else "–",
            unit_text(model.units[n]),
            meanings[n] or "effect",
        )
        for n in model.parameters
    ]
    title = model.robot.title or model.robot.name
    caption = f"{title}: {len(rows)} parameters, loads {model.loads}, measured {model.measure}"
    return html_table(("parameter", "value", "±", "unit", "meaning"), rows, caption)
