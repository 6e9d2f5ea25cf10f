"""What stands beside a verdict: loads outside a class, what poses share, what would have been seen."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.simulation.experiment import simulate
from symstiff.calibration.simulation.truth import truth_from_table
from symstiff.calibration.tables.measurements import concatenate, measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.otherwise import of_gain
from symstiff.discrepancy.findings.remarks import _of_approach, _of_rows, _of_succession
from symstiff.discrepancy.search.localise import FittedDevice
from symstiff.discrepancy.workflow import diagnose
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, load_model
from symstiff.reduction.reduce import reduce
from symstiff.report.words import sentence
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, measured


@pytest.fixture(scope="module")
def quiet() -> Finding:
    """An arm from which nothing is missing."""
    return diagnose(Task(load(ROBOT), measured()))


@pytest.fixture(scope="module")
def hardening() -> Finding:
    return diagnose(Task(load(ROBOT), measured(HARDENING)))


def test_what_would_have_been_seen_does_not_depend_on_what_was_named(
    quiet: Finding, hardening: Finding
) -> None:
    """The same poses and noise: what was named hides no other effect."""

    def sizes(found: Finding) -> dict[str, float]:
        return {
            f"{c.effect} {c.where}": e.value
            for c in found.last.candidates
            for e in list(c.smallest_detectable.values())[:1]
            if c.testable and c.effect in ("backlash", "force_sensor_bias", "base_compliance")
        }

    assert hardening.verdict == "named"
    before, after = sizes(quiet), sizes(hardening)
    both = [name for name in before if name in after and math.isfinite(before[name] + after[name])]
    assert len(both) >= 3
    for name in both:
        assert after[name] == pytest.approx(before[name], rel=0.3), name


@pytest.mark.parametrize("parameters", [20, 270])
def test_a_row_is_far_off_beside_the_noise_not_beside_residuals_that_many_parameters_make_small(
    quiet: Finding, parameters: int
) -> None:
    """Normal errors of 450 readings that a model of so many parameters leaves; then the largest becomes a slip."""
    view, rng = quiet.assembly.situation.view, np.random.default_rng(2)
    model = np.linalg.qr(rng.normal(size=(450, parameters)) * rng.choice([0.3, 3.0], size=(450, 1)))[0]
    errors = rng.normal(size=450)
    left = errors - model @ (model.T @ errors)
    noise = replace(quiet.last.noise, degrees_of_freedom=450.0 - parameters)

    def said(residual: np.ndarray) -> list[str]:
        step = replace(quiet.last.growth[-1], residual=2e-5 * residual)
        return _of_rows(view, replace(quiet.last, growth=(step,), noise=noise))

    slip = np.where(np.arange(450) == np.argmax(np.abs(left)), 10.0, left)
    assert not said(left)
    assert len(said(slip)) == 1


@pytest.mark.parametrize(
    ("place", "law", "told"),
    [
        ("force sensor", "gain*time", "all soften with the session"),
        ("force sensor", "gain*temperature", "all soften with the temperature"),
        ("force sensor axis 3", "gain", ""),
        ("reading of axis 3", "gain*load", ""),
    ],
)
def test_a_gain_of_all_loads_is_what_compliances_leave_that_change_alike(
    quiet: Finding, place: str, law: str, told: str
) -> None:
    last = replace(quiet.last, device_law=FittedDevice(place, ((law, 3.7, 0.5, "%"),), 0.07))
    assert [told in remark for remark in of_gain(measured(), last)] == [True] * bool(told)
    assert not of_gain(replace(measured(), kind="absolute"), last)


@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_readings_that_resemble_the_one_before_are_spoken_of(quiet: Finding, correlation: float) -> None:
    """Five loads in ten poses, three markers, three axes; each error holds a part of the one before."""
    view, rng = quiet.assembly.situation.view, np.random.default_rng(1)
    errors = rng.normal(size=(10, 5, 3, 3))  # pose, load, marker, axis
    for k in range(1, 5):
        errors[:, k] = correlation * errors[:, k - 1] + np.sqrt(1.0 - correlation**2) * errors[:, k]
    step = replace(quiet.last.growth[-1], residual=2e-5 * errors.reshape(-1))
    last = replace(quiet.last, verdict="unexplained", growth=(step,))
    remarks = _of_succession(view, last)
    assert len(remarks) == (correlation > 0)
    assert all("readings that follow each other in a pose are alike" in text for text in remarks)
    assert not _of_succession(view, replace(last, verdict="nothing_missing"))


def test_a_start_that_no_row_loads_is_diagnosed_all_the_same() -> None:
    """Joints with vertical axes under vertical loads, before a link that bends: poses left out are predicted too."""
    rng = np.random.default_rng(0)
    q = np.repeat(rng.uniform(-2.5, 2.5, (20, 2)), 2, axis=0)
    w = np.zeros((40, 6))
    w[:, 2] = np.tile([-100.0, -200.0], 20)
    soft = {"start": "zero", "c1": 1e-6, "c2": 1e-6, "k1_33": 2e-6, "k1_55": 1e-6}
    table = {"format": 1, "robot": ROBOT, "compliance": soft, "noise": {"sigma_mm": 0.01}}
    found = diagnose(
        Task(load(ROBOT), simulate(truth_from_table(table), measurements(q, w), 3), "joints", loads="force")
    )
    assert [(e.effect, e.where) for e in found.effects] == [("link_compliance", {"link": 1})]
    assert any("2 of the start model's 2 parameters are not determined" in r for r in found.remarks)
    assert found.rms.held_out_after == pytest.approx(1e-5, rel=0.3)


@pytest.mark.slow
def test_loads_outside_a_start_models_class_are_told() -> None:
    narrow = StiffnessModel.of(reduce(load(ROBOT), "gravity", "position"))
    found = diagnose(Task(load(ROBOT), measured(), start=narrow))
    assert any("reduced for gravity loads (fz), and these have fx, fy too" in r for r in found.remarks)
    assert not any("reduced for" in r for r in diagnose(Task(load(ROBOT), measured())).remarks)


@pytest.mark.parametrize(
    ("anew", "told"),
    [
        (None, "approach some poses anew"),
        (0.9, "another one in every repeat, so it is the robot's repeatability"),
        (0.1, "the same in every repeat, so it is not the robot's repeatability"),
    ],
)
def test_repeats_tell_whether_a_shared_error_is_the_robots_repeatability(
    quiet: Finding, anew: float | None, told: str
) -> None:
    noise = replace(quiet.last.noise, approach=2.0 * quiet.last.noise.sigma, anew=anew)
    (said,) = _of_approach(measured(), replace(quiet.last, noise=noise))
    assert told in said
    assert ("approach some poses anew" in said) == (anew is None)


@pytest.mark.slow
@pytest.mark.parametrize("own", [True, False])
def test_the_part_of_a_shared_error_that_each_repeat_has_alone_is_found(own: bool) -> None:
    rng = np.random.default_rng(7)
    errors = 1e-4 * rng.normal(size=(2, 10, 3))
    tables = []
    for k, table in enumerate((measured(seed=3), measured(seed=4))):
        values = table.values.copy()
        values[:, :3] += errors[k if own else 0][table.pose]
        tables.append(replace(table, values=values, repeat=np.full(len(table), float(k))))
    table = concatenate(tables)
    assert len(table.labels) == 10
    anew = diagnose(Task(load(ROBOT), table)).last.noise.anew
    assert anew is not None
    assert (anew > 0.5) == own


def test_a_model_file_that_lacks_a_value_is_no_model_of_a_parameter_that_is_zero(tmp_path: Path) -> None:
    model = StiffnessModel.of(reduce(load(ROBOT), "force", "position"))
    model = model.with_values(dict.fromkeys(model.parameters, 1e-6))
    model.save(tmp_path / "m.toml")
    name = model.parameters[1]
    lines = (tmp_path / "m.toml").read_text().splitlines()
    values = lines.index("[values]")
    del lines[next(k for k in range(values, len(lines)) if lines[k].startswith(f"{name} = "))]
    (tmp_path / "less.toml").write_text("\n".join(lines) + "\n")
    with pytest.raises(UserError, match=f"values: {name} has none"):
        load_model(tmp_path / "less.toml")


def test_a_gap_is_held_against_the_rows_own_noise_where_poses_share_more_than_that(
    hardening: Finding,
) -> None:
    """What poses share may be what is missing: it is no noise to be content with."""
    noise = replace(hardening.last.noise, sigma=2e-5, approach=1.7e-4)
    other = replace(hardening, last=replace(hardening.last, noise=noise))
    assert "(noise 0.020 mm, and 0.170 mm that a pose's rows share)" in sentence(other)
    assert "rows share" not in sentence(hardening)
