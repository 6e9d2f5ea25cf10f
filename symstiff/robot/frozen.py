"""Dictionaries and lists that stay as they are: values of robots and models are shared, by caches among others."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import Any, NoReturn, TypeVar

from symstiff.arguments import require
from symstiff.errors import UserError

K = TypeVar("K")
V = TypeVar("V")
_READ_ONLY = "these values are read-only: make another robot or model with others"


class FrozenDict(dict[K, V]):
    """A read-only dict; it equals, copies, pickles and serialises as a dict does. Changing it raises TypeError."""

    def _refuse(self, *args: Any, **kwargs: Any) -> NoReturn:
        raise TypeError(_READ_ONLY)

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (dict(self),))

    def __copy__(self) -> FrozenDict[K, V]:
        return self

    def __deepcopy__(self, memo: Any) -> FrozenDict[K, V]:
        return self


class FrozenList(list[V]):
    """A read-only list; it equals, copies, pickles and serialises as a list does. Changing it raises TypeError."""

    def _refuse(self, *args: Any, **kwargs: Any) -> NoReturn:
        raise TypeError(_READ_ONLY)

    __setitem__ = __delitem__ = __iadd__ = __imul__ = _refuse
    append = clear = extend = insert = pop = remove = reverse = sort = _refuse

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(tuple(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return (type(self), (list(self),))

    def __copy__(self) -> FrozenList[V]:
        return self

    def __deepcopy__(self, memo: Any) -> FrozenList[V]:
        return self


def frozen_numbers(values: Mapping[K, Any], what: str, least: float = -math.inf) -> FrozenDict[K, float]:
    """A read-only dict of finite numbers from ``least`` on. Raises UserError that names the entry that is none."""
    require(values, Mapping, f"{what} by name", "give a dictionary")
    for name, value in values.items():
        if not isinstance(value, Real) or not math.isfinite(value):
            found = f"{str(value)[:40]!r}: correct it"
            raise UserError(f"{what}: {str(name)[:40]}: expected a finite number, found {found}")
        if value < least:
            raise UserError(f"{what}: {str(name)[:40]}: expected {least:g} or more, found {value:g}")
    return FrozenDict({name: float(value) for name, value in values.items()})
