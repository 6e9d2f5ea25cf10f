"""Units of parameters, as ``rad/(N*m)``: products and quotients of a few symbols, taken apart into SI base units."""

from __future__ import annotations

import re
from collections import Counter

_SYMBOLS = {
    "1": {}, "m": {"m": 1}, "rad": {"rad": 1}, "s": {"s": 1}, "kg": {"kg": 1}, "K": {"K": 1}, "degC": {"K": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
}  # fmt: skip
_FACTOR = re.compile(r"([*/]?)(?:\(([^()]+)\)|([A-Za-z1]+))(?:\^(-?[1-9]))?", re.ASCII)


def base_units(unit: str) -> dict[str, int]:
    """Exponents of the SI base units, from left to right: ``m/N/K`` is per N and per K.

    Raises ValueError for what is no product or quotient of m, rad, s, kg, K, degC, N and 1.
    """
    total, read = Counter[str](), 0
    while read < len(unit) or not unit:
        factor = _FACTOR.match(unit, read)
        if factor is None or bool(factor[1]) is not bool(read) or (factor[3] or "1") not in _SYMBOLS:
            raise ValueError(f"no unit: {unit!r}")
        power = int(factor[4] or 1) * (-1 if factor[1] == "/" else 1)
        parts = base_units(factor[2]) if factor[2] else _SYMBOLS[factor[3]]
        for symbol, exponent in parts.items():
            total[symbol] += power * exponent
        read = factor.end()
    return {symbol: exponent for symbol, exponent in total.items() if exponent}
