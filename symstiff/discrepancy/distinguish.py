"""Before any data: does an effect add columns that a class of experiments can tell from the model's?

The deflection of the grown model is evaluated at random points modulo a prime, once for every parameter
raised by one; the differences are the columns, exact for laws that are linear in their parameters.
Functions that no field knows (tanh, sign, …) are random oracles, so that a law that is no combination of
the model's counts as independent of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from symstiff.effects.base import Effect, EffectInstance, Scales, Shape, Where, catalogue, find
from symstiff.model import StiffnessModel
from symstiff.reduction.prime import PRIMES, PrimeAlgebra, echelon
from symstiff.reduction.structural import MEASURES, ExactEngine, Experiment
from symstiff.symbolic.program import evaluate
from symstiff.symbolic.programs import deflection_program
from symstiff.symbolic.terms import AXES, Term, link_joint


@dataclass(frozen=True)
class Distinction:
    """What a class of experiments can tell of an effect.

    ``gained``: independent columns that it adds to the model's; ``inside``: parameters whose own column is
    a combination of the model's; ``reason``: why nothing can be told, empty where something can.
    """

    parameters: tuple[str, ...]
    gained: int
    inside: tuple[str, ...]
    reason: str = ""

    @property
    def distinguishable(self) -> bool:
        """Whether anything of the effect stands out from the model."""
        return self.gained > 0


def survey(model: StiffnessModel, kind: str = "deflection") -> Iterator[tuple[Effect, Where, Distinction]]:
    """Every effect of the catalogue at every place of the model's robot that does not depend on the data."""
    for identifier, effect in catalogue().items():
        for where in effect.places(model.robot):
            yield effect, where, distinction(model, identifier, where, kind=kind)


def distinction(
    model: StiffnessModel,
    effect: str,
    where: Where,
    experiment: Experiment | None = None,
    kind: str = "deflection",
    shape: Shape | None = None,
) -> Distinction:
    """Tell structurally how an effect stands to a model.

    ``experiment`` defaults to the model's own class; ``shape`` to the effect's first. Effects whose columns
    come from the data themselves (outliers, second-order terms) count as distinguishable where they can be
    seen at all. Raises UserError for a place the robot does not have.
    """
    entry = find(effect)
    if shape is None:
        everything = Scales(kind, context={"time": 3600.0, "temperature": 10.0}, lowest={"temperature": 20.0})
        shape = next(iter(entry.shapes(model.robot, where, everything)), {})
    instance = EffectInstance(effect, where, shape)
    realised = instance.realise(model.robot)
    own = tuple(p.name for p in realised.parameters if p.name not in model.parameters)
    if kind not in entry.seen_in:
        return Distinction(own, 0, own, f"cannot be seen in {kind} data")
    if not own:
        return Distinction((), 0, (), "the model has all of its parameters")
    if entry.columns is not None:
        return Distinction(own, len(own), ())
    return _compared(model, instance, own, experiment or Experiment(model.loads, model.measure), kind)


def _compared(
    model: StiffnessModel, instance: EffectInstance, own: tuple[str, ...], experiment: Experiment, kind: str
) -> Distinction:
    grown = model.with_effect(instance)
    placement = _placement() if kind == "absolute" else ()
    terms = tuple(dict.fromkeys((*model.terms, *grown.terms, *placement)))
    known = tuple(dict.fromkeys((*model.parameters, *(t.parameter for t in placement))))
    columns = _columns(model, terms, (*known, *own), experiment, PRIMES[0])
    first = len(known)
    rank = len(echelon(columns[:, :first], PRIMES[0])[1])
    total = len(echelon(columns, PRIMES[0])[1])
    inside = tuple(
        n
        for k, n in enumerate(own)
        if len(echelon(columns[:, [*range(first), first + k]], PRIMES[0])[1]) == rank
    )
    reason = "" if total > rank else "its columns are combinations of the model's"
    if not columns[:, first:].any():
        reason = "no such load moves it"
    return Distinction(own, total - rank, inside, reason)


def _placement() -> tuple[Term, ...]:
    """The six numbers of the measuring device's placement, as small motions of the whole robot."""
    return tuple(Term(f"placement_{a}", link_joint(0, a), sp.S.One) for a in AXES)


def _columns(
    model: StiffnessModel, terms: tuple[Term, ...], names: tuple[str, ...], experiment: Experiment, prime: int
) -> np.ndarray:
    """Differences of the deflection for every parameter raised by one, modulo a prime."""
    program = deflection_program(model.chain, terms, names)
    engine = ExactEngine(model.chain, program, names, experiment)
    measured = MEASURES[experiment.measure]
    count = (5 * len(names)) // (4 * len(measured)) + 12
    algebra, rng = PrimeAlgebra(prime), np.random.default_rng([engine.seed, prime])
    inputs: dict[str, Any] = engine.points(algebra, rng, count)
    for vector in program.inputs:
        if vector.name == "context":
            inputs["context"] = [algebra.random(rng, count) for _ in vector.symbols]
    # an effect's own parameters start at zero; the compliances, on which loads' and frames' columns lean, do not
    base = {n: 1 + int.from_bytes(n.encode(), "big") % (prime - 1) for n in model.stiffness_parameters}

    def rows(values: Mapping[str, int]) -> np.ndarray:
        given = {**inputs, "p": [values.get(n, 0) for n in names]}
        flat = evaluate(program, given, algebra)["dt"]
        return np.concatenate([np.broadcast_to(flat[r], (count,)) for r in measured])

    start = rows(base)
    raised = [rows({**base, n: base.get(n, 0) + 1}) - start for n in names]
    return np.asarray(np.stack(raised, axis=1) % prime)
