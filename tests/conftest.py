"""Robots that several test files share."""

from __future__ import annotations

import os
from typing import Any

import pytest

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")  # before NumPy: pytest-xdist has a process for every core already

from symstiff.robot import Robot, from_table  # noqa: E402


@pytest.fixture(scope="session")
def odd3r() -> Robot:
    """Nothing parallel: odd angles and offsets, inclined beams, a turned base and tool."""
    return from_table(odd3r_table())


def odd3r_table() -> dict[str, Any]:
    rows = [
        {"a": 0.3, "alpha": "pi/6", "d": 0.2, "theta": "pi/3", "link": {"beam_axis": [0.35, 0, 0.675]}},
        {"a": -0.1, "alpha": "pi", "d": 0, "theta": 0, "link": {"beam_axis": [0, 0.6, 0.8]}},
        {"a": 0.25, "alpha": "-pi/2", "d": -0.15, "link": {"beam_axis": [0, 0, -1]}},
    ]
    return {
        "format": 1,
        "name": "odd3r",
        "base": {"xyz": [0.1, 0, 0.5], "rpy": ["pi/6", 0, "pi/4"], "link": {"beam_axis": "z"}},
        "joint": rows,
        "tool": {"xyz": [0.05, -0.1, 0.3], "rpy": ["pi/3", "pi/2", 0]},
    }
