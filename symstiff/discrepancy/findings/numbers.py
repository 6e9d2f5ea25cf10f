"""Numbers in words: quantities with units and deviations, p-values, shares."""

from __future__ import annotations

import math
from dataclasses import replace

from symstiff.discrepancy.findings.result import Quantity
from symstiff.display import unit_text

_SHOWN = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "1": ("", 1.0)}
_ALIKE, _APART = 10.0, 3.0
"""Ratio up to which two sizes are alike, and units of the last digit by which they have to differ as they are shown."""
_SUPER = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 3) -> str:
    """A number with a minus sign and powers of ten as superscripts: ``−1.44·10⁻⁷``."""
    if not math.isfinite(value):
        return "∞"
    return ("−" if value < 0 else "") + _size(abs(value), digits)


def _size(value: float, digits: int) -> str:
    if value == 0 or 1e-2 <= value < 1e5:
        kept = float(f"{value:.{digits}g}")
        if kept < 1e5:
            return f"{kept:.0f}" if kept >= 10**digits else f"{value:.{digits}g}"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa}·10{str(int(exponent)).translate(_SUPER)}"


def milli(value: float) -> str:
    """A length [m] or an angle [rad] in thousandths: three decimals, or two digits where these would show nothing."""
    return f"{1e3 * value:.3f}" if value == 0 or abs(value) >= 1e-5 else f"{1e3 * value:.2g}"


def decimals_between(first: float, last: float) -> int | None:
    """Decimals that tell what lies between two lengths [m] or angles [rad] in thousandths, with four digits at most.

    None where nothing lies between them, or they are not alike, so that each tells enough by itself.
    """
    low, high = sorted((1e3 * first, 1e3 * last))
    if low == high or not 0.0 < high <= _ALIKE * low:
        return None
    most = max(3 - math.floor(math.log10(high)), 0)
    least = min(max(3, 1 - math.floor(math.log10(low))), most)
    return next((d for d in range(least, most) if (high - low) * 10**d >= _APART), most)


def quantity(estimate: Quantity) -> str:
    """A value with its standard deviation and unit: ``(1.44 ± 0.10)·10⁻⁷ rad/(N·m)``; its range in other shapes."""
    if estimate.across is not None:
        return f"{quantity(replace(estimate, across=None))}{_across(estimate, *estimate.across)}"
    unit, factor = _SHOWN.get(estimate.unit, (unit_text(estimate.unit), 1.0))
    value, std = factor * estimate.value, factor * estimate.std
    if not math.isfinite(std):
        return f"{number(value)} {unit}".strip() + " (not determined apart from others)"
    if std == 0 or not math.isfinite(value):
        return f"{number(value)} {unit}".strip()
    largest = max(abs(value), std)
    exponent = 0 if 1e-2 <= largest < 1e4 else math.floor(math.log10(largest))
    decimals = max(0, min(6, 1 - math.floor(math.log10(std / 10**exponent))))
    text = f"{value / 10**exponent:.{decimals}f} ± {std / 10**exponent:.{decimals}f}".replace("-", "−")
    if exponent:
        return f"({text})·10{str(exponent).translate(_SUPER)} {unit}".strip()
    return f"{text} {unit}".strip()


def _across(estimate: Quantity, low: float, high: float) -> str:
    """The range of a size in all shapes that account for the data as well."""
    factor = _SHOWN.get(estimate.unit, ("", 1.0))[1]
    least, most = number(factor * low), number(factor * high)
    if low > estimate.value - estimate.std:
        told = f"up to {most}"
    else:
        told = f"{least} to {most}" if high > estimate.value + estimate.std else f"down to {least}"
    return f", {told} in other shapes that fit as well"


def size_text(estimate: Quantity) -> str:
    """A smallest detectable size."""
    unit, factor = _SHOWN.get(estimate.unit, (unit_text(estimate.unit), 1.0))
    return f"{number(factor * estimate.value)} {unit}".strip() if math.isfinite(estimate.value) else "never"


def p_text(p: float) -> str:
    """A p-value; no tail is known beyond sixteen digits."""
    return f"{p:.2g}" if p >= 1e-4 else f"< 10{str(math.ceil(math.log10(max(p, 1e-16)))).translate(_SUPER)}"


def p_equals(p: float) -> str:
    """The same with its sign: ``p = 0.02``, ``p < 10⁻⁸``."""
    text = p_text(p)
    return f"p {text}" if text.startswith("<") else f"p = {text}"


def percent(share: float) -> str:
    """A share as a percentage: two digits below ten."""
    return f"{100 * share:.0f} %" if share >= 0.0995 else f"{100 * share:.2g} %"
