"""The one shape of an effect: where it can be, and its law as terms at virtual joints.

A catalogue file defines one ``Effect``; a plugin registers one under the entry point group
``symstiff.effects`` (docs/plugins.md). No module outside this room knows an effect by name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module, metadata
from pkgutil import iter_modules
from typing import Any, Protocol

import numpy as np

from symstiff.arguments import require
from symstiff.effects.lawful import check_laws
from symstiff.errors import UserError
from symstiff.robot.frozen import frozen_numbers
from symstiff.robot.names import C_WORDS
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, VirtualJoint

Where = Mapping[str, Any]
Shape = Mapping[str, float]
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_MEMBERS = frozenset({"k", "time", "temperature", "branch"})
"""What the C struct of a model's parameters holds beside those of effects."""
_FAR = 1e12
"""Size of a shape's value, in SI units, that nobody means."""
_DIGITS, _CLOCK = 4, 1e4
"""Digits of a shape's value as told, and from where on it gets all of them, as the time of a clock does."""


@dataclass(frozen=True)
class Move:
    """How a value of a shape is moved between those that are profiled: by steps that multiply it, or are added.

    One step leads about to the next value of the profile; what goes ``around`` is an angle without ends.
    """

    step: float
    added: bool = False
    around: bool = False

    def __call__(self, value: float, steps: float) -> float:
        """The value that lies so many steps from another."""
        moved = value + self.step * steps if self.added else value * self.step**steps
        return float(f"{moved:.4g}" if self.added else f"{moved:.3g}")


@dataclass(frozen=True)
class EffectParameter:
    """A linear parameter of an effect: full name, SI unit, physically plausible range, typical size, its part."""

    name: str
    unit: str
    low: float
    high: float
    typical: float
    meaning: str = ""


@dataclass(frozen=True)
class Realisation:
    """An effect at one place with its shape fixed: its parameters and terms.

    ``replaces`` names parameters that the effect's own stand for (a joint compliance that became several).
    ``nominal`` is the known value of parameters that are not free (a second-order term has coefficient 1). ``rest``
    are the time [s] and temperature [°C] at which the law does nothing, where it is not zero there.
    """

    parameters: tuple[EffectParameter, ...]
    terms: tuple[Term, ...]
    replaces: tuple[str, ...] = ()
    nominal: Mapping[str, float] = field(default_factory=dict)
    rest: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Scales:
    """The sizes that shapes are profiled over: of an experiment, or plausible ones where there is none.

    kind: ``deflection`` or ``absolute``; load: largest \\|τ\\| by virtual joint [N, N·m]; angles: the
    distinct values of every joint variable, ascending [rad, m]; context: largest span of ``time`` [s] and
    ``temperature`` [K] where known; lowest: their smallest values.
    """

    kind: str = "deflection"
    load: Mapping[VirtualJoint, float] = field(default_factory=dict)
    angles: tuple[tuple[float, ...], ...] = ()
    context: Mapping[str, float] = field(default_factory=dict)
    lowest: Mapping[str, float] = field(default_factory=dict)

    def of(self, joint: VirtualJoint, otherwise: float = 1000.0) -> float:
        """Largest load on a virtual joint, to three digits so that equal data give equal names."""
        found = self.load.get(joint, 0.0)
        return float(f"{found:.3g}") if found > 0 else otherwise


@dataclass(frozen=True, eq=False)
class Body:
    """A link whose weight the robot file tells, in N states: the first ``before`` virtual joints carry it.

    ``lever`` (N, 3) leads from the tool centre point to its centre of mass, ``wrench`` (N, 6) acts there; base axes.
    """

    before: int
    lever: np.ndarray
    wrench: np.ndarray

    def columns(self, J: np.ndarray) -> np.ndarray:
        """(N, 6, before) of the Jacobian J (N, 6, V) at the tool centre point, for the centre of mass."""
        return at_lever(J[:, :, : self.before], self.lever)


def at_lever(J: np.ndarray, lever: np.ndarray) -> np.ndarray:
    """The columns J (N, 6, V) at the tool centre point, for a point at levers (N, 3) from it."""
    return np.concatenate([J[:, :3] + np.cross(J[:, 3:], lever[:, :, None], axis=1), J[:, 3:]], axis=1)


class Situation(Protocol):
    """What an effect that is no law may look at: N states (pose, load case, point), M rows of data.

    ``labels`` name the poses; ``row_pose`` and ``row_axis`` (M,) number each row's pose and component
    (0–5); ``J`` (N, 6, V) is the virtual-joint Jacobian at the tool centre point, base axes; ``theta`` (N,
    V) the current model's deflections, ``sag`` (N, V) those under the links' known weight that are there
    without the load and that the data do not show; ``wrench`` (N, 6); ``bodies`` what weighs; ``offset``
    (N, 3) leads from the tool centre point to the measured point.
    """

    @property
    def labels(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def row_pose(self) -> np.ndarray: ...  # noqa: D102
    @property
    def row_axis(self) -> np.ndarray: ...  # noqa: D102
    @property
    def J(self) -> np.ndarray: ...  # noqa: D102
    @property
    def theta(self) -> np.ndarray: ...  # noqa: D102
    @property
    def sag(self) -> np.ndarray: ...  # noqa: D102
    @property
    def bodies(self) -> tuple[Body, ...]: ...  # noqa: D102
    @property
    def wrench(self) -> np.ndarray: ...  # noqa: D102
    @property
    def offset(self) -> np.ndarray: ...  # noqa: D102

    def respond(self, loads: np.ndarray) -> np.ndarray:
        """Further deflections (N, V) of the current model under further loads (N, V)."""

    def rows(self, twists: np.ndarray) -> np.ndarray:
        """Rows (M,) that twists (N, 6) of the measured points are seen as."""


def _no_shape(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    return ({},)


def _alike(robot: Robot, shape: Shape) -> float:
    return 1.0


def _likely(robot: Robot, where: Where) -> str:
    return ""


def _itself(robot: Robot, shape: Shape) -> str:
    return ""


def _fixed(robot: Robot, shape: Shape) -> Mapping[str, Move]:
    return {}


@dataclass(frozen=True)
class Effect:
    """An entry of the catalogue.

    places(robot) lists the ``where`` dictionaries; shapes(robot, where, scales) the values of the shape
    parameters to profile (one empty dictionary where there are none); realise(robot, where, shape) the
    parameters and terms. seen_in: ``deflection``, ``absolute``; needs: context columns (``time``,
    ``temperature``, ``branch``), alternatives as ``time or temperature``. An effect that is no law at
    virtual joints gives ``columns(situation, where, shape)`` (M, parameters) instead of terms, and
    ``places_in(situation)`` where its places depend on the data.
    """

    identifier: str
    title: str
    description: str
    seen_in: frozenset[str]
    places: Callable[[Robot], tuple[Where, ...]]
    realise: Callable[[Robot, Where, Shape], Realisation]
    shapes: Callable[[Robot, Where, Scales], tuple[Shape, ...]] = _no_shape
    needs: frozenset[str] = frozenset()
    confused_with: tuple[str, ...] = ()
    separated_by: str = ""
    columns: Callable[[Situation, Where, Shape], np.ndarray] | None = None
    places_in: Callable[[Situation], tuple[Where, ...]] | None = None
    told: Mapping[str, str] = field(default_factory=dict)
    """What a shape's value means, by key: ``{}`` stands for it, LOAD for N·m or N.

    A phrase without ``{}`` is said where the value is not zero, an empty one never.
    """
    assumed: Mapping[str, str] = field(default_factory=dict)
    """What a shape's value takes for granted that the robot file could tell, by key: a remark, ``{}`` for the value.

    Keys are alternatives: their shapes share the prior weight of one.
    """
    moves: Callable[[Robot, Shape], Mapping[str, Move]] = _fixed
    """How a shape's values, by key, are moved: what lies between those that are profiled."""
    odds: Callable[[Robot, Shape], float] = _alike
    """Prior weight of a shape; below one where the robot file tells otherwise."""
    weights: float | None = None
    """The shape's entry ``weights`` where it is left out: 1, its law counts the links' weight by itself, or 0, it takes
    the load as it comes. None: its shapes have no such entry."""
    unlikely: Callable[[Robot, Where], str] = _likely
    """Why it is not looked for at one of its places, by what the robot file tells; empty where it is."""
    alike: Callable[[Robot, Shape], str] = _itself
    """What outside of the catalogue looks like it, where the robot file does not speak for it; empty where nothing."""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.identifier):
            raise UserError(f"an effect cannot be called {self.identifier!r}: use letters, digits and _")


def _check_names(found: Realisation) -> None:
    """Refuse names that no C struct can hold; what has no terms has no code, and its names may tell of rows."""
    for p in found.parameters if found.terms else ():
        if not _NAME.fullmatch(p.name) or p.name in C_WORDS | _MEMBERS:
            raise UserError(
                f"an effect's parameter cannot be called {p.name!r}: it is a member of a C struct beside k, time, "
                "temperature and branch: use letters, digits and _, e.g. <effect>_<place>_<what>"
            )


@dataclass(frozen=True)
class EffectInstance:
    """An effect in a model: which, where, with which shape."""

    effect: str
    where: Where
    shape: Shape = field(default_factory=dict)

    def __post_init__(self) -> None:
        require(self.effect, str, "an effect's identifier", "'backlash' is one")
        require(self.where, Mapping, f"where {self.effect} is", "{'joint': 2} is a place")
        object.__setattr__(self, "where", {key: _plain(value) for key, value in self.where.items()})
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
            _check_names(found)
            check_laws(found.terms, robot)
            return found
        except UserError as error:
            raise UserError(f"{self.effect} at {dict(self.where)}: {error}") from error
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise UserError(
                f"{self.effect} at {dict(self.where)}: the shape {dict(self.shape)} does not fit: {error}"
            ) from error

    def shape_phrases(self, robot: Robot) -> tuple[str, ...]:
        """What the shape's values mean, with units."""
        told, joint = find(self.effect).told, self.where.get("joint")
        slides = isinstance(joint, int) and robot.joint[joint - 1].prismatic
        said = []
        for key, value in self.shape.items():
            phrase = told.get(key, f"{key} = {{}}")
            if phrase and ("{}" in phrase or value):
                number = f"{float(value):.{_DIGITS if abs(value) < _CLOCK else 2 * _DIGITS + 2}g}"
                said.append(phrase.format(number).replace("LOAD", "N" if slides else "N·m"))
        return tuple(said)

    def assumptions(self, robot: Robot) -> tuple[str, ...]:
        """Remarks on what the shape takes for granted, and on what else looks like it."""
        effect = find(self.effect)
        assumed, alike = effect.assumed, effect.alike(robot, self.shape)
        taken = (assumed[k].format(f"{float(v):.4g}") for k, v in self.shape.items() if k in assumed)
        return (*taken, *((alike,) if alike else ()))

    def unread(self, robot: Robot) -> tuple[str, ...]:
        """Keys of the shape that the effect does not look at: misspelt, or of another effect."""
        if find(self.effect).columns is not None:
            return ()
        read = _Read(self.shape)
        find(self.effect).realise(robot, self.where, read)
        return tuple(key for key in self.shape if key not in read.keys_read)


def _plain(value: Any) -> Any:
    """A part of a place without NumPy's types, which no file holds."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return type(value)(_plain(v) for v in value)
    return int(value) if isinstance(value, float) and value.is_integer() else value


class _Read(Mapping[str, float]):
    """A shape that remembers what was read of it."""

    def __init__(self, shape: Shape) -> None:
        self._shape, self.keys_read = shape, set[str]()

    def __getitem__(self, key: str) -> float:
        self.keys_read.add(key)
        return self._shape[key]

    def __iter__(self) -> Iterator[str]:
        self.keys_read.update(self._shape)
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
    """Whether the robot has the place; any harmonics are accepted where the joint is."""
    free = {k: v for k, v in where.items() if k != "harmonics"}
    places = ({k: v for k, v in place.items() if k != "harmonics"} for place in entry.places(robot))
    return any(place == free for place in places)


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
        effect = _loaded(point)
        if effect.identifier in found:
            raise UserError(
                f"{_of(point)}: there is an effect {effect.identifier!r} already: give it another identifier, or "
                "uninstall the package"
            )
        found[effect.identifier] = effect
    return found


def _loaded(point: metadata.EntryPoint) -> Effect:
    """The effect of a plugin. Raises UserError that names the package where it cannot be had."""
    try:
        effect = point.load()
    except Exception as error:  # whatever another package's module raises
        raise UserError(
            f"{_of(point)}: cannot load {point.value} ({type(error).__name__}: {str(error)[:200]}): repair or "
            "uninstall the package"
        ) from error
    if not isinstance(effect, Effect):
        raise UserError(f"{_of(point)}: {point.value} is no Effect: see symstiff.effects.base")
    return effect


def _of(point: metadata.EntryPoint) -> str:
    package = f" of package {point.dist.name}" if point.dist is not None else ""
    return f"plugin {point.name}{package}"


def find(identifier: str) -> Effect:
    """An effect by its identifier. Raises UserError for an unknown one."""
    if identifier not in catalogue():
        raise UserError(
            f"unknown effect {identifier!r}: known are {', '.join(catalogue())}; one of another package is known "
            "where that package is installed (entry points symstiff.effects)"
        )
    return catalogue()[identifier]


def place_name(where: Where) -> str:
    """A place as part of a parameter's name: ``3``, ``4_5``, ``force_sensor``."""
    parts: list[str] = []
    for key, value in where.items():
        if key != "harmonics":
            parts += [str(v) for v in value] if isinstance(value, list | tuple) else [str(value)]
    return "_".join(parts)
