"""Units of table headers: what a quantity may be given in, and the factor to SI."""

from __future__ import annotations

import re
from dataclasses import dataclass

_DEGREE = 0.017453292519943295

FACTORS: dict[str, dict[str, float]] = {
    "angle": {"rad": 1.0, "mrad": 1e-3, "urad": 1e-6, "deg": _DEGREE},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    "force": {"N": 1.0, "kN": 1e3},
    "moment": {"N*m": 1.0, "kN*m": 1e3, "N*mm": 1e-3},
    "time": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "temperature": {"degC": 1.0, "K": 1.0},
}
LARGEST_LOAD = 1e7  # N, N*m; more is no load a robot carries
KELVIN = 273.15  # zero of degC; temperatures are kept in degC

_SPELLINGS = {
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "radian": "rad",
    "radians": "rad",
    "°C": "degC",
    "C": "degC",
    "µm": "um",
    "μm": "um",
    "µrad": "urad",
    "μrad": "urad",
    "Nm": "N*m",
    "N·m": "N*m",
    "N.m": "N*m",
    "N m": "N*m",
    "kNm": "kN*m",
    "kN·m": "kN*m",
    "Nmm": "N*mm",
    "N·mm": "N*mm",
}
_HEADER = re.compile(r"^([^\[\]]*?)\s*(?:\[([^\[\]]*)\])?$")


@dataclass(frozen=True)
class Header:
    """A column's name and the unit in its brackets (None without brackets)."""

    name: str
    unit: str | None


def parse_header(text: str) -> Header | None:
    """Split ``name[unit]``; None where the brackets do not match."""
    match = _HEADER.match(text.strip())
    if match is None:
        return None
    name, unit = match.group(1).strip(), match.group(2)
    return Header(name, None if unit is None else _SPELLINGS.get(unit.strip(), unit.strip()))


def dimensions(unit: str) -> tuple[str, ...]:
    """Return the kinds of quantity that ``unit`` measures: ("length",) for mm, () for an unknown unit."""
    return tuple(kind for kind, factors in FACTORS.items() if unit in factors)
