"""All effects that are known: the files of this room, and those of other packages.

A plugin registers an ``Effect`` under the entry point group ``symstiff.effects`` (docs/plugins.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, wraps
from importlib import import_module, metadata
from pkgutil import iter_modules
from typing import Any

from symstiff.effects.base import Effect
from symstiff.errors import UserError

_ASKED = ("places", "shapes", "columns", "places_in", "moves", "odds", "unlikely", "alike", "levels")
"""What an effect is asked beside its law, whose failures are told with the place."""


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
    own = {name: getattr(effect, name) for name in _ASKED}
    telling: Any = {name: _told(point, name, f) for name, f in own.items() if f is not None}
    return replace(effect, **telling)


def _told(point: metadata.EntryPoint, name: str, asked: Callable[..., Any]) -> Callable[..., Any]:
    """A plugin's function, whose failure names the plugin."""

    @wraps(asked)
    def telling(*arguments: Any) -> Any:
        try:
            return asked(*arguments)
        except UserError:
            raise
        except Exception as error:  # whatever another package's function raises
            raise UserError(
                f"{_of(point)}: its {name} fails ({type(error).__name__}: {str(error)[:200]}): repair or uninstall "
                "the package"
            ) from error

    return telling


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
