"""An effect in a model: one of the catalogue at a place, with its shape fixed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from symstiff.arguments import require
from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.lawful import check_realised
from symstiff.effects.places import plain, site
from symstiff.effects.registry import find
from symstiff.errors import UserError
from symstiff.robot.frozen import FrozenDict, FrozenList, frozen_numbers
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term

_FAR = 1e12
"""Size of a shape's value, in SI units, that nobody means."""
_DIGITS, _CLOCK = 4, 1e4
"""Digits of a shape's value as told, and from where on it gets all of them, as the time of a clock does."""


@dataclass(frozen=True)
class EffectInstance:
    """An effect in a model: which, where, with which shape.

    ``EffectInstance("backlash", {"joint": 2}, {"width": 5.0})`` is one. ``symstiff effects ROBOT`` lists identifiers
    and places; what a shape leaves out is as the effect usually is.
    """

    effect: str
    where: Where
    shape: Shape = field(default_factory=dict)

    def __post_init__(self) -> None:
        require(self.effect, str, "an effect's identifier", "'backlash' is one")
        require(self.where, Mapping, f"where {self.effect} is", "{'joint': 2} is a place")
        where = {k: FrozenList(v) if isinstance(v, list) else v for k, v in plain(self.where).items()}
        object.__setattr__(self, "where", FrozenDict(where))
        shape = frozen_numbers(self.shape, f"shape of {self.effect}")
        for key, value in shape.items():
            if value and not 1.0 / _FAR <= abs(value) <= _FAR:
                raise UserError(
                    f"{self.effect}: {key} = {value:g}: give a size from {1.0 / _FAR:g} to {_FAR:g}, or 0"
                )
        object.__setattr__(self, "shape", shape)

    def realise(self, robot: Robot) -> Realisation:
        """Its parameters and terms on a robot. Raises UserError for a place the robot does not have."""
        entry = find(self.effect)
        if entry.places_in is None and not _acceptable(entry, robot, self.where):
            raise UserError(f"{self.effect} cannot be at {dict(self.where)} on {robot.name}")
        try:
            found = entry.realise(robot, self.where, self.shape)
            check_realised(found, robot)
            return found
        except UserError as error:
            raise UserError(f"{self.effect} at {dict(self.where)}: {error}") from error
        except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
            raise UserError(
                f"{self.effect} at {dict(self.where)}: the shape {dict(self.shape)} does not fit: {error}"
            ) from error

    @property
    def spans(self) -> Shape:
        """The part of the shape that the sizes are counted over."""
        return {key: value for key, value in self.shape.items() if key in find(self.effect).spans}

    def span_phrases(self, robot: Robot) -> tuple[str, ...]:
        """What the sizes are counted over, with units; none where they tell that by their own."""
        return self._phrases(robot, self.spans)

    def shape_phrases(self, robot: Robot) -> tuple[str, ...]:
        """What the shape's values mean, with units."""
        return self._phrases(robot, self.shape)

    def _phrases(self, robot: Robot, shape: Shape) -> tuple[str, ...]:
        told, joint = find(self.effect).told, self.where.get("joint")
        slides = isinstance(joint, int) and robot.joint[joint - 1].prismatic
        said = []
        for key, value in shape.items():
            phrase = told.get(key, f"{key} = {{}}")
            if phrase and ("{}" in phrase or value):
                number = f"{float(value):.{_DIGITS if abs(value) < _CLOCK else 2 * _DIGITS + 2}g}"
                said.append(phrase.format(number).replace("LOAD", "N" if slides else "N·m"))
        return tuple(said)

    def assumptions(self, robot: Robot) -> tuple[str, ...]:
        """Remarks on what the shape takes for granted, and on what else looks like it."""
        effect = find(self.effect)
        assumed, alike = effect.assumed, effect.alike(robot, self.where, self.shape)
        taken = (assumed[k].format(f"{float(v):.4g}") for k, v in self.shape.items() if k in assumed)
        return (*taken, *((alike,) if alike else ()))

    def unread(self, robot: Robot) -> tuple[str, ...]:
        """Keys of the shape that the effect does not look at: misspelt, or of another effect."""
        if find(self.effect).columns is not None:
            return ()
        read = _Read(self.shape)
        find(self.effect).realise(robot, self.where, read)
        return tuple(key for key in self.shape if key not in read.keys_read)


class _Read(Mapping[str, float]):
    """A shape that remembers which of its values were read: who goes through the keys has read none yet."""

    def __init__(self, shape: Shape) -> None:
        self._shape, self.keys_read = shape, set[str]()

    def __getitem__(self, key: str) -> float:
        self.keys_read.add(key)
        return self._shape[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._shape)

    def __len__(self) -> int:
        return len(self._shape)


def realise_all(effects: Sequence[EffectInstance], robot: Robot) -> tuple[Realisation, ...]:
    """Parameters and terms of effects of one model.

    Raises UserError for two that give one parameter different laws; effects that share entries of a link agree on them.
    """
    found = tuple(effect.realise(robot) for effect in effects)
    laws: dict[str, tuple[EffectInstance, set[Term]]] = {}
    for effect, realised in zip(effects, found, strict=True):
        for p in realised.parameters:
            law = {term for term in realised.terms if term.parameter == p.name}
            earlier, other = laws.setdefault(p.name, (effect, law))
            if other != law:
                raise UserError(
                    f"{earlier.effect} with the shape {dict(earlier.shape)} and {effect.effect} with "
                    f"{dict(effect.shape)} are two laws of one parameter, {p.name}: keep one of them"
                )
    return found


def _acceptable(entry: Effect, robot: Robot, where: Where) -> bool:
    """Whether the robot has the place; any details are accepted where it is."""
    own = site(where)
    return any(site(plain(place)) == own for place in entry.places(robot))
