"""All effects that are known: the files of this room, and those of other packages.

A plugin registers an ``Effect`` under the entry point group ``symstiff.effects`` (docs/plugins.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache, wraps
from importlib import import_module, metadata
from pkgutil import iter_modules
from typing import Any

from symstiff.arguments import require
from symstiff.effects.base import Effect, Realisation, Shape, Where
from symstiff.effects.lawful import check_realised
from symstiff.effects.places import plain
from symstiff.errors import UserError, did_you_mean
from symstiff.robot.frozen import FrozenDict, frozen_numbers
from symstiff.robot.schema import Robot

_ASKED = (
    "places", "shapes", "realise", "columns", "places_in", "moves", "odds", "unlikely", "alike", "sense", "levels",
)  # fmt: skip
"""What an effect is asked."""


@cache
def catalogue() -> Mapping[str, Effect]:
    """All effects by identifier: the files of this room, then plugins (entry points ``symstiff.effects``)."""
    found = dict(_own())
    for point in sorted(metadata.entry_points(group="symstiff.effects"), key=lambda p: p.name):
        effect = _loaded(point)
        if effect.identifier in found:
            raise UserError(
                f"{_of(point)}: there is an effect {effect.identifier!r} already: give it another identifier, or "
                "uninstall the package"
            )
        found[effect.identifier] = effect
    return FrozenDict(found)


@cache
def _own() -> dict[str, Effect]:
    """The effects of this room."""
    package = import_module("symstiff.effects")
    found: dict[str, Effect] = {}
    for module in sorted(m.name for m in iter_modules(package.__path__)):
        effect = getattr(import_module(f"symstiff.effects.{module}"), "EFFECT", None)
        if isinstance(effect, Effect):
            found[effect.identifier] = effect
    return found


def is_brought(effect: Effect) -> bool:
    """Whether an effect is none of this room's, whose laws the tests know."""
    return _own().get(effect.identifier) is not effect


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
    own = {name: getattr(effect, name) for name in _ASKED}
    telling: Any = {name: _told(point, name, f) for name, f in own.items() if f is not None}
    return replace(effect, **telling)


def _told(point: metadata.EntryPoint, name: str, asked: Callable[..., Any]) -> Callable[..., Any]:
    """A plugin's function, whose failure and whose answers that are none name the plugin."""
    checked = _CHECKED.get(name)

    @wraps(asked)
    def telling(*arguments: Any) -> Any:
        try:
            found = asked(*arguments)
            return found if checked is None else checked(name, found, *arguments)
        except UserError as error:
            raise UserError(f"{error} ({_of(point)})") from error
        except Exception as error:  # whatever another package's function raises
            shape = f" with the shape {dict(arguments[2])}" if name == "realise" else ""
            raise UserError(
                f"{_of(point)}: its {name} fails{shape} ({type(error).__name__}: {str(error)[:200]}): repair or "
                "uninstall the package"
            ) from error

    return telling


def _places(name: str, found: Any, *_: Any) -> tuple[Where, ...]:
    """Places as tables of what files hold. Raises UserError for what are none."""
    places = (
        tuple(found) if isinstance(found, Iterable) and not isinstance(found, str | Mapping) else (found,)
    )
    for where in places:
        require(where, Mapping, f"a place of {name}", "give a tuple of tables, as ({'joint': 2},)")
    tables = tuple(plain(where) for where in places)
    for where in tables:
        for key, value in where.items():
            parts = value if isinstance(value, list) else [value]
            if not isinstance(key, str) or not all(isinstance(v, str | int | float) for v in parts):
                raise UserError(f"{name} gives {where}: give texts, numbers or lists of them by name")
    return tables


def _shapes(name: str, found: Any, *_: Any) -> tuple[Shape, ...]:
    """Shapes as tables of numbers. Raises UserError for what are none."""
    shapes = (
        tuple(found) if isinstance(found, Iterable) and not isinstance(found, str | Mapping) else (found,)
    )
    return tuple(frozen_numbers(shape, f"a shape of {name}") for shape in shapes)


def _realised(name: str, found: Any, robot: Robot, *_: Any) -> Realisation:
    check_realised(found, robot)
    return found  # type: ignore[no-any-return]


_CHECKED: dict[str, Callable[..., Any]] = {
    "places": _places, "places_in": _places, "shapes": _shapes, "realise": _realised,
}  # fmt: skip
"""What makes sure of a plugin's answers, and puts them into one form."""


def _of(point: metadata.EntryPoint) -> str:
    package = f" of package {point.dist.name}" if point.dist is not None else ""
    return f"plugin {point.name}{package}"


def find(identifier: str) -> Effect:
    """An effect by its identifier. Raises UserError for an unknown one."""
    if identifier not in catalogue():
        raise UserError(
            f"unknown effect {identifier!r}: {did_you_mean(identifier, catalogue())}known are "
            f"{', '.join(catalogue())}; one of another package is known where that "
            "package is installed (entry points symstiff.effects)"
        )
    return catalogue()[identifier]
