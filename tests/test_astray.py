"""Effects whose sizes go far beyond their physical range once all parameters are identified jointly."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from symstiff.discrepancy import conclusion
from symstiff.discrepancy.bridge.ranges import Extent
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.findings.result import Found
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load
from symstiff.robot.schema import Robot
from tests.diagnosis_data import HARDENING, ROBOT, measured


@pytest.mark.parametrize("left", [True, False])
def test_what_else_accounts_for_the_data_takes_the_place(left: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing else does, nothing is named."""

    def told(effects: Sequence[Found], robot: Robot, extent: Extent) -> bool:
        return any(e.effect == "nonlinear_stiffness" or not left for e in effects)

    table = measured(HARDENING | {"a": 6e-5})
    assert diagnose(Task(load(ROBOT), table)).effects[0].effect == "nonlinear_stiffness"
    monkeypatch.setattr(conclusion, "astray", told)
    stages: list[str] = []
    found = diagnose(Task(load(ROBOT), table), stages.append)
    assert "without what goes astray" in stages
    assert all(e.effect != "nonlinear_stiffness" for e in found.effects)
    if left:
        assert found.effects
        reasons = {c.effect: c.reason for c in found.last.candidates if dict(c.where) == {"joint": 2}}
        assert "far beyond the physical range" in reasons["nonlinear_stiffness"]
    else:
        assert found.verdict == "unexplained"
        assert "far beyond its physical range" in found.reason
