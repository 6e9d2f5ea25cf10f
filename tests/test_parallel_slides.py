"""Absolute positions of a telescope: of two parallel slides a link's weight moves the first alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import Truth, clean_response
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.robot import Robot
from symstiff.robot.loading import from_table

SIGMA = 1e-6
VALUES = {"c1": 1e-6, "c2": 1e-7, "c3": 3e-7}


def telescope(template: str) -> Robot:
    slide = {"type": "prismatic", "a": 0, "alpha": 0, "d": 0.3, "limits": [0, 0.3]}
    table: dict[str, Any] = {
        "format": 1, "name": "tele", "tool": {"xyz": [0.1, 0, 0.2]},
        "base": {"xyz": [0, 0, 1], "rpy": ["pi/2", 0, 0], "link": {"template": "rigid"}},
        "joint": [
            {"a": 0, "alpha": "pi/2", "d": 0, "link": {"template": "rigid", "mass": 5.0}},
            {**slide, "link": {"template": template, "mass": 200.0}},
            {**slide, "link": {"template": "rigid", "mass": 100.0}},
        ],
    }  # fmt: skip
    return from_table(table, "tele")


def experiment(robot: Robot) -> Measurements:
    rng = np.random.default_rng(2)
    q = np.column_stack([rng.uniform(-1.2, 1.2, 30), rng.uniform(0, 0.3, (30, 2))])
    force = rng.uniform(-250, 250, (30, 3))
    q, w = np.repeat(q, 2, axis=0), np.zeros((60, 6))
    w[1::2, :3] = force
    units = ["rad", "m", "m"]
    read = clean_response(Truth(robot, VALUES), q, w, {"kind": "absolute"})
    read += SIGMA * rng.normal(size=read.shape)
    read[:, 3:] = np.nan
    sigma = np.where(np.isfinite(read), SIGMA, np.nan)
    pose = np.repeat(np.arange(30), 2)
    return measurements(q, w, values=read, sigma=sigma, pose=pose, kind="absolute", joint_units=units)


@pytest.mark.parametrize("start", ["joints", "complete"])
def test_the_sum_that_loads_show_is_found_beside_the_part_that_weights_show(start: str) -> None:
    robot = telescope("rigid")
    found = identify(robot, experiment(robot), start)
    assert found.model.parameters == ("c1", "c2")
    assert found.model.values["c2"] == pytest.approx(4e-7, rel=0.02)
    assert found.fit.fit_p is not None
    assert found.fit.fit_p > 1e-3
    assert any("what only the links' weights show: c3" in r for r in found.remarks)
    unit = dict(zip(found.fit.names, found.fit.units, strict=True))["c3"]
    assert unit == "m/N"
