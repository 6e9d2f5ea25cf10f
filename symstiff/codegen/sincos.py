"""Sine and cosine as polynomials that compilers vectorise: Cody-Waite reduction by π/2, then near-minimax polynomials.

The coefficients are Remez fits on \\|r\\| ≤ π/4, weighted for relative error (2^-57.9 and 2^-63.9 in double, 2^-37.5
and 2^-42.9 in float), then rounded. A test measures the stated bounds against values with many digits.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Sincos:
    """Constants of one precision.

    split: π/2 in parts of which all but the last leave room for a whole multiple; domain: largest argument [rad] for
    which these multiples are exact; reach: largest joint variable of the vectorised code; ulp: bound on the error of
    sine and cosine in units in the last place, for arguments up to ``reach``; sine, cosine: (sin r - r)/r³ and
    (cos r - 1 + r²/2)/r⁴ in powers of r²; shift: adding and subtracting it rounds to a whole number.
    """

    split: tuple[float, ...]
    domain: float
    reach: float
    ulp: float
    sine: tuple[float, ...]
    cosine: tuple[float, ...]
    shift: float


DOUBLE = Sincos(
    split=(1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21),
    domain=1.6e6,
    reach=1000.0,
    ulp=1.6,
    sine=(
        -0.1666666666666663, 0.008333333333322108, -0.0001984126982958009, 2.7557313618003698e-06,
        -2.5050747217399998e-08, 1.58961976436535e-10,
    ),
    cosine=(
        0.041666666666666595, -0.001388888888887304, 2.4801587288841417e-05, -2.755731417624421e-07,
        2.087570041660522e-09, -1.1358513977707462e-11,
    ),
    shift=6755399441055744.0,
)  # fmt: skip

FLOAT = Sincos(
    split=(1.5703125, 0.0004837513, 7.5495336e-08, 2.563344e-12),
    domain=1.2e4,
    reach=100.0,
    ulp=1.6,
    sine=(-0.16666667, 0.008333329, -0.00019839311, 2.718114e-06),
    cosine=(0.041666668, -0.0013888883, 2.479946e-05, -2.7205684e-07),
    shift=12582912.0,
)
