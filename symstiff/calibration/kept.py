"""What a start model holds and a table of deflections does not show: offsets, geometry, links' weight. It is kept."""

from __future__ import annotations

from symstiff.effects.base import find, place_name
from symstiff.model import StiffnessModel
from symstiff.symbolic.terms import Term, tau


def seen_in(model: StiffnessModel, kind: str) -> tuple[StiffnessModel, list[str]]:
    """The model without the effects that cancel in deflections, and a remark on them.

    Such an effect has no column to be fitted by: what rows say of it is second order, and would overwrite its values.
    Gears whose law bends do feel a link's weight: that is left out, with a remark on it.
    """
    if kind != "deflection":
        return model, []
    unseen = [e for e in model.effects if kind not in find(e.effect).seen_in]
    if not unseen:
        return model, []
    names = ", ".join(f"{e.effect.replace('_', ' ')} ({place_name(e.where)})" for e in unseen)
    shown = model.with_effects([e for e in model.effects if e not in unseen])
    remarks = [f"{names}: deflections do not show it, its values stay as the start model has them"]
    bent = sorted({t.at.name for t in shown.terms if _bends(t)})
    if bent and any(t.at.kind == "body" for e in unseen for t in e.realise(model.robot).terms):
        remarks.append(
            f"the law of {', '.join(bent)} bends under the links' weight too, and is fitted without the weight that "
            "the start model adds: put it into the robot file's masses and look for the law anew with symstiff diagnose"
        )
    return shown, remarks


def _bends(term: Term) -> bool:
    """Whether a law is not linear in its load."""
    load = tau(term.at)
    return term.factor.has(load) and bool(term.factor.diff(load).has(load))


def completed(model: StiffnessModel, told: StiffnessModel) -> StiffnessModel:
    """A fitted model with the effects that the one told has beside, in its order, with the values from there."""
    missing = [e for e in told.effects if e not in model.effects]
    if not missing:
        return model
    own = {p.name for p in told.with_effects(missing).effect_parameters} - set(model.parameters)
    values = dict(model.values) | {n: v for n, v in told.values.items() if n in own}
    deviations = dict(model.deviations) | {n: v for n, v in told.deviations.items() if n in own}
    found = [e for e in model.effects if e not in told.effects]
    return model.with_effects([*told.effects, *found]).with_values(values, deviations)
