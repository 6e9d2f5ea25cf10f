"""Poses that are measured under one load each: what is not linear in the load shows between them."""

from __future__ import annotations

import pytest

from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured

BIAS = {"effect": "force_sensor_bias", "shape": "constant", "bias": [1.5, -1.0, 0.0, 0.0, 0.0, 0.5]}
GEAR = {"effect": "backlash", "where": {"joint": 2}, "shape": "tanh", "gap": 4e-4, "knee": 0.5}


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [HARDENING, BIAS, GEAR], ids=lambda h: h["effect"])
def test_what_is_not_linear_in_the_load_is_named_from_poses_of_one_load_each(
    hidden: dict[str, object],
) -> None:
    found = diagnose(Task(load(ROBOT), measured(hidden, poses=40, levels=(1.0,))))
    assert found.verdict == "named"
    assert [e.effect for e in found.named] == [hidden["effect"]]
    assert found.named[0].where.get("joint") == dict(hidden.get("where", {})).get("joint")


def test_poses_of_one_load_each_raise_no_alarm() -> None:
    assert diagnose(Task(load(ROBOT), measured(poses=40, levels=(1.0,)))).verdict == "nothing_missing"
