"""Compliances of absolute positions where the diagnosis found the geometry to be right: values, told with what they
rest on.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from symstiff.calibration.rows import predict
from symstiff.calibration.simulation import Effect, Truth, nominal_truth
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.growth import fit_told, grow
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance
from symstiff.robot import load
from tests.test_assemble import complete, design, measured, truth_of

SIGMA = 3e-5
TOLD = "told as far as the geometry is right"


def rocks() -> Truth:
    values = {"c": 4.0 * nominal_truth(load("ur10"))["k0_55"], "direction": [0.7, 0.4, 0.0], "height": 0.5}
    return truth_of("ur10", Effect("base_compliance", None, "rocking", values))


@cache
def rocking(poses: int) -> Measurements:
    """Loaded positions of a heavy UR10 whose base rocks."""
    table = measured(rocks(), design("ur10", "absolute", poses, (0.0, 0.4, 0.7, 1.0)))
    noise = SIGMA * np.random.default_rng(1).normal(size=table.values.shape)
    return replace(table, values=table.values + noise, sigma=np.full(table.values.shape, SIGMA))


def left(residual: np.ndarray) -> float:
    return float(np.sqrt(np.mean(residual**2)))


@pytest.mark.slow
def test_what_errors_of_all_frames_would_hide_has_a_value_where_the_geometry_is_right() -> None:
    """Zeros in its place leave several times the noise: the effect's block and all frames would hide a base's."""
    model = grow(complete("ur10"), [EffectInstance("base_compliance", {"link": 0}, {})])
    found = fit_told(model, rocking(25), trusted=True)
    beside = fit_told(model, rocking(25))
    assert left(found.residual) < 1.05 * SIGMA
    assert left(beside.residual) > 3.0 * SIGMA
    assert found.leaning
    assert set(found.leaning) <= set(beside.absorbed)
    assert not beside.leaning
    fresh = design("ur10", "deflection", 12, (0.5,))
    wanted = measured(rocks(), fresh).values[:, :3]
    assert left(predict(found.model, fresh)[:, :3] - wanted) < 0.05 * left(wanted)


@pytest.mark.slow
def test_a_diagnosis_writes_what_it_named_the_effect_beside() -> None:
    found = diagnose(Task(load("ur10"), rocking(15)))
    assert found.verdict == "named"
    assert [e.effect for e in found.effects] == ["base_compliance"]
    assert left(found.grown.residual) < 1.1 * SIGMA
    assert sum(TOLD in remark for remark in found.remarks) == 1
