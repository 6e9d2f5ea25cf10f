"""The one shape of an effect: where it can be, and its law as terms at virtual joints.

A catalogue file defines one ``Effect``; a plugin registers one under the entry point group
``symstiff.effects`` (docs/plugins.md). No module outside this room knows an effect by name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from symstiff.arguments import words
from symstiff.errors import UserError
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import Term, VirtualJoint

Where = Mapping[str, Any]
Shape = Mapping[str, float]
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
"""Identifiers and names of parameters."""
_KINDS = frozenset({"deflection", "absolute"})
"""Kinds of data."""
_COLUMNS = frozenset({"time", "temperature", "branch"})
"""What an effect may need of a table."""


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
    are the time [s] and temperature [°C] at which the law does nothing, where it is not zero there. ``over`` are the
    time [s] and temperature [K] from there on over which it was measured, where the shape's ``spans`` leave them out.
    """

    parameters: tuple[EffectParameter, ...]
    terms: tuple[Term, ...]
    replaces: tuple[str, ...] = ()
    nominal: Mapping[str, float] = field(default_factory=dict)
    rest: Mapping[str, float] = field(default_factory=dict)
    over: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_constant(self) -> bool:
        """Whether it sets virtual joints off by constants: a frame that is off, a joint's zero."""
        return bool(self.terms) and all(t.factor.is_number for t in self.terms)


@dataclass(frozen=True)
class Scales:
    """The sizes that shapes are profiled over: of an experiment, or plausible ones where there is none.

    kind: ``deflection`` or ``absolute``; load: largest \\|τ\\| by virtual joint [N, N·m]; angles: the
    distinct values of every joint variable, ascending [rad, m]; total: as load, with the weight of the links that the
    robot file tells; context: largest span of ``time`` [s] and
    ``temperature`` [K] where known; lowest: their smallest values; unloaded: share of the states without a load at the
    tool.
    """

    kind: str = "deflection"
    load: Mapping[VirtualJoint, float] = field(default_factory=dict)
    angles: tuple[tuple[float, ...], ...] = ()
    context: Mapping[str, float] = field(default_factory=dict)
    lowest: Mapping[str, float] = field(default_factory=dict)
    total: Mapping[VirtualJoint, float] = field(default_factory=dict)
    unloaded: float = 0.0

    @property
    def mixed(self) -> bool:
        """Whether some states have a load at the tool and others none."""
        return 0.0 < self.unloaded < 1.0

    def of(self, joint: VirtualJoint, otherwise: float = 1000.0) -> float:
        """Largest load on a virtual joint, to three digits so that equal data give equal names."""
        found = self.load.get(joint, 0.0)
        return float(f"{found:.3g}") if found > 0 else otherwise

    def of_total(self, joint: VirtualJoint) -> float:
        """The same with the links' weight, as far as the robot file tells it."""
        found = self.total.get(joint, 0.0)
        return float(f"{found:.3g}") if found > 0 else self.of(joint)


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
    (N, 3) leads from the tool centre point to the measured point; ``robot`` is the robot file's.
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
    @property
    def robot(self) -> Robot: ...  # noqa: D102

    def of(self, robot: Robot) -> Situation:
        """The same states of a robot whose links weigh something else, under the same loads of the experiment."""

    def respond(self, loads: np.ndarray) -> np.ndarray:
        """Further deflections (N, V) of the current model under further loads (N, V)."""

    def rows(self, twists: np.ndarray) -> np.ndarray:
        """Rows (M,) that twists (N, 6) of the measured points are seen as."""


def _no_shape(robot: Robot, where: Where, scales: Scales) -> tuple[Shape, ...]:
    return ({},)


def _as_usual(robot: Robot, shape: Shape) -> float:
    return 1.0


def _like_nothing(robot: Robot, where: Where, shape: Shape) -> str:
    return ""


def _no_sense(shape: Shape, sizes: Mapping[str, float]) -> str:
    return ""


def _not_unlikely(robot: Robot, where: Where, rigid: bool) -> str:
    return ""


def _no_moves(robot: Robot, shape: Shape) -> Mapping[str, Move]:
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
    spans: tuple[str, ...] = ()
    """Keys of a shape that its sizes are counted over, as a drift's are over a time: said beside them."""
    assumed: Mapping[str, str] = field(default_factory=dict)
    """What a shape's value takes for granted that the robot file could tell, by key: a remark, ``{}`` for the value.

    Keys are alternatives: their shapes share the prior weight of one.
    """
    moves: Callable[[Robot, Shape], Mapping[str, Move]] = _no_moves
    """How a shape's values, by key, are moved: what lies between those that are profiled."""
    odds: Callable[[Robot, Shape], float] = _as_usual
    """Prior weight of a shape; below one where it is rarer than the others, or the robot file tells otherwise."""
    weights: float | None = None
    """The shape's entry ``weights`` where it is left out: 1, its law counts the links' weight by itself, or 0, it takes
    the load as it comes. None: its shapes have no such entry."""
    within: float = 0.0
    """That entry in positions of a robot whose file tells masses, where the load holds the links' weight already."""
    unlikely: Callable[[Robot, Where, bool], str] = _not_unlikely
    """Why it is not looked for at one of its places, by what the robot file tells, and by whether the model takes all
    links for rigid; empty where it is."""
    alike: Callable[[Robot, Where, Shape], str] = _like_nothing
    """What outside of the catalogue looks like it, where the robot file does not speak for it; empty where nothing."""
    sense: Callable[[Shape, Mapping[str, float]], str] = _no_sense
    """Which way it goes, by its shape and its sizes: a sentence behind the description; empty where that says it."""
    levels: Callable[[Sequence[float]], Shape] | None = None
    """The shape that is a compliance of the joint at each of its variable's values, ascending; None: it has none."""

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.identifier):
            raise UserError(f"an effect cannot be called {self.identifier!r}: use letters, digits and _")
        for name in ("places", "realise", "shapes"):
            if not callable(getattr(self, name)):
                raise UserError(f"{self.identifier}: {name} is no function: give one")
        self._check_words()
        for name in ("told", "assumed"):
            for key, phrase in getattr(self, name).items():
                if not _takes_a_number(phrase):
                    raise UserError(
                        f"{self.identifier}: {name} of {key} is {phrase!r}: give a text with one {{}}, or none"
                    )

    def _check_words(self) -> None:
        """Refuse kinds of data that there are none of, and columns that no table has."""
        seen = words(self.seen_in, f"{self.identifier}: seen_in", "{'deflection'}")
        if not seen or not _KINDS.issuperset(seen):
            raise UserError(f"{self.identifier}: seen_in is {sorted(seen)}: give some of {sorted(_KINDS)}")
        needs = words(self.needs, f"{self.identifier}: needs", "{'time or temperature'}")
        for column in (name for need in needs for name in need.split(" or ")):
            if column not in _COLUMNS:
                raise UserError(f"{self.identifier}: needs {column!r}: give some of {sorted(_COLUMNS)}")
        for name in ("confused_with", "spans"):
            words(getattr(self, name), f"{self.identifier}: {name}", "('backlash',)")


def _takes_a_number(phrase: Any) -> bool:
    """Whether a phrase can say a value."""
    try:
        return bool(phrase.format("1") is not None)
    except (AttributeError, LookupError, ValueError):
        return False
