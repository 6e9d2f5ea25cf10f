"""Couplings in closed form: rational functions of the DH lengths, found by exact interpolation.

Every coupling is homogeneous in the lengths, of a degree that its units tell. It is evaluated at random lengths modulo
a prime, and the numerator and denominator with the fewest monomials that fit are solved for, then confirmed at lengths
that were not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
import sympy as sp

from symstiff.reduction.physical import terms_of
from symstiff.reduction.prime import echelon, rational
from symstiff.reduction.reduce import Reduction, axis_sizes
from symstiff.reduction.structural import ExactEngine, in_rationals
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.program import Program, Vector
from symstiff.symbolic.programs import observation_program

_CHECKS = 4
_DEGREES = 6
"""Degrees of the denominator that are tried, from the least that the units allow."""
_UNKNOWNS = 160


def closed_form(reduction: Reduction) -> dict[str, dict[str, sp.Expr]]:
    """Couplings as expressions in a_i, d_i, t_x …; a number where the lengths do not matter.

    One that depends on lengths as no small rational function does is a decimal: its value at the robot's own lengths.
    Where these happen to fit together, all are numbers, for others would have another identifiable set.
    """
    chain, experiment = in_rationals(ElasticChain(reduction.robot, symbolic=True), reduction.experiment)
    lengths = chain.lengths()
    names = tuple(p.name for p in reduction.full)
    program = observation_program(chain, terms_of(reduction.full), names, reduction.experiment.points)
    program = Program(
        program.name,
        (*program.inputs, Vector("lengths", lengths)),
        program.constants,
        program.statements,
        program.outputs,
    )
    engine = ExactEngine(chain, program, names, experiment)
    sampler = _Sampler(engine, reduction, len(lengths))
    size = axis_sizes(chain, reduction.full)
    degree = {p.name: p.length_degree for p in reduction.full}
    here = dict(zip(lengths, chain.length_values(), strict=True))

    def fitted(eliminated: str, kept: str, value: Fraction | float) -> sp.Expr:
        key = eliminated, kept
        depends = sampler.dependence(key)
        if not depends:
            return _number(value)
        found = _fit(sampler, key, lengths, depends, degree[kept] - degree[eliminated])
        found = None if found is None else found * size[kept] / size[eliminated]
        there = sp.nan if found is None else sp.N(found.subs(here))
        close = there.is_finite and abs(float(there) - float(value)) <= 1e-9 * max(1.0, abs(float(value)))
        return found if close else sp.Float(float(value), 15)

    try:
        return {
            eliminated: {kept: fitted(eliminated, kept, value) for kept, value in row.items()}
            for eliminated, row in reduction.partition.couplings.items()
        }
    except _SpecialLengthsError:
        return {
            e: {k: _number(c) for k, c in row.items()} for e, row in reduction.partition.couplings.items()
        }


class _SpecialLengthsError(Exception):
    """The robot's lengths happen to fit together: others would have another identifiable set."""


def _number(value: Fraction | float) -> sp.Expr:
    if isinstance(value, float) or value.denominator > 10**15:
        return sp.Float(float(value), 15)
    return sp.Rational(value.numerator, value.denominator)


class _Sampler:
    """Couplings modulo a prime at random lengths, drawn as they are needed."""

    def __init__(self, engine: ExactEngine, reduction: Reduction, dimension: int) -> None:
        self.engine, self.dimension, self.prime = engine, dimension, engine.primes[0]
        self.rng = np.random.default_rng(11)
        kept = reduction.parameters
        self.free = [n for n in engine.names if n not in kept]
        self.order = [engine.names.index(n) for n in (*kept, *self.free)]
        self.kept = kept
        self.points: list[list[int]] = []
        self.values: list[dict[tuple[str, str], int]] = []
        self.base = [int(x) for x in self.rng.integers(1, self.prime, dimension)]

    def at(self, point: Sequence[int]) -> dict[tuple[str, str], int]:
        """All couplings at one choice of lengths."""
        form, pivots = self.engine.reduced(self.prime, self.order, point)
        if pivots != list(range(len(self.kept))):
            raise _SpecialLengthsError
        return {
            (e, k): int(form[r, len(self.kept) + c])
            for c, e in enumerate(self.free)
            for r, k in enumerate(self.kept)
        }

    def samples(self, n: int) -> None:
        """Have at least n samples."""
        while len(self.points) < n:
            point = [int(x) for x in self.rng.integers(1, self.prime, self.dimension)]
            self.points.append(point)
            self.values.append(self.at(point))

    @cached_property
    def origin(self) -> dict[tuple[str, str], int]:
        """All couplings at one choice of lengths that the others are compared with."""
        return self.at(self.base)

    @cached_property
    def shifted(self) -> list[dict[tuple[str, str], int]]:
        """The same where one length after the other is another."""
        changed = [(x * 3 + 1) % self.prime for x in self.base]
        return [self.at([*self.base[:k], x, *self.base[k + 1 :]]) for k, x in enumerate(changed)]

    def dependence(self, key: tuple[str, str]) -> list[int]:
        """Indices of the lengths on which a coupling depends."""
        return [k for k, there in enumerate(self.shifted) if there[key] != self.origin[key]]


def _fit(
    sampler: _Sampler,
    key: tuple[str, str],
    lengths: Sequence[sp.Symbol],
    depends: Sequence[int],
    degree: int,
) -> sp.Expr | None:
    for below in range(max(0, -degree), max(0, -degree) + _DEGREES):
        above = degree + below
        top = list(combinations_with_replacement(depends, above))
        bottom = list(combinations_with_replacement(depends, below))
        if len(top) + len(bottom) > _UNKNOWNS:
            break
        expression = _solve(sampler, key, lengths, top, bottom)
        if expression is not None:
            return expression
    return None


def _solve(
    sampler: _Sampler,
    key: tuple[str, str],
    lengths: Sequence[sp.Symbol],
    top: Sequence[tuple[int, ...]],
    bottom: Sequence[tuple[int, ...]],
) -> sp.Expr | None:
    """Numerator and denominator coefficients as the null vector of N(x) − c·D(x) at the samples."""
    unknowns, prime = len(top) + len(bottom), sampler.prime
    sampler.samples(unknowns + _CHECKS)
    rows = []
    for point, values in zip(sampler.points, sampler.values, strict=True):
        above = [_monomial(point, m, prime) for m in top]
        below = [-values[key] * _monomial(point, m, prime) % prime for m in bottom]
        rows.append([*above, *below])
    form, pivots = echelon(np.array(rows, dtype=np.int64), prime)
    if len(pivots) != unknowns - 1:
        return None
    (free,) = set(range(unknowns)) - set(pivots)
    residues = [0] * unknowns
    residues[free] = 1
    for r, p in enumerate(pivots):
        residues[p] = int(-form[r, free]) % prime
    fractions = [rational(r, prime) for r in residues]
    if any(f is None for f in fractions):
        return None
    terms = [sp.Rational(f.numerator, f.denominator) for f in fractions if f is not None]
    numerator = sum(c * sp.prod(lengths[k] for k in m) for c, m in zip(terms, top, strict=False))
    denominator = sum(
        c * sp.prod(lengths[k] for k in m) for c, m in zip(terms[len(top) :], bottom, strict=True)
    )
    return sp.factor(numerator / denominator)


def _monomial(point: Sequence[int], monomial: Sequence[int], prime: int) -> int:
    value = 1
    for k in monomial:
        value = value * point[k] % prime
    return value
