"""The registry of what a truth may contain: effects by name and shape, each with its parameters.

A shape says what it adds to the mechanism (a compliance, a law, an inner torque, a change of the wrench, a
weight) or to what the device reads. ``amplitudes`` are the parameters that scale the effect; they must be
given. Shapes are deliberately richer than the catalogue that identification searches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.simulation.chain import Chain
from symstiff.calibration.simulation.equilibrium import Law, States, Torque, Weight, Wrench
from symstiff.calibration.simulation.forms import Form, form_of_option, form_of_size, formed
from symstiff.errors import UserError, did_you_mean, printable

Reading = Callable[[States, Array, str], Array]
"""``reading(states, values, kind)``: what the device makes of values (M, 6), deflections or absolute."""


@dataclass(frozen=True)
class Additions:
    """What one effect adds."""

    compliance: Array | None = None
    laws: tuple[Law, ...] = ()
    torques: tuple[Torque, ...] = ()
    wrenches: tuple[Wrench, ...] = ()
    weights: tuple[Weight, ...] = ()
    readings: tuple[Reading, ...] = ()
    shifts: tuple[tuple[tuple[str, ...], Array], ...] = ()  # pose labels, shift (3,) of their data


@dataclass(frozen=True)
class Site:
    """Where an effect sits in a chain: the value of its ``where`` key, and the linear compliance so far."""

    chain: Chain
    where: Any
    compliance: Array


Values = dict[str, Any]
"""Sizes and options of a shape, by name."""
Builder = Callable[[Site, Values], Additions]


@dataclass(frozen=True)
class Shape:
    """One effect in one shape: its place, its parameters with defaults, and how to build it."""

    effect: str
    shape: str
    place: str
    amplitudes: tuple[str, ...]
    defaults: Mapping[str, Any]
    forms: Mapping[str, Form]
    build: Builder


SHAPES: dict[tuple[str, str], Shape] = {}
_PLACELESS = ("load", "measurement", "robot")
"""Keys by which a verdict says that an effect has no place on the robot."""


def phenomenon(
    effect: str, shape: str, place: str, *sizes: str, **defaults: Any
) -> Callable[[Builder], Builder]:
    """Register a shape of an effect; the first shape registered is the effect's default.

    A size is written as its form: ``c``, ``bias[6]``, ``a[]``, ``entries{}``; an option has the form of its default.
    """
    amplitudes = dict(map(form_of_size, sizes))
    forms = {**{name: form_of_option(name, value) for name, value in defaults.items()}, **amplitudes}

    def register(build: Builder) -> Builder:
        SHAPES[effect, shape] = Shape(effect, shape, place, tuple(amplitudes), defaults, forms, build)
        return build

    return register


@dataclass(frozen=True)
class Effect:
    """One entry of a truth: what, where, which shape, how much; ``values``: amplitudes and options."""

    effect: str
    where: Any = None
    shape: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)

    def scaled(self, factor: float) -> Effect:
        """Return the effect with its amplitudes multiplied; all else as it is."""
        known = shape_of(self).amplitudes
        return replace(
            self, values={k: _scaled(v, factor) if k in known else v for k, v in self.values.items()}
        )


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, Mapping):
        return {key: _scaled(v, factor) for key, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_scaled(v, factor) for v in value]
    return value * factor


def shape_of(effect: Effect) -> Shape:
    """Find the shape an effect names. Raises UserError with the known names."""
    shapes = [s for (name, _), s in SHAPES.items() if name == effect.effect]
    if not shapes:
        known = list(dict.fromkeys(name for name, _ in SHAPES))
        hint = did_you_mean(effect.effect, known)
        raise UserError(f"unknown effect {effect.effect!r}: {hint}use one of {', '.join(known)}")
    if not effect.shape:
        given = effect.where if isinstance(effect.where, Mapping) else {}
        fits = [s for s in shapes if s.place in given] or [s for s in shapes if _placeless(s)]
        return (fits or shapes)[0]
    for shape in shapes:
        if shape.shape == effect.shape:
            return shape
    raise UserError(
        f"effect {effect.effect}: unknown shape {effect.shape!r}: "
        f"use one of {', '.join(s.shape for s in shapes)}"
    )


def _placeless(shape: Shape) -> bool:
    return shape.place not in ("joint", "joints", "link")


def describe_effects() -> str:
    """List what a truth may contain, a line a shape: effect, shape, place, parameters to give, options."""
    lines = []
    for s in SHAPES.values():
        sizes = [name for name in s.amplitudes if name not in s.defaults]
        options = [f"{name} = {list(v) if isinstance(v, tuple) else v}" for name, v in s.defaults.items()]
        where = f"where = {{{s.place} = …}}" if not _placeless(s) else ""
        lines.append(
            "; ".join(x for x in (f"{s.effect} ({s.shape})", where, ", ".join(sizes + options)) if x)
        )
    return "\n".join(lines)


def build(effect: Effect, chain: Chain, compliance: Array) -> Additions:
    """Turn an entry of a truth into what it adds to a mechanism. Raises UserError for what does not fit."""
    shape = shape_of(effect)
    label = f"effect {effect.effect} ({shape.shape})"
    unknown = set(effect.values) - {*shape.amplitudes, *shape.defaults}
    if unknown:
        known = ", ".join((*shape.amplitudes, *shape.defaults)) or "none"
        raise UserError(f"{label}: unknown parameter {sorted(unknown)[0]!r}: known are {known}")
    for name in shape.amplitudes:
        if name not in effect.values and name not in shape.defaults:
            raise UserError(f"{label}: missing {name}: give its size")
    where = _where(effect.where, shape.place, chain, label)
    _check_keys(effect, shape, label)
    values = {
        name: formed(value, shape.forms[name], f"{label}: {name}")
        for name, value in {**shape.defaults, **effect.values}.items()
    }
    try:
        return shape.build(Site(chain, where, compliance), values)
    except UserError as error:
        raise UserError(f"{label}: {error}") from error


def _check_keys(effect: Effect, shape: Shape, label: str) -> None:
    """Refuse a place that the shape does not look at: the effect would sit elsewhere, unseen.

    What a verdict's ``where`` has beside a place on the robot may stand there, if it says what the sizes say.
    """
    where = effect.where
    if where is not None and not isinstance(where, Mapping):
        raise UserError(f"{label}: where: expected a table, found {printable(repr(where), 40)}")
    told = {"harmonics": effect.values.get("harmonics"), "rows": effect.values.get("poses")}
    for key, value in (where or {}).items():
        if key == shape.place or (_placeless(shape) and key in _PLACELESS):
            continue
        if key in told and told[key] is not None and _listed(value) == _listed(told[key]):
            continue
        others = [s.shape for s in SHAPES.values() if s.effect == shape.effect and s.place == key]
        remedy = f"name a shape that has one ({', '.join(others)})" if others else "leave it out"
        raise UserError(f"{label}: where: {printable(str(key), 40)} is no place of this shape: {remedy}")


def _listed(value: Any) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else [value]


def _where(where: Any, place: str, chain: Chain, label: str) -> Any:
    if place not in ("joint", "joints", "link"):
        return None
    given = where.get(place) if isinstance(where, Mapping) else None
    expected = "[j, k]" if place == "joints" else "a number"
    low, high = (0, chain.dof) if place == "link" else (1, chain.dof)
    numbers = given if place == "joints" and isinstance(given, list | tuple) else [given]
    fits = all(isinstance(k, int) and not isinstance(k, bool) and low <= k <= high for k in numbers)
    if not fits or (place == "joints" and len(numbers) != 2):
        raise UserError(
            f"{label}: where = {{{place} = {expected}}} with {low} to {high} expected, "
            f"found {printable(repr(where), 60)}"
        )
    return tuple(numbers) if place == "joints" else given


def smooth_sign(x: Array, width: float) -> Array:
    """tanh(x/width): +1 and −1 away from zero."""
    return np.tanh(x / max(width, 1e-12))


def saturation(t: Array, rate: float) -> Array:
    """1 − exp(−t/T), zero before t = 0."""
    return -np.expm1(-np.maximum(t, 0.0) / max(rate, 1e-12))


def rotation_matrix(vector: Array) -> Array:
    """Rotation (3, 3) by a rotation vector [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * k + (1 - math.cos(angle)) * (k @ k))
