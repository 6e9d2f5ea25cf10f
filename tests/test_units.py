"""Units of parameters are taken apart into SI base units, whichever way they are written."""

from __future__ import annotations

import pytest

from symstiff.effects.units import base_units

UNITS = [
    ("rad/(N*m)", {"rad": 1, "kg": -1, "m": -2, "s": 2}),
    ("m/N", {"kg": -1, "s": 2}),
    ("1", {}),
    ("m/m", {}),
    ("N", {"kg": 1, "m": 1, "s": -2}),
    ("rad/(N*m)^2", {"rad": 1, "kg": -2, "m": -4, "s": 4}),
    ("rad/(N*m)^3", {"rad": 1, "kg": -3, "m": -6, "s": 6}),
    ("m/N^3", {"kg": -3, "m": -2, "s": 6}),
    ("1/N^2", {"kg": -2, "m": -2, "s": 4}),
    ("m/N/K", {"kg": -1, "s": 2, "K": -1}),
    ("m/degC", {"m": 1, "K": -1}),
    ("(N*m)^2/rad", {"kg": 2, "m": 4, "s": -4, "rad": -1}),
    ("rad/N^-1", {"rad": 1, "kg": 1, "m": 1, "s": -2}),
    ("m/s*s", {"m": 1}),
    ("rad/(m/s)", {"rad": 1, "m": -1, "s": 1}),
]


@pytest.mark.parametrize(("unit", "base"), UNITS)
def test_units_are_taken_apart(unit: str, base: dict[str, int]) -> None:
    assert base_units(unit) == base


@pytest.mark.parametrize(
    "unit",
    ["", "m/(N*m", "furlong", "m/", "*m", "m m", "m^0", "()", "((m))", "mm", "m)", "m/N\n", "N·m", "m^"],
)
def test_what_is_no_unit_is_refused(unit: str) -> None:
    with pytest.raises(ValueError, match="no unit"):
        base_units(unit)
