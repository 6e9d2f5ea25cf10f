"""Before any data: does an effect add columns that a class of experiments can tell from the model's?

The deflection of the grown model is evaluated at random points modulo a prime, once for every parameter
raised by one; the differences are the columns, exact for laws that are linear in their parameters.
Functions that no field knows (tanh, sign, …) are random oracles, so that a law that is no combination of
the model's counts as independent of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from symstiff.effects.base import Effect, Scales, Where
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import catalogue, find
from symstiff.model import StiffnessModel
from symstiff.reduction.circle import prime_with_roots
from symstiff.reduction.prime import PrimeAlgebra, echelon
from symstiff.reduction.reduce import standing_still
from symstiff.reduction.structural import MEASURES, ExactEngine, Experiment
from symstiff.symbolic.program import evaluate
from symstiff.symbolic.programs import deflection_program
from symstiff.symbolic.terms import AXES, Term, link_joint

_SEED = 1
_MOST = 40
"""Parameters of one effect for which there are points enough."""


@dataclass(frozen=True)
class Distinction:
    """What a class of experiments can tell of an effect.

    ``parameters``: those that the model does not have; ``gained``: independent columns that they add to the model's;
    ``inside``: parameters whose own column is a combination of the model's; ``reason``: why nothing can be told, empty
    where something can; ``held``: the effect's parameters that the model has.
    """

    parameters: tuple[str, ...]
    gained: int
    inside: tuple[str, ...]
    reason: str = ""
    held: tuple[str, ...] = ()

    @property
    def distinguishable(self) -> bool:
        """Whether anything of the effect stands out from the model."""
        return self.gained > 0


def survey(model: StiffnessModel, kind: str = "deflection") -> Iterator[tuple[Effect, Where, Distinction]]:
    """Every effect of the catalogue at every place of the model's robot that does not depend on the data."""
    known = _Known.of(model, kind)
    for identifier, effect in catalogue().items():
        for where in effect.places(model.robot):
            yield effect, where, _distinction(known, identifier, where, kind)


def distinction(model: StiffnessModel, effect: str, where: Where, kind: str = "deflection") -> Distinction:
    """Tell structurally how an effect, in its first shape, stands to a model for the model's class of experiments.

    Effects whose columns come from the data themselves (outliers, second-order terms) count as distinguishable where
    they can be seen at all. Raises UserError for a place the robot does not have.
    """
    return _distinction(_Known.of(model, kind), effect, where, kind)


def _distinction(known: _Known, effect: str, where: Where, kind: str) -> Distinction:
    entry, model = find(effect), known.model
    context = {"time": 3600.0, "temperature": 10.0}
    everything = Scales(kind, context=context, lowest={"temperature": 20.0}, unloaded=0.5)
    shape = next(iter(entry.shapes(model.robot, where, everything)), {})
    instance = EffectInstance(effect, where, shape)
    realised = instance.realise(model.robot)
    own = tuple(p.name for p in realised.parameters if p.name not in model.parameters)
    held = tuple(p.name for p in realised.parameters if p.name in model.parameters)
    if kind not in entry.seen_in:
        return Distinction(own, 0, own, f"cannot be seen in {kind} data", held)
    if not own:
        return Distinction((), 0, (), "the model has all of its parameters", held)
    if entry.columns is not None:
        return Distinction(own, len(own), (), held=held)
    columns = known.beside(instance, own)
    total = len(echelon(np.hstack([known.columns, columns]), known.algebra.p)[1])
    inside = tuple(
        n
        for k, n in enumerate(own)
        if len(echelon(np.hstack([known.columns, columns[:, [k]]]), known.algebra.p)[1]) == known.rank
    )
    of_loads = any(t.at.kind in ("load", "body") for t in realised.terms)
    reason = "" if total > known.rank else _reason(bool(columns.any()), bool(held), of_loads)
    return Distinction(own, total - known.rank, inside, reason, held)


def _reason(moved: bool, held: bool, of_loads: bool) -> str:
    """Why the parameters that the model does not have add nothing, and that it has the others where it does."""
    if (
        of_loads and not moved
    ):  # the robot itself may give way there: compliances that such loads do not show are not kept
        return "the model, reduced for such loads, has no compliance in the directions that it adds"
    if held:
        rest = (
            "the columns of the rest are combinations of its own" if moved else "no such load moves the rest"
        )
        return f"the model has the others, and {rest}"
    return "its columns are combinations of the model's" if moved else "no such load moves it"


@dataclass(frozen=True, eq=False)
class _Known:
    """A model at random points of a class of experiments modulo a prime, and the columns that it has there."""

    model: StiffnessModel
    experiment: Experiment
    terms: tuple[Term, ...]
    names: tuple[str, ...]
    algebra: PrimeAlgebra
    count: int
    points: Mapping[str, Any]

    @classmethod
    def of(cls, model: StiffnessModel, kind: str) -> _Known:
        """In absolute data the placement of the measuring device is among what is known."""
        experiment = Experiment(model.loads, model.measure, standing_still(model.robot, model.fixed))
        terms = tuple(dict.fromkeys((*model.terms, *(_placement() if kind == "absolute" else ()))))
        engine = ExactEngine(model.chain, deflection_program(model.chain, (), ()), (), experiment)
        prime = prime_with_roots(engine.order, model.chain.squares())
        algebra, rng = engine.algebra(prime), np.random.default_rng([_SEED, prime])
        names = tuple(dict.fromkeys((*model.parameters, *(t.parameter for t in terms))))
        count = 5 * (len(names) + _MOST) // (4 * len(MEASURES[experiment.measure])) + 12
        return cls(model, experiment, terms, names, algebra, count, engine.points(algebra, rng, count))

    @cached_property
    def columns(self) -> np.ndarray:
        """(rows, names) modulo the prime."""
        return self._raised(self.terms, self.names, self.names)

    @cached_property
    def rank(self) -> int:
        """Number of independent columns."""
        return len(echelon(self.columns, self.algebra.p)[1])

    def beside(self, instance: EffectInstance, own: tuple[str, ...]) -> np.ndarray:
        """(rows, own) columns of an effect's parameters beside what is known."""
        terms = tuple(dict.fromkeys((*self.terms, *instance.realise(self.model.robot).terms)))
        return self._raised(terms, (*self.names, *own), own)

    def _raised(self, terms: tuple[Term, ...], names: tuple[str, ...], raised: Sequence[str]) -> np.ndarray:
        """Differences of the deflection for each of the parameters ``raised`` by one."""
        program = deflection_program(self.model.chain, terms, names)
        measured = MEASURES[self.experiment.measure]
        inputs = dict(self.points)
        for vector in program.inputs:
            if vector.name == "context":
                inputs["context"] = [self._moment(str(symbol)) for symbol in vector.symbols]
        # an effect's own parameters start at zero; the compliances, on which loads' and frames' columns lean, do not
        prime = self.algebra.p
        base = {
            n: 1 + int.from_bytes(n.encode(), "big") % (prime - 1) for n in self.model.stiffness_parameters
        }

        def rows(values: Mapping[str, int]) -> np.ndarray:
            flat = evaluate(program, {**inputs, "p": [values.get(n, 0) for n in names]}, self.algebra)["dt"]
            return np.concatenate([np.broadcast_to(flat[r], (self.count,)) for r in measured])

        start = rows(base)
        return np.asarray(
            np.stack([rows({**base, n: base.get(n, 0) + 1}) - start for n in raised], axis=1) % prime
        )

    def _moment(self, name: str) -> Any:
        """Time, temperature, branch or turn at the points, the same in every program."""
        return self.algebra.random(np.random.default_rng([_SEED, *name.encode()]), self.count)


def _placement() -> tuple[Term, ...]:
    """The six numbers of the measuring device's placement, as small motions of the whole robot."""
    return tuple(Term(f"placement_{a}", link_joint(0, a), sp.S.One) for a in AXES)
