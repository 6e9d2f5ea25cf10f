"""What must not mislead a diagnosis: rounding, loose markers, swapped labels, strata that still reject."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from symstiff.calibration.experiment.placement import closest
from symstiff.calibration.experiment.situation import Situation, look
from symstiff.calibration.simulation import Device, Truth, nominal_truth
from symstiff.calibration.tables.measurements import Measurements, concatenate
from symstiff.discrepancy import workflow
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.bridge.growth import fit, grow
from symstiff.discrepancy.findings import numbers
from symstiff.discrepancy.findings.doubts import doubted
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.out_of_range import out_of_range
from symstiff.discrepancy.findings.result import Found, Quantity
from symstiff.discrepancy.findings.used import known_throughout
from symstiff.discrepancy.laws.of_angles import _soft_spots
from symstiff.discrepancy.noise.sharing import AXES, EACH, Sharing
from symstiff.discrepancy.problem import Options
from symstiff.discrepancy.reasons import Why
from symstiff.discrepancy.search.judging import _lacking
from symstiff.discrepancy.statistics.strata import Stratum
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.report import naming, words
from symstiff.report.folder import write_report
from symstiff.report.tables import moved
from symstiff.robot import from_table, load
from symstiff.robot.table import to_table
from tests.blind.generate import Options as Drawn
from tests.blind.generate import case
from tests.diagnosis_data import HARDENING, ROBOT, measured
from tests.test_assemble import design, readings


def test_a_column_that_is_rounding_alone_moves_no_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A moment that nothing feels has a column of zeros, or of rounding: the same fit."""
    columns, noise = Situation.columns, np.random.default_rng(1)

    def rounded(self: Situation, terms: Any, names: Any) -> np.ndarray:
        exact = columns(self, terms, names)
        return np.asarray(exact + 1e-21 * noise.normal(size=exact.shape))

    raw = to_table(load("ur10"))
    for joint in raw["joint"]:
        joint["link"] = {k: v for k, v in joint["link"].items() if k not in ("mass", "com")}
    robot = from_table(raw)
    table = design("ur10", "absolute", poses=20)
    w = np.zeros_like(table.w)
    w[:, 2] = -np.abs(table.w[:, 2])
    table = replace(table, w=w)
    values = readings(Truth(robot, nominal_truth(robot), (), device=Device()), table)
    values[:, 3:] = np.nan
    values[:, :3] += np.random.default_rng(0).normal(size=(len(table), 3)) * 2e-5
    table = replace(table, values=values)
    model = StiffnessModel.of(reduce(robot, "gravity", "position"))
    model = grow(model, [EffectInstance("link_weight", {"link": 1})])
    plain = fit(model, table).model.values
    monkeypatch.setattr(Situation, "columns", rounded)
    again = fit(model, table).model.values
    for name in model.parameters:
        assert again[name] == pytest.approx(plain[name], rel=1e-3, abs=1e-9), name


def test_lateness_is_not_looked_for_where_it_is_a_constant() -> None:
    def places(table: Any) -> set[str]:
        model = StiffnessModel.of(reduce(load(ROBOT)))
        return {law.place for law in assemble(model, table, effects=()).problem.devices}

    assert "order of the loads" in places(measured())
    assert "order of the loads" not in places(measured(levels=(0.25, 0.5, 0.75, 1.0)))


def swapped(table: Measurements, *poses: int) -> Measurements:
    """The table with the readings of two poses exchanged."""
    values = table.values.copy()
    first, second = (np.flatnonzero(table.pose == p) for p in poses)
    values[first], values[second] = table.values[second], table.values[first]
    return replace(table, values=values)


@pytest.mark.slow
def test_swapped_labels_are_told_as_the_poses_without_which_nothing_is_missing() -> None:
    table = swapped(measured(poses=16), 3, 11)
    found = diagnose(Task(load(ROBOT), table))
    assert (found.verdict, found.effects) == ("unexplained", ())
    assert sorted(found.because.told) == sorted(str(table.labels[p]) for p in (3, 11))
    assert len(found.table) == len(table) * 14 // 16
    assert any(
        r.startswith(f"{len(table) // 8} rows are left out, of {found.accused}, unlike")
        for r in found.remarks
    )
    assert found.accused in (f"poses {a} and {b}" for a, b in permutations(found.because.told))
    assert all(
        name in part for part in (words.headline(found), words.sentence(found)) for name in found.because.told
    )


@pytest.mark.slow
def test_exchanged_loads_of_a_pose_do_not_pass_for_what_the_markers_of_a_reading_share() -> None:
    table = measured(poses=16)
    third = np.flatnonzero(table.pose == 5)[:9]  # three loads, three markers
    first, second = third[3:6], third[6:]
    values = table.values.copy()
    values[first], values[second] = table.values[second], table.values[first]
    found = diagnose(Task(load(ROBOT), replace(table, values=values)))
    assert (found.because.why, found.because.told) == (Why.POSES, (str(table.labels[5]),))


@pytest.mark.slow
def test_where_more_is_missing_than_swapped_labels_they_are_a_remark() -> None:
    table = swapped(measured({**HARDENING, "a": 1.5e-3}, poses=16), 3, 11)
    found = diagnose(Task(load(ROBOT), table))
    assert found.verdict in ("unexplained", "named_insufficient")
    assert len(found.table) == len(table)
    remark = next(r for r in found.remarks if "few poses" in r)
    assert all(table.labels[p] in remark for p in (3, 11))


def test_few_poses_are_not_blamed_for_a_law() -> None:
    found = diagnose(Task(load(ROBOT), measured({**HARDENING, "a": 1.5e-3}, poses=16)))
    assert not any("few poses" in r for r in found.remarks)


@pytest.mark.parametrize(
    ("p", "further", "lacking"), [(1e-6, 90.0, True), (1e-6, 5.0, False), (0.2, 90.0, False)]
)
def test_a_stratum_that_rejects_with_much_of_the_signal_makes_a_set_insufficient(
    p: float, further: float, lacking: bool
) -> None:
    part = Stratum("nonlinear in load", 40, 40.0 + further, 2.0, p)
    shop: Any = SimpleNamespace(lack=lambda scan: (part,), options=Options(), parts=())
    none: Any = None
    assert _lacking(shop, none, 150.0, 2.0) is lacking


@pytest.mark.parametrize(
    ("before", "after", "usual", "lacking"),
    [(8, 2, 3.0, True), (8, 5, 3.0, False), (60, 50, 3.0, False), (9, 0, 3.0, True), (14, 1, 3.0, False)],
)
def test_a_set_that_takes_most_directions_proportional_to_the_load_is_insufficient(
    before: int, after: int, usual: float, lacking: bool
) -> None:
    """Nothing is left there that could contradict it; three directions are too few to fit anything by.

    Of many directions those of usual sizes may be few: unusual sizes contradict it then.
    """
    part = Stratum("proportional to load, by pose", after, float(after), 1.0, 1.0)
    other = Stratum("nonlinear in load", 40, 40.0, 1.0, 1.0)
    parts = (part, other) if after else (other,)
    start = (replace(part, degrees_of_freedom=before), other)
    shop: Any = SimpleNamespace(lack=lambda scan: parts, options=Options(), parts=start)
    none: Any = None
    assert _lacking(shop, none, 150.0, usual) is lacking


@pytest.mark.slow
def test_a_rocking_base_is_named_though_its_block_could_take_nearly_all_that_fifteen_poses_leave() -> None:
    """13 of 14 directions proportional to the load; of usual sizes it takes three, and those it asks for."""
    hidden = case(1, Drawn(
        robots=("kuka_kr270",), poses=(15,), levels=(5,), markers=(1,), classes=("one",), shares=(1.0,),
        lambdas=(60.0,), seed=2, story="base rocking", mild=True,
    ))  # fmt: skip
    found = diagnose(Task(hidden.model.robot, hidden.table))
    assert found.verdict == "named"
    assert [(e.effect, e.where) for e in found.named] == [("base_compliance", {"link": 0})]


def test_a_soft_spot_at_a_negative_angle_reads_as_one_writes_it() -> None:
    laws = _soft_spots(np.linspace(-2.0, 1.0, 30), 2, np.ones(30))
    assert "q2 + 2" in laws[0].text[0]
    assert not any("- -" in text for law in laws for text in law.text)


def test_shapes_are_told_with_units() -> None:
    found = diagnose(Task(load(ROBOT), measured(HARDENING)))
    text = naming.shape_text(found, found.named[0])
    assert "reference load" in text
    assert "N·m" in text
    assert numbers.percent(1.0) == "100 %"
    assert numbers.percent(0.034) == "3.4 %"


@pytest.mark.parametrize("start", ["complete", "joints"])
def test_deflections_of_the_wrong_sign_are_a_matter_of_the_table(tmp_path: Path, start: str) -> None:
    table = measured(HARDENING)
    found = diagnose(Task(load(ROBOT), replace(table, values=-table.values), start))
    assert (found.verdict, found.testable) == ("unexplained", False)
    assert "the deflections point against their loads" in found.reason
    assert not found.effects
    code = write_report(found, tmp_path / "out").verdict["code"]
    assert code["text"] == "no code was written: model.toml is of a table that has to be corrected"
    assert not (tmp_path / "out" / "code").exists()


def test_joints_far_outside_their_limits_are_remarked() -> None:
    raw = to_table(load(ROBOT))
    raw["joint"][0]["limits"] = [-0.1, 0.1]
    found = diagnose(Task(from_table(raw), measured()))
    assert any("q1 is far outside its limits" in r for r in found.remarks)


def test_a_bad_pose_needs_no_other_pose_to_confirm_it() -> None:
    table = measured()
    shift = 3e-4 * (table.pose == 4)
    values = table.values.copy()
    values[:, 0] += shift
    found = diagnose(Task(load(ROBOT), replace(table, values=values)))
    assert [e.effect for e in found.named] == ["bad_poses"]
    assert found.named[0].confidence > 0.9
    assert found.rms.held_out_before is None
    assert any(r.startswith(f"pose {table.labels[4]}: measure it again") for r in found.remarks)


@pytest.mark.slow
def test_a_bad_pose_is_not_among_the_poses_that_prove_another_effect() -> None:
    """Nothing in the other poses can tell how far its marker slipped: the gap of all others is what closes."""
    table = measured(HARDENING, poses=16)
    values = table.values.copy()
    values[:, 0] += 1e-3 * (table.pose == 4)
    found = diagnose(Task(load(ROBOT), replace(table, values=values)))
    assert {e.effect for e in found.named} == {"bad_poses", "nonlinear_stiffness"}
    rms = found.rms
    assert rms.held_out_before is not None
    assert rms.held_out_after is not None
    assert rms.held_out_after < 1.3 * 2e-5 < rms.held_out_before
    assert found.last.held_out is not None
    assert found.last.held_out.again > 0.9
    assert any(r.startswith(f"pose {table.labels[4]}: measure it again") for r in found.remarks)


@pytest.mark.slow
def test_poses_copied_under_another_label_change_nothing() -> None:
    """Counted as measured anew they halve the noise of what has no noise, and effects come out of it."""
    once = measured(HARDENING)
    copies = replace(once, labels=tuple(f"again {label}" for label in once.labels))
    alone, found = (diagnose(Task(load(ROBOT), table)) for table in (once, concatenate([once, copies])))
    assert (found.verdict, found.rms) == (alone.verdict, alone.rms)
    assert {e.effect: e.parameters for e in found.named} == {e.effect: e.parameters for e in alone.named}
    assert any("copies" in r for r in found.remarks)


def test_times_that_some_rows_lack_are_not_used_and_that_is_said() -> None:
    table = measured()
    time = np.arange(len(table), dtype=float)
    assert known_throughout(replace(table, time=time))[1] == []
    time[3] = np.nan
    used, remarks = known_throughout(replace(table, time=time))
    assert np.isnan(used.time).all()
    assert remarks == ["the time is not told in every row: it is not used"]


def test_absolute_positions_of_another_robot_are_doubted() -> None:
    table = design("ur10", "absolute", poses=20)
    values = readings(Truth(load("ur10"), nominal_truth(load("ur10")), (), device=Device()), table)
    values[:, 3:] = np.nan
    model = StiffnessModel.of(reduce(load("ur10")))
    assert doubted(model, replace(table, values=values), model) is None
    exchanged, moved_on = table.q[:, [0, 1, 2, 4, 3, 5]], table.q[:, [5, 0, 1, 2, 3, 4]]
    read = replace(table, values=values)
    assert "q4 for q5 and q5 for q4 would leave 0 %" in str(doubted(model, replace(read, q=exchanged), model))
    assert "misses the measured positions by" in str(doubted(model, replace(read, q=moved_on), model))


def test_two_axes_of_a_position_do_not_say_where_the_device_stands() -> None:
    table = design("ur10", "absolute", poses=6)
    values = readings(Truth(load("ur10"), nominal_truth(load("ur10")), (), device=Device()), table)
    values[:, 2:] = np.nan
    with pytest.raises(UserError, match="x, y and z together in at least three rows, 0 found"):
        diagnose(Task(load("ur10"), replace(table, values=values)))


def test_what_a_table_does_not_determine_is_remarked() -> None:
    table = measured(poses=3)
    one = table.select(table.point == 0)
    found = diagnose(Task(load(ROBOT), replace(one, values=np.where(np.arange(6) == 0, one.values, np.nan))))
    assert any("parameters are not determined by these data" in r for r in found.remarks)
    assert not any("not determined" in r for r in diagnose(Task(load(ROBOT), measured())).remarks)


def test_no_link_weighs_more_than_a_robot_of_its_reach_could() -> None:
    robot = load("ur10")
    mass = EffectInstance("link_weight", {"link": 2}).realise(robot).parameters[0]
    assert mass.high < 60.0 * robot.reach**3
    assert mass.high > sum(link.mass for link in robot.links)


@pytest.mark.slow
def test_the_rigid_robot_is_placed_as_well_as_it_can_be() -> None:
    """Whatever the fitted model makes of the device's placement."""
    table = design("ur10", "absolute", poses=20)
    values = readings(Truth(load("ur10"), nominal_truth(load("ur10")), (), device=Device()), table)
    values[:, 3:] = np.nan
    table = replace(table, values=values)
    view = look(load("ur10"), table)
    rigid = view.found.T[:, :3, 3] + view.offset
    turn, shift = closest(rigid, values[:, :3])
    expected = values[:, :3] - (rigid @ turn.T + shift)
    found = fit(StiffnessModel.of(reduce(load("ur10"))), table).reading
    assert np.sqrt(np.mean(found**2)) == pytest.approx(np.sqrt(np.mean(expected**2)), rel=1e-3)


@pytest.mark.slow
def test_readings_that_changed_places_are_told_by_their_rows() -> None:
    table = measured(poses=16)
    values = table.values.copy()
    values[[10, 101]] = table.values[[101, 10]]
    found = diagnose(Task(load(ROBOT), replace(table, values=values)))
    remark = next(r for r in found.remarks if "changed places" in r)
    assert remark.startswith("2 readings lie")
    assert any(table.places(rows, 2) in remark for rows in ([10, 101], [101, 10]))
    for plain in (measured(poses=16), measured(HARDENING, poses=16)):
        assert not any("changed places" in r for r in diagnose(Task(load(ROBOT), plain)).remarks)


def test_an_effect_of_known_size_is_told_at_the_size_that_the_data_say() -> None:
    found = diagnose(Task(load(ROBOT), measured()))
    share = {"large_deflection_all_share": Quantity(1.4, 0.3, "1")}
    effect = Found("large_deflection", {"robot": "all"}, {}, share, 1e-4, 0.9, ())
    grown = replace(found.grown, model=grow(found.grown.model, [effect.instance]))
    rows = {m.name: m for m in moved(replace(found, effects=(effect,), grown=grown))}
    row = rows["large_deflection_all_share"]
    assert (row.before, row.after, row.after_std, row.unit) == (None, 1.4, 0.3, "")


def test_a_start_model_is_fitted_under_the_noise_of_the_better_one_whatever_that_has_learned() -> None:
    table, start = measured(HARDENING), StiffnessModel.of(reduce(load(ROBOT), "force", "position"))
    after = fit(
        grow(start, [EffectInstance("nonlinear_stiffness", {"joint": 2}, {"load": 20.0, "knee": 1.0})]), table
    )
    assert len(after.noise.sharings) == 1
    learned = replace(after.noise, sharings=(Sharing(EACH, 1.0),), ways={EACH: after.noise.ways[AXES]})
    before = fit(start, table, learned)
    assert before.noise.sharings == learned.sharings
    # and by hand, without a shared error: plain weighted least squares
    plain = replace(after.noise, sharings=(Sharing(),))
    problem = assemble(start, table, effects=()).problem
    A, y = (x / (plain.spread if x.ndim == 1 else plain.spread[:, None]) for x in (problem.A, problem.y))
    expected = problem.y - problem.A @ np.linalg.lstsq(A, y, rcond=1e-9)[0]
    assert fit(start, table, plain).residual == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("size", "told"), [("1845", True), ("200", False), ("−30", False), ("−700", True)])
def test_a_size_that_nobody_would_believe_is_remarked(size: str, told: bool) -> None:
    robot, mass = load("kuka_kr270"), float(size.replace("−", "-"))
    weight = Found(
        "link_weight", {"link": 1}, {}, {"link_weight_1_m": Quantity(mass, 612.0, "kg")}, 1e-3, 0.5, ()
    )
    remarks = out_of_range([weight], robot)
    assert len(remarks) == told
    assert all(f"link_weight_1_m is {size} ± 612 kg, where at" in r for r in remarks)


def test_a_table_whose_other_poses_are_no_experiment_keeps_its_diagnosis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = diagnose(Task(load(ROBOT), measured(HARDENING)))

    def none(*_: object) -> Finding:
        raise UserError("too few")

    monkeypatch.setattr(workflow, "unlike", lambda *_: [1])
    monkeypatch.setattr(workflow, "_of_table", none)
    assert workflow._but_suspects(found, (), lambda stage: None) is found
