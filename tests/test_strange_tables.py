"""Tables that are odd without being wrong, and wrong ones that look like effects: what a diagnosis says of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.calibration.identify import identify
from symstiff.calibration.rows import predict
from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, concatenate, measurements
from symstiff.discrepancy.apart.deciding import setups_like
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.out_of_range import astray
from symstiff.discrepancy.findings.remarks import remarked
from symstiff.discrepancy.findings.result import Found, Quantity
from symstiff.discrepancy.reasons import Why
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.report.html import _unnamed
from symstiff.report.words import headline, sentence
from symstiff.robot import load
from symstiff.symbolic.terms import TIME
from tests.diagnosis_data import HARDENING, ROBOT, design, measured, saved


def read(effect: Effect | None = None, start: float = 0.0, poses: int = 12) -> Measurements:
    """What a tracker reads of the planar arm, up and down again in every pose, with a clock."""
    robot, table = load(ROBOT), design(poses, (0.25, 0.5, 1.0, 0.6, 0.3))
    n = len(table)
    way = np.tile(np.repeat([1.0, 1.0, 1.0, -1.0, -1.0], 3), poses)
    table = replace(table, time=start + 20.0 * np.arange(n), branch=way)
    truth = Truth(robot, nominal_truth(robot), noise=Noise((0.02,) * 3))
    clean = replace(table, time=table.time - start)
    found = simulate(truth.with_effects(effect) if effect else truth, clean, 3)
    return replace(found, time=table.time)


def diagnosed(table: Measurements) -> Finding:
    return diagnose(Task(load(ROBOT), table))


@cache
def lag() -> Measurements:
    return read(Effect("hysteresis", {"joint": 2}, values={"width": 4e-4, "knee": 1.0}))


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.0, 32400.0, 1.7e9])
def test_a_drift_is_found_wherever_the_clock_stands(start: float) -> None:
    found = diagnosed(read(Effect("thermal_drift", None, "exponential", {"rate": [3e-4, 0, 2e-4]}), start))
    assert [e.effect for e in found.named] == ["thermal_drift"]
    assert found.verdict == "named"
    assert found.named[0].shape.get("start", 0.0) == start


def test_a_drift_counts_from_the_start_of_its_session() -> None:
    drift = find("thermal_drift")
    shapes = drift.shapes(load(ROBOT), {}, Scales(context={"time": 7200.0}, lowest={"time": 1.7e9}))
    for shape in shapes:
        law = drift.realise(load(ROBOT), {"measurement": "frame"}, shape).terms[0].factor
        assert [float(law.subs(TIME, t)) for t in (1.7e9, 1.7e9 + 7200)] == pytest.approx([0, 1], abs=1e-9)
        told = EffectInstance("thermal_drift", {"measurement": "frame"}, shape).shape_phrases(load(ROBOT))
        assert "from 1700000000 s of the clock on" in told


@cache
def exchanged() -> Finding:
    return diagnosed(replace(lag(), branch=-lag().branch))


@pytest.mark.slow
def test_an_exchanged_branch_is_asked_about() -> None:
    swapped = exchanged()
    assert "hysteresis" not in {e.effect for e in swapped.named}
    assert any("hysteresis at joint 2 would lead" in r and "branch exchanged?" in r for r in swapped.remarks)
    right = diagnosed(lag())
    assert [e.effect for e in right.named] == ["hysteresis"]
    assert not any("exchanged" in r for r in right.remarks)


@pytest.mark.parametrize(
    ("effect", "name", "deviations", "told"),
    [
        ("hysteresis", "width", 3.0, "branch exchanged?"),
        ("backlash", "gap", 3.0, "signs of loads and readings"),
        ("backlash", "gap", 1.5, ""),  # not below nothing for sure
        ("backlash", "gap", -3.0, ""),
    ],
)
def test_a_sure_wrong_sign_of_what_would_lead_is_a_matter_of_the_table(
    effect: str, name: str, deviations: float, told: str
) -> None:
    found = exchanged()
    size = {f"{effect}_2_{name}": Quantity(-2e-5 * deviations, 2e-5, "rad")}
    lead = replace(
        next(c for c in found.last.candidates if c.testable), effect=effect, parameters=size, shape={}
    )
    remarks = remarked(found.assembly.situation.view, replace(found.last, candidates=(lead,)))
    asked = [r for r in remarks if "would lead" in r]
    assert [told in r for r in asked] == [True] * bool(told)


@pytest.mark.slow
def test_rows_that_have_come_back_to_no_load_are_left_out() -> None:
    """What a load leaves behind has the sign of a load that is gone."""
    table = lag()
    none = replace(
        table.select(np.flatnonzero(table.branch < 0)), w=np.zeros((int(np.sum(table.branch < 0)), 6))
    )
    back = none.select(np.flatnonzero(np.arange(len(none)) % 6 < 3))
    back = replace(back, time=back.time + 40.0, values=back.values * 0.0 + 2e-4)
    found = diagnosed(concatenate([table, back]))
    assert [(e.effect, dict(e.where)) for e in found.named] == [("hysteresis", {"joint": 2})]
    assert len(found.table) == len(table)
    assert f"{len(back)} rows have come back to no load (they read 0.200 mm rms)" in " ".join(found.remarks)


def test_the_row_that_opens_a_pose_at_no_load_is_no_reading() -> None:
    table = measured()
    first = table.select(np.unique(np.stack([table.pose, table.point]), axis=1, return_index=True)[1])
    opened = concatenate([table, replace(first, w=first.w * 0.0, values=first.values * 0.0)])
    plain, found = diagnosed(table), diagnosed(opened)
    assert found.verdict == plain.verdict == "nothing_missing"
    assert found.rms == plain.rms
    fits = [identify(load(ROBOT), t).fit for t in (table, opened)]
    assert fits[0].values == pytest.approx(fits[1].values)
    assert fits[0].std == pytest.approx(fits[1].std)
    said = f"{len(first)} rows without load read 0 in every column"
    assert any(said in r for r in found.remarks)
    assert any(said in r for r in identify(load(ROBOT), opened).remarks)


def test_one_wrong_digit_is_pointed_at() -> None:
    table = measured()
    values = table.values.copy()
    values[40, 0] += 5e-3
    found = diagnosed(replace(table, values=values))
    (said,) = (r for r in found.remarks if "times the usual residual" in r)
    assert said.startswith("a reading lies")
    assert table.place(40) in said
    assert found.verdict == "nothing_missing"


def test_what_is_computed_and_not_measured_has_nothing_missing() -> None:
    table = measured()
    model = StiffnessModel.of(reduce(load(ROBOT), "force", "position"))
    steps = {n: s * (1 + k % 3) for k, (n, s) in enumerate(model.steps.items())}
    exact = predict(model.with_values(steps), table)
    found = diagnosed(replace(table, values=np.where(np.isnan(table.values), np.nan, exact)))
    assert found.verdict == "nothing_missing"
    assert headline(found) == "Nothing is missing"
    assert found.remarks[-1].startswith("the model gives the readings but for rounding")


@pytest.mark.slow
def test_computed_data_are_named_from_the_joints_alone_too() -> None:
    robot = load("ur5e")
    q = np.random.default_rng(3).uniform(-2.5, 2.5, (20, 6))
    w = np.random.default_rng(4).normal(size=(20, 6)) * [60.0, 60.0, 60.0, 6.0, 6.0, 6.0]
    poses = measurements(np.repeat(q, 2, axis=0), np.repeat(w, 2, axis=0) * np.tile([[0.5], [1.0]], (20, 1)))
    model = StiffnessModel.of(reduce(robot))
    exact = predict(model.with_values(model.steps), poses)
    found = diagnose(Task(robot, replace(poses, values=exact, kind="deflection"), "joints"))
    assert found.verdict == "named"
    assert {e.effect for e in found.named} <= {"link_compliance", "base_compliance", "tool_compliance"}
    assert found.rms.after < 1e-9


def test_a_sigma_that_is_far_too_small_is_named_as_what_speaks_against_the_model() -> None:
    found = diagnosed(measured(stated=0.1))
    assert found.verdict == "unexplained"
    assert found.because.why is Why.SIGMA
    assert "than the stated sigma allows" in headline(found)
    assert "times the stated sigma" in sentence(found)
    assert "check the stated sigma" in sentence(found)
    assert not any("masses" in r for r in found.remarks)
    assert found.last.law is None
    assert _unnamed(found) is None


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_deflections_of_zero_alone_are_refused(run: Run, tmp_path: Path, command: str) -> None:
    table = measured()
    saved(replace(table, values=np.where(np.isnan(table.values), np.nan, 0.0)), tmp_path / "data.csv")
    mistake = run(command, ROBOT, tmp_path / "data.csv", "-o", tmp_path / "out")
    assert_users_mistake(mistake, "data.csv: line 2: every deflection is 0")
    assert not (tmp_path / "out").exists()


def test_few_poses_give_no_sure_names() -> None:
    found = diagnosed(measured(HARDENING, poses=3))
    assert all(e.confidence <= 0.75 for e in found.effects)
    assert bool(found.effects) == any("so few poses leave none to predict" in r for r in found.remarks)
    assert found.effects


@pytest.mark.parametrize(
    ("levels", "wanted"),
    [
        ((0.5, 1.0), {0.1, 0.5, 1.0}),
        ((0.25, 0.5, 1.0), {0.1, 0.25, 0.5, 1.0}),
        ((1.0,), {0.5, 1.0}),
        ((0.1, 0.5, 1.0), {0.1, 0.5, 1.0}),
        ((0.15, 1.0), {0.15, 0.5, 1.0}),
    ],
)
def test_a_table_that_decides_holds_no_load_twice(levels: tuple[float, ...], wanted: set[float]) -> None:
    loads = setups_like(measured(levels=levels))[0].loads
    assert len(np.unique(np.round(loads, 6), axis=0)) == len(loads)
    sizes = np.linalg.norm(loads, axis=1) / np.linalg.norm(loads, axis=1).max()
    assert {round(float(s), 6) for s in sizes} == wanted


@pytest.mark.slow
def test_a_size_that_goes_astray_is_not_named(tmp_path: Path) -> None:
    """One joint, a quarter of a radian of deflection: far beyond what the second order tells."""
    (tmp_path / "one.toml").write_text('format = 1\nname = "one"\n[[joint]]\na = 0.5\nalpha = 0\nd = 0\n')
    robot = load(str(tmp_path / "one.toml"))
    q = np.linspace(-2.0, 2.0, 12)[:, None]
    poses = measurements(q, np.tile([0.0, 0.0, -1000.0, 0.0, 0.0, 0.0], (12, 1)))
    for seed in (0, 5):
        truth = Truth(robot, nominal_truth(robot), noise=Noise((0.01,) * 3, (0.01,) * 3))
        found = diagnose(Task(robot, simulate(truth, poses, seed)))
        for effect in found.named:
            for p in effect.instance.realise(robot).parameters:
                width = p.high - p.low
                assert p.low - width <= effect.parameters[p.name].value <= p.high + width


@pytest.mark.parametrize(
    ("value", "far"), [(-6e-3, True), (-4e-3, False), (1e-3, False), (9e-3, False), (11e-3, True)]
)
def test_a_size_is_astray_beyond_its_range_by_more_than_this_is_wide_on_either_side(
    value: float, far: bool
) -> None:
    gap = {"backlash_2_gap": Quantity(value, 1e-5, "rad")}  # physical from 0 to 5 mrad
    found = Found("backlash", {"joint": 2}, {}, gap, 0.0, 0.9, ())
    assert astray([found], load("kuka_kr270")) is far


def test_no_code_is_written_where_the_data_do_not_determine_the_model(run: Run, tmp_path: Path) -> None:
    table = measured().select(measured().pose == 0)
    saved(table, tmp_path / "one_pose.csv")
    result = run("diagnose", ROBOT, str(tmp_path / "one_pose.csv"), "-o", str(tmp_path / "report"))
    assert result.code == 0
    assert "no code was written: the data do not determine the model" in result.out
    assert "are not determined by these data" in " ".join((result.out + result.err).split())
    assert not (tmp_path / "report" / "code").exists()


def test_positions_that_do_not_determine_the_model_are_refused(run: Run, tmp_path: Path) -> None:
    table = replace(design(3, (1.0,)), kind="absolute")
    truth = Truth(load(ROBOT), nominal_truth(load(ROBOT)), noise=Noise((0.02,) * 3))
    saved(simulate(truth, table, 3), tmp_path / "data.csv")
    result = run("identify", ROBOT, str(tmp_path / "data.csv"), "-o", str(tmp_path / "model.toml"))
    assert_users_mistake(result, "the positions do not determine", "beside geometry")
    assert not (tmp_path / "model.toml").exists()
