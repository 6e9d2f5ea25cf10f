"""What positions without a load leave of a model: its code, as far as joints and links have laws without any load."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Noise, Truth, simulate
from symstiff.calibration.simulation.truth import Device
from symstiff.calibration.tables.measurements import measurements
from symstiff.compensation import compensate
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.report.folder import write_report
from symstiff.robot import load

ROBOT = load("kuka_kr270")
OFFSET = 1.2e-3


@cache
def diagnosed(offset: float = 0.0) -> Finding:
    """Of unloaded positions of an arm whose file tells no masses: nothing shows its compliances."""
    rng = np.random.default_rng(8)
    limits = np.array([j.range for j in ROBOT.joint])
    q = rng.uniform(limits[:, 0], limits[:, 1], (30, ROBOT.dof))
    plan = measurements(q, np.zeros((30, 6)), kind="absolute")
    place = Device((3.0, 1.0, 0.5), (0.0, 0.0, 2.0))
    effects = (Effect("joint_offset", {"joint": 3}, "constant", {"offset": offset}),) if offset else ()
    table = simulate(Truth(ROBOT, {}, effects, Noise((0.02,) * 3), device=place), plan, 8)
    return diagnose(Task(ROBOT, table, "joints"))


@pytest.mark.slow
def test_an_error_without_a_load_has_code_though_no_compliance_is_told(tmp_path: Path) -> None:
    found = diagnosed(OFFSET)
    assert [(e.effect, e.where) for e in found.named] == [("joint_offset", {"joint": 3})]
    code = write_report(found, tmp_path / "report").verdict["code"]
    assert code["folder"]
    assert code["text"].endswith("all compliances are zero: it bends under no load")
    folder = tmp_path / "report" / "code"
    assert "joint_offset_3_offset" in (folder / "kuka_kr270.h").read_text()
    assert "All compliances are zero: nothing bends under loads." in (folder / "README.md").read_text()


def test_where_nothing_has_a_value_there_is_no_code(tmp_path: Path) -> None:
    code = write_report(diagnosed(), tmp_path / "report").verdict["code"]
    assert not code["folder"]
    assert "do not determine any compliance, nor any law of joints or links" in code["text"]


def test_compensation_under_loads_says_that_nothing_bends() -> None:
    model = diagnosed(OFFSET).model
    q = np.array([[0.1, -0.9, 1.2, 0.3, 0.5, 0.0]])
    (remark,) = compensate(model, q, np.array([[0.0, 0.0, -2000.0, 0.0, 0.0, 0.0]])).remarks
    assert remark.startswith("all compliances of the model are zero")
    assert compensate(model, q, np.zeros((1, 6))).remarks == ()
