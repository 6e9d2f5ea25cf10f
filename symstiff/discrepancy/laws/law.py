"""A law without a name at one virtual joint, and the load that it is a function of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from symstiff.arrays import TINY, Array
from symstiff.discrepancy.problem import Parameter, Problem


@dataclass(frozen=True)
class Law:
    """A few columns with their expressions."""

    text: tuple[str, ...]
    values: Array
    """(M, k) factors of the virtual joint's Jacobian column."""
    own: bool = True
    """Whether it depends on nothing of other joints: then it is another shape of what the catalogue has there."""
    family: str = ""
    """Laws of one family at one place compete as one, by their average."""
    known: tuple[Parameter, ...] = ()
    """The coefficients, where more is known of them than the text."""
    driven: frozenset[str] = frozenset()
    """What it depends on beside loads."""

    @property
    def title(self) -> str:
        """The family, or the expression."""
        return self.family or " + ".join(self.text)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coefficients, one a column."""
        return self.known or tuple(Parameter(t) for t in self.text)


@dataclass(frozen=True)
class Load:
    """A virtual joint's load in units of its largest: with the links' weight, and the weight alone."""

    total: Array
    before: Array

    def law(self, of: Callable[[Array], Array]) -> Array:
        """What a deflection shows of a law of the total load, (M, 1)."""
        return np.asarray(of(self.total) - of(self.before))[:, None]

    def product(self, other: Load, of: Callable[[Array], Array] = np.asarray) -> Array:
        """The same of its product with a law of another joint's load, (M, 1)."""
        return np.asarray(self.total * of(other.total) - self.before * of(other.before))[:, None]


def load_on(problem: Problem, v: int) -> Load:
    """The load on a virtual joint."""
    total, own = _with_weight(problem, v)
    largest = largest_load(problem, v)
    return Load(total / largest, own / largest)


def _with_weight(problem: Problem, v: int) -> tuple[Array, Array]:
    assert problem.tau is not None
    own = np.zeros(problem.rows) if problem.weight is None else problem.weight[:, v]
    return problem.tau[:, v] + own, own


def largest_load(problem: Problem, v: int) -> float:
    """Size of the largest load on a virtual joint, links' weight included: the unit of tau in the laws."""
    return max(float(np.max(np.abs(_with_weight(problem, v)[0]))), TINY)
