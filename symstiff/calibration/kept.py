"""What a start model holds and a table of deflections does not show: offsets, geometry, links' weight. It is kept."""

from __future__ import annotations

from symstiff.effects.base import find, place_name
from symstiff.model import StiffnessModel


def seen_in(model: StiffnessModel, kind: str) -> tuple[StiffnessModel, list[str]]:
    """The model without the effects that cancel in deflections, and a remark on them.

    Such an effect has no column to be fitted by: what rows say of it is second order, and would overwrite its values.
    """
    if kind != "deflection":
        return model, []
    unseen = [e for e in model.effects if kind not in find(e.effect).seen_in]
    if not unseen:
        return model, []
    names = ", ".join(f"{e.effect.replace('_', ' ')} ({place_name(e.where)})" for e in unseen)
    return model.with_effects([e for e in model.effects if e not in unseen]), [
        f"{names}: deflections do not show it, its values stay as the start model has them"
    ]


def completed(model: StiffnessModel, told: StiffnessModel) -> StiffnessModel:
    """A fitted model with the effects that the one told has beside, and the values that they have there."""
    missing = [e for e in told.effects if e not in model.effects]
    if not missing:
        return model
    whole = told.with_effects(missing)
    own = {p.name for p in whole.effect_parameters} - set(model.parameters)
    values = dict(model.values) | {n: v for n, v in told.values.items() if n in own}
    deviations = dict(model.deviations) | {n: v for n, v in told.deviations.items() if n in own}
    for effect in missing:
        model = model.with_effect(effect)
    return model.with_values(values, deviations)
