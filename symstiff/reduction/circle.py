"""The unit circle modulo a prime: fixed angles as points, so that every identity among sines and cosines holds.

The p + 1 points of the circle modulo p = 4k + 3 form a cyclic group. Where p + 1 = order·L, a point of that order
stands for 2·pi/order, and one of order L for one radian, whose powers tell every rational angle: r + s·pi is a product
of both. The radian's sine and cosine are transcendental and keep no other promise than that angles add up. Square roots
are the ones that are squares themselves, so that the root of a product is the product of the roots.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache, cached_property
from itertools import islice
from math import lcm
from random import Random

import sympy as sp

ORDER = 360
"""Whole degrees: the order where no angle asks for another."""
_LARGEST = 100_000  # beyond it too few primes are left
_TRIED = 4000
_PI = 314_159_265  # exponent of a multiple of pi that no multiple of 2·pi/order is
Point = tuple[int, int]  # cosine and sine


@cache
def primes(order: int, count: int = 24) -> tuple[int, ...]:
    """Primes order·L − 1 below 2³¹, L prime, largest first; order is a multiple of 360."""
    return tuple(islice(_primes(order), count))


def _primes(order: int) -> Iterator[int]:
    over = sp.prevprime((2**31 - 1) // order)
    while over > 2:
        if order % over and sp.isprime(order * over - 1):
            yield order * over - 1
        over = sp.prevprime(over)


@cache
def prime_with_roots(order: int, squares: frozenset[int]) -> int:
    """One of these primes, modulo which the numbers have roots, and so have their divisors.

    Each divisor halves the choice: where there are too many, the largest prime, which keeps no promise.
    """
    parts = {f for x in squares for f in sp.factorint(x, limit=2**15)}
    fit = (p for p in islice(_primes(order), _TRIED) if all(sp.jacobi_symbol(f, p) == 1 for f in parts))
    return next(fit, primes(order)[0]) if parts else primes(order)[0]


def order_for(angles: Iterable[sp.Expr]) -> int:
    """The least multiple of ORDER such that each angle's part of pi is a multiple of 2·pi/order.

    A part of pi with so large a denominator that hardly a prime is left does not count.
    """
    order = ORDER
    for denominator in sorted({int(split(a)[1].q) for a in angles}):
        wider = lcm(order, 2 * denominator)
        order = wider if wider <= _LARGEST else order
    return order


def split(angle: sp.Expr) -> tuple[sp.Rational, sp.Rational]:
    """r and s of an angle r + s·pi."""
    rest, turns = angle.as_independent(sp.pi, as_Add=True)
    return rest, turns / sp.pi


class Circle:
    """Points of the unit circle modulo p, of which p + 1 is the order times a prime."""

    def __init__(self, p: int, order: int = ORDER) -> None:
        self.p, self.order, self.over = p, order, (p + 1) // order

    def point(self, angle: sp.Expr) -> Point:
        """Cosine and sine of an angle r + s·pi; sums of angles are products of their points."""
        radians, half_turns = split(angle)
        steps = half_turns * self.order / 2
        if not steps.is_Integer:
            radians, steps = radians + _PI * half_turns, sp.S.Zero
        quarters, steps = divmod(int(steps), self.order // 4)
        found = ((1, 0), (0, 1), (self.p - 1, 0), (0, self.p - 1))[quarters % 4]
        if steps:
            found = self._product(found, self._power(self._step, steps))
        if radians:
            exponent = int(radians.p) * pow(int(radians.q), -1, self.over) % self.over
            found = self._product(found, self._power(self._radian, exponent))
        return found

    def root(self, x: int) -> int | None:
        """The square root that is a square itself, or None."""
        found = pow(x, (self.p + 1) // 4, self.p)
        return found if (found * found - x) % self.p == 0 else None

    @cached_property
    def _step(self) -> Point:
        """2·pi/order: a point of this very order whose quarter turn is (0, 1) and whose surds are those of ``root``."""
        x = next(x for t in range(2, self.p) if self._is_step(x := self._some(t, self.over)))
        return x if self._power(x, self.order // 4) == (0, 1) else (x[0], self.p - x[1])

    def _is_step(self, x: Point) -> bool:
        if any(self._power(x, self.order // f) == (1, 0) for f in sp.primefactors(self.order)):
            return False
        a, b, c = (self._power(x, self.order * degrees // 360)[0] for degrees in (45, 30, 36))
        surds = 2 * a % self.p, 2 * b % self.p, (4 * c - 1) % self.p
        return surds == (self.root(2), self.root(3), self.root(5))

    @cached_property
    def _radian(self) -> Point:
        """One radian: another point for every prime, or rational numbers would seem to follow from it."""
        drawn = Random(self.p)
        return next(
            x for _ in range(self.p) if (x := self._some(drawn.randrange(2, self.p), self.order)) != (1, 0)
        )

    def _some(self, t: int, exponent: int) -> Point:
        """A power of the t-th point, ((1 − t²)/(1 + t²), 2t/(1 + t²))."""
        over = pow(1 + t * t, -1, self.p)
        return self._power(((1 - t * t) * over % self.p, 2 * t * over % self.p), exponent)

    def _product(self, a: Point, b: Point) -> Point:
        return (a[0] * b[0] - a[1] * b[1]) % self.p, (a[0] * b[1] + a[1] * b[0]) % self.p

    def _power(self, x: Point, exponent: int) -> Point:
        result = (1, 0)
        while exponent:
            if exponent & 1:
                result = self._product(result, x)
            x, exponent = self._product(x, x), exponent >> 1
        return result
