"""Effects of known size, such as a large deflection: taken off the readings before a fit, which has no column of them.

What they add follows from the compliances, which settle with them first, as in a diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.experiment.current import settled, under_effects
from symstiff.calibration.experiment.situation import Laws, Situation, look
from symstiff.calibration.tables.measurements import Measurements
from symstiff.effects.instance import EffectInstance
from symstiff.effects.places import named
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel
from symstiff.robot.schema import Robot


def of_known_size(model: StiffnessModel) -> tuple[EffectInstance, ...]:
    """The effects whose size is known, and which are no law at a virtual joint."""
    realised = zip(model.effects, model.realisations, strict=True)
    return tuple(e for e, r in realised if r.nominal and not r.terms)


def added_by(effects: Sequence[EffectInstance], model: StiffnessModel, table: Measurements) -> Array:
    """(N, 6) what effects of known size add to a table's deflections [m, rad], by the values of a model without them.

    NaN where nothing is measured.
    """
    plain = look(model.robot, table)
    laws = Laws(plain, model.terms, model.values)
    view = under_effects(plain, laws)
    situation = Situation(view, laws)
    added = np.where(table.measured, 0.0, np.nan)
    for effect in effects:
        columns, realised = find(effect.effect).columns, effect.realise(model.robot)
        if columns is not None:
            size = [realised.nominal[p.name] for p in realised.parameters]
            added[view.state, view.component] += columns(situation, effect.where, effect.shape) @ size
    return added


def fitted_beside(
    effects: Sequence[EffectInstance], model: StiffnessModel, table: Measurements
) -> StiffnessModel:
    """A model without effects of known size, with the values that a table gives it beside them."""
    fitted = settled(model.with_effects((*model.effects, *effects)), table).fitted
    return model.with_values({n: fitted.get(n, model.values.get(n, 0.0)) for n in model.parameters})


def without(effects: Sequence[EffectInstance], model: StiffnessModel, table: Measurements) -> Measurements:
    """The table less what effects of known size add by a model's values."""
    return replace(table, values=table.values - added_by(effects, model, table))


def with_known(model: StiffnessModel, start: StiffnessModel) -> StiffnessModel:
    """The model with the effects of known size of a start model, in its order, and with their sizes."""
    counted = of_known_size(start)
    if not counted:
        return model
    effects = list(model.effects)
    for place, effect in enumerate(start.effects):
        if effect in counted:
            effects.insert(place, effect)
    sizes = {n: size for e in counted for n, size in e.realise(model.robot).nominal.items()}
    return model.with_effects(effects).with_values({**model.values, **sizes}, model.deviations)


def left_out_of(counted: Sequence[EffectInstance]) -> list[str]:
    """A remark on effects of known size beside geometry that is fitted."""
    if not counted:
        return []
    names = ", ".join(named(e.effect, e.where) for e in counted)
    return [f"{names}: has no size to fit and no code of its own: left out here, symstiff diagnose counts it"]


def removed_of(
    counted: Sequence[EffectInstance], robot: Robot, before: Measurements, after: Measurements
) -> list[str]:
    """A remark on what was taken off the readings, and those on what was taken for granted."""
    turned = not before.measured[:, :3].any()
    gone = (
        np.abs(before.values - after.values)[:, 3:] if turned else np.abs(before.values - after.values)[:, :3]
    )
    most = f"{1e3 * float(np.nanmax(gone, initial=0.0)):.3f} {'mrad' if turned else 'mm'}"
    names = ", ".join(named(e.effect, e.where) for e in counted)
    told = (
        f"{names}: has a known size, which was taken off the readings (up to {most}) before the fit: the residuals are "
        "of the rest, and so is what code computes; the model keeps it"
    )
    granted = (f"{named(e.effect, e.where)}: {text}" for e in counted for text in e.assumptions(robot))
    return [told, *granted]
