"""A model as a table's rows show it, and back as it is told.

Deflections do not show offsets, geometry and links' weight: these are kept. Absolute positions show joints under
their whole load, the links' weight in it: laws that count it by themselves are fitted as laws of the whole load.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from symstiff.calibration.tables.measurements import Measurements
from symstiff.effects.arm import ASSUMED
from symstiff.effects.instance import EffectInstance
from symstiff.effects.places import named, place_name
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel
from symstiff.symbolic.terms import WRENCH, Term, tau

_EARLY = 0.1
"""Share of a drift's session by which readings may be earlier than its begin."""


def seen_in(model: StiffnessModel, kind: str) -> tuple[StiffnessModel, list[str]]:
    """The model without the effects that cancel in deflections, and a remark on them.

    Such an effect has no column to be fitted by: what rows say of it is second order, and would overwrite its values.
    Gears whose law bends do feel a link's weight: that is left out, with a remark on it. In absolute positions laws
    are those of the whole load.
    """
    if kind == "absolute":
        return model.with_effects([_counting(e, _within(e, model)) for e in model.effects]), []
    if kind != "deflection":
        return model, []
    unseen = [
        e for e, r in zip(model.effects, model.realisations, strict=True)
        if kind not in find(e.effect).seen_in or (r.terms and all(_stands(t) for t in r.terms))
    ]  # fmt: skip
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


def _stands(term: Term) -> bool:
    """Whether a law moves the arm by its angles alone, and so by as much with a load as without."""
    angles = all(s.name.startswith(("q_", "up_")) for s in term.factor.free_symbols)
    return angles and term.at.kind in ("joint", "link")


def on_the_clock(model: StiffnessModel, table: Measurements) -> tuple[StiffnessModel, list[str]]:
    """The model without the effects of a session that a table's clock does not share, and a remark on them.

    A drift's law holds for its session: before the begin its exponential is beyond all numbers, behind the end it tells
    nothing of another one.
    """
    if not np.isfinite(table.time).any():
        return model, []
    first, last = float(np.nanmin(table.time)), float(np.nanmax(table.time))
    other = []
    for effect, realised in zip(model.effects, model.realisations, strict=True):
        begin, span = realised.rest.get("time"), effect.spans.get("time", 0.0)
        if begin is not None and span > 0.0 and not begin - _EARLY * span <= first < begin + span:
            other.append((effect, begin, begin + span))
    if not other:
        return model, []
    remarks = [
        f"{named(effect.effect, effect.where)}: the start model's clock ran from {begin:.9g} to {end:.9g} s, that of "
        f"these data from {first:.9g} to {last:.9g} s: its law tells nothing of them and is left out of the model; "
        "symstiff diagnose looks for it anew"
        for effect, begin, end in other
    ]
    gone = [effect for effect, *_ in other]
    return model.with_effects([e for e in model.effects if e not in gone]), remarks


def _bends(term: Term) -> bool:
    """Whether a law is not linear in its load."""
    load = tau(term.at)
    return term.factor.has(load) and bool(term.factor.diff(load).has(load))


def _within(effect: EffectInstance, model: StiffnessModel) -> float:
    """The shape's entry ``weights`` of an effect in positions, where the load holds the links' weight."""
    return find(effect.effect).within if model.robot.has_weights else 0.0


def _counting(effect: EffectInstance, weights: float) -> EffectInstance:
    """The effect with a law that counts the links' weight by itself (1), or leaves it to the load (0, ``within``)."""
    default = find(effect.effect).weights
    if default is None or ASSUMED.keys() & effect.shape.keys():
        return effect
    shape = {key: value for key, value in effect.shape.items() if key != "weights"}
    return replace(effect, shape=shape if weights == default else {**shape, "weights": weights})


def of_table(model: StiffnessModel, table: Measurements) -> StiffnessModel:
    """The model with the ranges of joints, loads and moments that a table has."""
    columns = {f"q{j}": x for j, x in enumerate(table.q.T, start=1)} | dict(
        zip(WRENCH, table.w.T, strict=True)
    )
    columns |= {"time": table.time, "temperature": table.temperature}
    told = {name: x[np.isfinite(x)] for name, x in columns.items()}
    return model.with_seen({name: (float(x.min()), float(x.max())) for name, x in told.items() if len(x)})


def completed(model: StiffnessModel, told: StiffnessModel, kind: str) -> StiffnessModel:
    """A fitted model with the effects that the one told has beside, in its order, with the values from there.

    ``kind`` of the table: what absolute positions showed counts the masses of the robot file from here on.
    """
    shown = list(model.effects)
    if kind == "absolute" and model.robot.has_weights:
        shown = [_counting(e, 1.0) for e in shown]
    places = [(e.effect, e.where) for e in shown]
    missing = [e for e in told.effects if (e.effect, e.where) not in places]
    own = {p.name for p in told.with_effects(missing).effect_parameters} - set(model.parameters)
    values = dict(model.values) | {n: v for n, v in told.values.items() if n in own}
    deviations = dict(model.deviations) | {n: v for n, v in told.deviations.items() if n in own}
    named = [(e.effect, e.where) for e in told.effects]
    known = [
        shown[places.index(at)] if at in places else e for at, e in zip(named, told.effects, strict=True)
    ]
    new = [e for e, at in zip(shown, places, strict=True) if at not in named]
    return model.with_effects([*known, *new]).with_values(values, deviations)
