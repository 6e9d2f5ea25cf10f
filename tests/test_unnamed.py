"""What the catalogue does not hold: markers, devices and joints that remember are accused, not misnamed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.measurements import Measurements
from symstiff.discrepancy.assemble import assemble
from symstiff.discrepancy.laws import _lagging
from symstiff.discrepancy.localise import FittedLaw
from symstiff.discrepancy.result import Rms
from symstiff.discrepancy.situation import look
from symstiff.discrepancy.workflow import Finding, Task, run, unconfirmed
from symstiff.report import words
from symstiff.robot import load
from symstiff.robot.schema import Marker
from tests.diagnosis_data import ROBOT, design, measured
from tests.test_assemble import complete, truth_of
from tests.test_assemble import design as experiment
from tests.test_assemble import measured as exact


def _diagnosed(table: Measurements) -> Finding:
    return run(Task(load(ROBOT), table))


def _share(table: Measurements) -> np.ndarray:
    size = np.linalg.norm(table.w, axis=1)
    return np.asarray(size / size.max())


def test_a_marker_that_gives_way_is_accused_with_its_size() -> None:
    table = measured()
    values = table.values.copy()
    values[:, :3] += 1e-4 * (table.point == 1)[:, None] * _share(table)[:, None] * [1.0, -0.5, 0.2]
    found = _diagnosed(replace(table, values=values))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "marker p2"
    assert [value for _, value, _ in law.terms] == pytest.approx([1e-4, -0.5e-4, 0.2e-4], abs=1.5e-5)
    assert "marker p2" in words.sentence(found)
    assert "mm)" in words.device_text(law)


def test_a_force_sensor_that_reads_too_little_at_large_loads_is_accused() -> None:
    truth = design()
    share = np.linalg.norm(truth.w, axis=1) / np.linalg.norm(truth.w, axis=1).max()
    table = replace(measured(), w=truth.w / (1.0 + 0.2 * share)[:, None])
    found = _diagnosed(table)
    assert found.verdict == "unexplained"
    assert found.last.localisation is not None
    assert found.last.localisation.accused.startswith("force sensor")
    assert "%" in words.sentence(found)


def test_a_marker_that_sits_elsewhere_moves_with_the_tool() -> None:
    """Against the offset of a robot file that has the marker at the other place."""
    robot, table = load("ur10"), experiment("ur10", "absolute")
    found = assemble(complete("ur10"), exact(truth_of("ur10"), table), effects=())
    shift = np.array([2e-3, -1e-3, 3e-3])
    moved = [
        m
        if m.name != "p2"
        else Marker(name="p2", xyz=[str(float(x) + d) for x, d in zip(m.xyz, shift, strict=True)])
        for m in robot.marker
    ]
    other = robot.model_copy(update={"marker": tuple(moved)})
    expected = look(other, table).offset - look(robot, table).offset
    view = found.situation.view
    block = found.problem.device["marker p2", "shift in the tool's axes"]
    assert block @ shift == pytest.approx((expected @ view.turn.T)[view.state, view.component], abs=1e-9)
    assert np.any(expected[table.point == 1])


def test_a_load_that_is_followed_late_rises_as_an_exponential() -> None:
    clock = np.linspace(0.0, 1.0, 400)
    assert _lagging(clock, np.ones(400), 0.2) == pytest.approx(1.0 - np.exp(-clock / 0.2), abs=1e-12)


def test_small_coefficients_are_not_rounded_away() -> None:
    law = FittedLaw("joint 1", "+2.25e-05*sin(q2) -7e-06*tau*cos(q2)", 10.0, 0.5, 0.4, np.zeros(1))
    text = words.law_text(_diagnosed(measured()), law)
    assert "0.0225·sin(q2)" in text
    assert "0.007·t·cos(q2)" in text


def test_what_unused_poses_predict_no_better_is_unconfirmed() -> None:
    assert unconfirmed(Rms(4.0, 3.0, 4.0, 4.1, 3.0))
    assert not unconfirmed(Rms(4.0, 3.0, 4.0, 3.5, 3.0))
    assert not unconfirmed(Rms(4.0, 4.0, 4.0, 4.0, 3.0))
    assert not unconfirmed(Rms(4.0, 3.0, None, None, 3.0))
