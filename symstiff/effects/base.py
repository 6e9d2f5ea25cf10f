"""The one shape of an effect: where it can be, and its law as terms at virtual joints.

A catalogue file defines one ``Effect``; a plugin registers one under the entry point group ``symstiff.effects``. No
module outside this room knows an effect by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module, metadata
from pkgutil import iter_modules
from typing import Any

from symstiff.errors import UserError
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term

Where = Mapping[str, Any]


@dataclass(frozen=True)
class EffectParameter:
    """A linear parameter of an effect: full name, SI unit, physically plausible range, typical size."""

    name: str
    unit: str
    low: float
    high: float
    typical: float


@dataclass(frozen=True)
class Realisation:
    """An effect at one place with its shape fixed: its parameters and terms.

    ``replaces`` names parameters that the effect's own stand for (a joint compliance that became several).
    """

    parameters: tuple[EffectParameter, ...]
    terms: tuple[Term, ...]
    replaces: tuple[str, ...] = ()


@dataclass(frozen=True)
class Effect:
    """An entry of the catalogue.

    places(robot) lists the ``where`` dictionaries; shapes(robot, where) the values of the shape parameters to profile
    (one empty dictionary where there are none); realise(robot, where, shape) the terms.
    seen_in: ``deflection``, ``absolute``; needs: context columns (``time``, ``temperature``, ``branch``, ``load_levels``).
    """

    identifier: str
    title: str
    description: str
    seen_in: frozenset[str]
    places: Callable[[Robot], tuple[Where, ...]]
    realise: Callable[[Robot, Where, Mapping[str, float]], Realisation]
    shapes: Callable[[Robot, Where], tuple[Mapping[str, float], ...]] = lambda robot, where: ({},)
    needs: frozenset[str] = frozenset()
    confused_with: tuple[str, ...] = ()
    separated_by: str = ""


@dataclass(frozen=True)
class EffectInstance:
    """An effect in a model: which, where, with which shape."""

    effect: str
    where: Where
    shape: Mapping[str, float] = field(default_factory=dict)

    def realise(self, robot: Robot) -> Realisation:
        """Its parameters and terms on a robot. Raises UserError for a place the robot does not have."""
        entry = find(self.effect)
        if not any(dict(place) == dict(self.where) for place in entry.places(robot)):
            if not _acceptable(entry, robot, self.where):
                raise UserError(f"{self.effect} cannot be at {dict(self.where)} on {robot.name}")
        return entry.realise(robot, self.where, self.shape)


def _acceptable(entry: Effect, robot: Robot, where: Where) -> bool:
    """A place with free lists (harmonics) is accepted where its other keys are."""
    listed = [set(place) for place in entry.places(robot)]
    return "harmonics" in where and any(set(where) == keys | {"harmonics"} or set(where) == keys for keys in listed)


@cache
def catalogue() -> dict[str, Effect]:
    """All effects by identifier: the files of this room, then plugins (entry points ``symstiff.effects``)."""
    package = import_module("symstiff.effects")
    found: dict[str, Effect] = {}
    for module in sorted(m.name for m in iter_modules(package.__path__)):
        effect = getattr(import_module(f"symstiff.effects.{module}"), "EFFECT", None)
        if isinstance(effect, Effect):
            found[effect.identifier] = effect
    for point in sorted(metadata.entry_points(group="symstiff.effects"), key=lambda p: p.name):
        effect = point.load()
        found[effect.identifier] = effect
    return found


def find(identifier: str) -> Effect:
    """An effect by its identifier. Raises UserError for an unknown one."""
    if identifier not in catalogue():
        raise UserError(f"unknown effect {identifier!r}: known are {', '.join(catalogue())}")
    return catalogue()[identifier]


def place_name(where: Where) -> str:
    """A place as part of a parameter's name: ``3``, ``4_5``, ``force_sensor``."""
    parts: list[str] = []
    for key, value in where.items():
        if key != "harmonics":
            parts += [str(v) for v in value] if isinstance(value, (list, tuple)) else [str(value)]
    return "_".join(parts)
