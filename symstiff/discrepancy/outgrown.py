"""Effects of a start model that have outgrown the shape it gives them, as after a longer session or under larger loads.

A model fits the sizes of its effects to every table anew, not their shapes: those are of the data that it was made
from. What a shape leaves that no longer fits would pass for another effect.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from symstiff.arrays import Index
from symstiff.calibration.experiment.situation import View
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.bridge.growth import grow
from symstiff.discrepancy.bridge.ranges import at_size, extent_of
from symstiff.discrepancy.climb import squares_left
from symstiff.discrepancy.findings.result import Diagnosis
from symstiff.discrepancy.problem import Candidate, Parameter, key_of
from symstiff.discrepancy.search.verdict import AMBIGUOUS, NAMED
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.prepare import at_first, prepare
from symstiff.effects.base import Scales, Shape
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel

_ASKED = 5.0
"""Log evidence by which another shape has to lead the one that the model has."""
_LESS = 2.0
"""Log likelihood that other shapes have to gain over as many effects beside the old ones."""


def outgrown(
    model: StiffnessModel, table: Measurements, found: Sequence[EffectInstance]
) -> tuple[EffectInstance, ...]:
    """The effects of a model that a table asks for in another shape than the model has them in.

    They are asked beside the first few of the effects ``found`` too: what those explain would hide it, and the last of
    them may stand for it.
    """
    if not model.stiffness_parameters:
        return ()  # without its effects nothing of it is left
    beside = [grow(model, found[:n]) for n in range(len(found) + 1)]
    return tuple(e for e in model.effects if any(_asks(grown, e, table) for grown in beside))


def bare_of(model: StiffnessModel, effects: Iterable[EffectInstance]) -> StiffnessModel:
    """The model without some of its effects."""
    left = tuple(effects)
    return model.with_effects([e for e in model.effects if e not in left])


def accounts_better(
    anew: Diagnosis, found: Diagnosis, old: Iterable[EffectInstance], component: Index, readings: int
) -> bool:
    """Whether ``old`` effects in shapes ``anew`` account for the data better than what was ``found`` beside them did.

    Where both do, with fewer effects more, or with as many that leave less; component: (M,) 0 … 5 of each row.
    """
    keys = {key_of(e.effect, e.where) for e in old}
    named = {key_of(name.effect, name.where) for name, *_ in anew.leading}
    if anew.verdict not in (NAMED, AMBIGUOUS) or not keys <= named:
        return False
    if found.verdict not in (NAMED, AMBIGUOUS):
        return True
    more, before = len(named - keys), len(found.leading)
    if more != before:
        return more < before
    less, left = squares_left(anew, component, anew.growth[-1], found.growth[-1])
    return bool(0.5 * readings * np.log(left / less) > _LESS)


def _asks(model: StiffnessModel, instance: EffectInstance, table: Measurements) -> bool:
    effect = find(instance.effect)
    if effect.columns is not None or effect.shapes(model.robot, instance.where, Scales(table.kind)) == ({},):
        return False  # it has one shape
    bare = bare_of(model, [instance])
    noise = at_first(assemble(bare, table, effects=()).problem)
    assembly = assemble(bare, table, (effect,), noise)
    key = key_of(instance.effect, instance.where)
    candidate = next((c for c in assembly.candidates if c.key == key and not c.unavailable), None)
    if candidate is None or candidate.shapes == (dict(instance.shape),):
        return False
    ready = prepare(assembly.problem, (_with_own(candidate, instance, assembly.situation.view),))
    bank, entry = ready.scan.bank, evidence(ready.scan).entry
    if key not in bank.named:
        return False
    entries = range(*bank.entries_of(bank.named[key]).indices(len(entry)))
    # a shape of which these data hold nothing has no entry: it explains nothing
    own = next((entry[e] for e in entries if bank.shape_of(e) == dict(instance.shape)), 0.0)
    return float(max(entry[e] for e in entries) - own) > _ASKED


def _with_own(candidate: Candidate, instance: EffectInstance, view: View) -> Candidate:
    """A candidate with the shape that the model gives its effect among those of the catalogue."""
    shape: Shape = dict(instance.shape)
    if shape in candidate.shapes:
        return candidate
    own = tuple(
        Parameter(p.name, p.unit, p.low, p.high, p.typical)
        for p in at_size(instance.realise(view.robot).parameters, extent_of(view))
    )
    return replace(
        candidate,
        shapes=(*candidate.shapes, shape),
        weights=(*(candidate.weights or (1.0,) * len(candidate.shapes)), 1.0),
        parameters_of=lambda s: own if s == shape else candidate.parameters_at(s),
    )
