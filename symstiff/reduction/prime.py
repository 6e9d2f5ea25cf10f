"""Exact arithmetic for the structural engine: programs evaluated, and matrices reduced, modulo a prime.

Random residues stand for joint variables and loads; a point of the unit circle gives an exact sine/cosine pair: a
random one for a joint that moves, for a fixed angle one that keeps every identity among the angles. A rank found so is
exact but for a chance of about (degree / prime). A function that no field knows (tanh, sign, …) is a random oracle:
independent of everything but its argument, with the function's symmetry about zero and its value there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import sympy as sp

from symstiff.reduction.circle import ORDER, Circle, primes, split
from symstiff.symbolic.program import Constant, walk

# 4k + 3: −1 has no square root, so that 1 + t² never vanishes and every t is a point of the circle.
PRIMES = primes(ORDER)
ODD = frozenset({"sin", "tan", "tanh", "sinh", "atan", "asin", "sign"})
AT_ZERO = {"cos": 1, "cosh": 1, "Abs": 0}
"""Even functions, and what they are at zero."""
PI = sp.Rational(5419351, 1725033)  # within 1e-13; a length may be a multiple of pi
Residues = Any  # an int, or an int64 array (N,)


@dataclass(frozen=True)
class Angle:
    """An angle modulo a prime: a value for polynomials, a point of the unit circle for trigonometry.

    exact: its value where it is known; a random angle has none.
    """

    value: Residues
    cosine: Residues
    sine: Residues
    exact: sp.Expr | None = None


class Number(int):
    """A rational's residue that remembers the rational, in case it is added to an angle."""

    exact: sp.Rational


class PrimeAlgebra:
    """Residues modulo a prime below 2³¹; products fit 64 bits. ``order``: fixed angles are multiples of 2·pi/order."""

    def __init__(self, prime: int, order: int = ORDER) -> None:
        self.p, self.circle = prime, Circle(prime, order)

    def random(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Uniform non-zero residues (n,)."""
        return rng.integers(1, self.p, n, dtype=np.int64)

    def random_angle(self, rng: np.random.Generator, n: int) -> Angle:
        """Random points of the unit circle (n,): ((1−t²)/(1+t²), 2t/(1+t²))."""
        t = self.random(rng, n)
        return Angle(self.random(rng, n), *self._circle(t))

    def _circle(self, t: Residues) -> tuple[Residues, Residues]:
        square = t * t % self.p
        over = self._inverse((1 + square) % self.p)
        return (1 - square) * over % self.p, 2 * t % self.p * over % self.p

    def _inverse(self, x: Residues) -> Residues:
        if isinstance(x, int):
            return pow(x, -1, self.p)
        return np.array([pow(int(v), -1, self.p) if v else 0 for v in x], dtype=np.int64)

    def fixed_angle(self, value: sp.Expr) -> Angle:
        """An angle of known value r + s·pi."""
        rest, half_turns = split(value)
        return Angle(int(self.number(rest + half_turns * PI)), *self.circle.point(value), value)

    def number(self, value: sp.Expr) -> Any:
        """A rational's residue; a multiple of pi is an angle, any other number an oracle."""
        if value.is_Float:
            value = sp.Rational(value)
        if not value.is_Rational:
            return self.fixed_angle(value) if value.has(sp.pi) else self._oracle(str(value), [])
        number = Number(int(value.p) * pow(int(value.q), -1, self.p) % self.p)
        number.exact = value
        return number

    def constant(self, constant: Constant) -> int:
        """The cosine of the constant's angle; any other constant is a product of fractions and their roots."""
        if constant.turn is not None:
            return self.circle.point(constant.turn)[0]
        return int(walk(constant.exact, {}, self))

    def sum(self, terms: Sequence[tuple[int, Any]]) -> Any:
        """Σ ±x; angles and known numbers add up to an angle, with anything else among them to its value."""
        angles = any(isinstance(x, Angle) for _, x in terms)
        if angles and all(isinstance(x, Angle | Number) for _, x in terms):
            return self._angle_sum(terms)
        total = 0
        for sign, x in terms:
            x = x.value if isinstance(x, Angle) else x
            total = total + x if sign > 0 else total - x
        return total % self.p

    def _angle_sum(self, terms: Sequence[tuple[int, Angle | Number]]) -> Angle:
        value: Residues = 0
        c: Residues = 1
        s: Residues = 0
        exact: sp.Expr | None = sp.S.Zero
        for sign, x in terms:
            angle = x if isinstance(x, Angle) else self.fixed_angle(x.exact)
            xs = angle.sine if sign > 0 else -angle.sine
            value = (value + sign * angle.value) % self.p
            c, s = (
                (c * angle.cosine - s * xs % self.p) % self.p,
                (s * angle.cosine % self.p + c * xs) % self.p,
            )
            exact = None if exact is None or angle.exact is None else exact + sign * angle.exact
        return Angle(value, c, s, exact)

    def product(self, factors: Sequence[Any]) -> Any:
        """Π x; a multiple of pi, and a whole multiple of an angle, stay angles."""
        angles = [x for x in factors if isinstance(x, Angle)]
        numbers = [x.exact for x in factors if isinstance(x, Number)]
        if len(factors) == 2 and angles and numbers:
            (angle,), (times,) = angles, numbers
            if angle.exact == sp.pi:
                return self.fixed_angle(times * sp.pi)
            if times.is_Integer and 0 < times < 1000:
                return self._angle_sum([(1, angle)] * int(times))
        total = 1
        for x in factors:
            total = total * (x.value if isinstance(x, Angle) else x) % self.p
        return total

    def power(self, base: Any, exponent: sp.Expr) -> Any:
        """Whole powers, and roots of fractions that have one; others are oracles."""
        if isinstance(base, Number) and abs(exponent) == sp.S.Half:
            root = self.circle.root(int(base))
            if root is not None:
                return root if exponent > 0 else self._inverse(root)
        x = base.value if isinstance(base, Angle) else base
        if not exponent.is_Integer:
            root = self._oracle(f"power{exponent}", [x])
            return root * (x != 0) if exponent > 0 else root
        if exponent < 0:
            x = self._inverse(x)
        result: Any = 1
        for _ in range(abs(int(exponent))):
            result = result * x % self.p
        return result

    def call(self, function: str, arguments: Sequence[Any]) -> Any:
        """Sine and cosine of angles exactly; any other function as an oracle, odd or even where it is that."""
        x = arguments[0]
        if function in ("sin", "cos") and isinstance(x, Angle):
            return x.cosine if function == "cos" else x.sine
        values = [a.value if isinstance(a, Angle) else a for a in arguments]
        if function not in ODD and function not in AT_ZERO:
            found = self._oracle(function, values)
            return found * (values[0] != 0) + (values[0] == 0) if function == "exp" else found
        x = values[0] % self.p
        negative = 2 * x > self.p
        found = self._oracle(function, [negative * (self.p - x) + (1 - negative) * x]) * (x != 0)
        if function in AT_ZERO:
            return found + AT_ZERO[function] * (x == 0)
        return (1 - 2 * negative) * found % self.p

    def _oracle(self, name: str, arguments: Sequence[Any]) -> Any:
        """A value that depends on name and arguments as a random function would."""
        state: Any = sum(ord(c) * 257**k for k, c in enumerate(name)) % self.p
        for x in arguments:
            for _ in range(4):
                state = (state * state % self.p * state + x + 1_234_567) % self.p
        return state


def echelon(matrix: np.ndarray, prime: int) -> tuple[np.ndarray, list[int]]:
    """Reduced row echelon form modulo a prime: its non-zero rows, and the pivot columns."""
    m = matrix % prime
    pivots: list[int] = []
    row = 0
    for column in range(m.shape[1]):
        if row == m.shape[0]:
            break
        nonzero = np.flatnonzero(m[row:, column])
        if nonzero.size == 0:
            continue
        chosen = row + int(nonzero[0])
        if chosen != row:
            m[[row, chosen]] = m[[chosen, row]]
        m[row] = m[row] * pow(int(m[row, column]), -1, prime) % prime
        others = np.flatnonzero(m[:, column])
        others = others[others != row]
        m[others] = (m[others] - m[others, column][:, None] * m[row]) % prime
        pivots.append(column)
        row += 1
    return m[:row], pivots


def rational(residue: int, modulus: int) -> Fraction | None:
    """The fraction of small numerator and denominator with this residue (lattice reduction), or None."""
    bound = int(sp.integer_nthroot(modulus // 2, 2)[0])
    r0, r1, s0, s1 = modulus, residue % modulus, 0, 1
    while r1 > bound:
        quotient = r0 // r1
        r0, r1, s0, s1 = r1, r0 - quotient * r1, s1, s0 - quotient * s1
    if s1 == 0 or abs(s1) > bound:
        return None
    return Fraction(r1, s1)
