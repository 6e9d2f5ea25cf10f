"""A model for reading: its parameters with values, units and meanings, and its laws, as a notebook shows them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.display import html_table, listing, unit_text
from symstiff.effects.places import named
from symstiff.symbolic.passes import context_vector
from symstiff.symbolic.reading import laws_latex

if TYPE_CHECKING:
    from symstiff.model import StiffnessModel


def model_html(model: StiffnessModel) -> str:
    """One row a parameter; below what each effect's shape means, and what the laws ask of the moment."""
    meanings = {p.name: p.meaning for p in model.compliances}
    meanings |= _of_effects(model)
    known = model.known
    rows = [
        (
            n,
            f"{known[n]:.4g}",
            f"{model.deviations[n]:.2g}" if n in model.deviations else "–",
            unit_text(model.units[n]),
            meanings[n],
        )
        for n in model.parameters
    ]
    title = model.robot.title or model.robot.name
    caption = f"{title}: {len(rows)} parameters, loads {model.loads}, measured {model.measure}"
    shapes = [
        f"{named(e.effect, e.where)}: {'; '.join(phrases)}"
        for e in model.effects
        if (phrases := e.shape_phrases(model.robot))
    ]
    asked = [s.name for vector in context_vector(model.terms) for s in vector.symbols]
    moment = [f"needs {listing(asked)} of every row (context)"] if asked else []
    return html_table(("parameter", "value", "±", "unit", "meaning"), rows, caption, [*shapes, *moment])


def model_latex(model: StiffnessModel) -> str:
    """The laws, one line a virtual joint; effects that have none, as a deflection of second order, by their names."""
    lawless = [
        named(e.effect, e.where)
        for e, realised in zip(model.effects, model.realisations, strict=True)
        if not realised.terms
    ]
    return laws_latex(model.terms, lawless)


def _of_effects(model: StiffnessModel) -> dict[str, str]:
    """What effects' parameters mean; where an effect says nothing more of one, that it is of the effect."""
    return {
        p.name: f"{named(e.effect, e.where)}{f': {p.meaning}' if p.meaning else ''}"
        for e, realised in zip(model.effects, model.realisations, strict=True)
        for p in realised.parameters
    }
