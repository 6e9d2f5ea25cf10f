"""A second campaign: effects of the start model that changed their shape or size since the first, or are gone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from symstiff.calibration.doubts.soundness import other_weights
from symstiff.calibration.identify import identify
from symstiff.calibration.kept import on_the_clock
from symstiff.calibration.simulation import Effect, Environment, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy import workflow
from symstiff.discrepancy.apart.deciding import _at_the_end
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.outgrown import accounts_better, outgrown
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only
from symstiff.report.tables import moved
from symstiff.report.verdict import verdict_table
from symstiff.report.words import headline, sentence
from symstiff.robot import from_table, load
from symstiff.robot.table import to_table

ROBOT, POSES, FORCE, LEVELS, EVERY = load("kuka_kr270"), 24, 2000.0, (0.4, 0.7, 1.0), 60.0
RATES = [4e-8, 1e-8, -2e-8]
GEAR, LINK = {"joint": 3}, {"link": 2}
LASH = EffectInstance("backlash", GEAR, {"width": 40.0})
SPAN = EVERY * (POSES * len(LEVELS) - 1)
GROWN = EffectInstance("thermal_drift", LINK, {"time": SPAN})


def design(seed: int, kind: str) -> Measurements:
    """Random poses, one force each at three levels, a reading a minute."""
    rng = np.random.default_rng(seed)
    limits = np.array([j.range for j in ROBOT.joint])
    q = rng.uniform(limits[:, 0], limits[:, 1], (POSES, ROBOT.dof))
    side = rng.normal(size=(POSES, 3))
    force = FORCE * side / np.linalg.norm(side, axis=1)[:, None]
    each, rows = len(LEVELS), POSES * len(LEVELS)
    w = np.zeros((rows, 6))
    w[:, :3] = (force[:, None] * np.array(LEVELS)[:, None]).reshape(rows, 3)
    return measurements(np.repeat(q, each, axis=0), w, pose=np.repeat(np.arange(POSES), each), points=("p1",),
                        point=np.zeros(rows, int), kind=kind, joint_units=["rad"] * ROBOT.dof,  # type: ignore[arg-type]
                        time=EVERY * np.arange(rows))  # fmt: skip


def campaign(*effects: Effect, kind: str = "deflection", seed: int = 1) -> Measurements:
    """What a robot whose joints alone give way reads, with effects."""
    joints = {name: value for name, value in nominal_truth(ROBOT).items() if name.startswith("c")}
    truth = Truth(ROBOT, joints, effects, Noise((0.03,) * 3), environment=Environment(interval=EVERY))
    return simulate(truth, design(seed, kind), seed)


def lash(gap: float = 5e-4, knee: float = 40.0) -> Effect:
    return Effect("backlash", GEAR, "tanh", {"gap": gap, "knee": knee})


def warm(shape: str = "link_time", **sizes: Any) -> Effect:
    return Effect("thermal_drift", LINK, shape, {"rate": RATES, **sizes})


def start(
    instance: EffectInstance, values: Mapping[str, float] | None = None, std: float = 0.0
) -> StiffnessModel:
    model = joints_only(ROBOT).with_effect(instance)
    known = dict(values or {})
    return model.with_values({**model.values, **known}, dict.fromkeys(known, std))


def of_campaign(model: StiffnessModel, *effects: Effect, kind: str = "deflection") -> Finding:
    return diagnose(Task(ROBOT, campaign(*effects, kind=kind), model))


@cache
def longer_session() -> Finding:
    """The model's link was warm in ten minutes, that of the table takes an hour."""
    soon = replace(GROWN, shape={"time": SPAN, "T": 600.0})
    late = warm("link_exponential", rate=[4e-4, 1e-4, -2e-4], T=4000.0)
    return of_campaign(start(soon), late, kind="absolute")


@pytest.mark.slow
def test_a_drift_that_takes_longer_than_the_model_has_it_is_no_other_effect() -> None:
    """As the model has it, it leaves what another link's growth would account for."""
    found = longer_session()
    assert found.verdict == "named"
    (drift,) = found.named
    assert (drift.effect, drift.where) == ("thermal_drift", LINK)
    assert drift.shape["T"] > 2000.0
    assert found.rms.after < 0.8 * found.rms.before


def test_the_growth_path_takes_the_old_shape_out_and_the_model_has_the_new_one() -> None:
    found = longer_session()
    without = "start model without thermal drift at link 2"
    assert [step.title for step in found.steps] == ["start model", without, "+ thermal drift at link 2"]
    assert [step.parameters for step in found.steps] == [9, 6, 9]
    (kept,) = found.model.effects
    assert kept.shape == found.named[0].shape
    assert found.told.effects[0].shape["T"] == 600.0


def test_words_tell_an_effect_of_the_start_model_in_another_shape_from_a_missing_one() -> None:
    found = longer_session()
    assert headline(found) == "In another shape than the start model has it: thermal drift at link 2"
    told = sentence(found)
    assert told.startswith("In another shape than the start model has it: thermal drift at link 2 (over ")
    assert "missing" not in told
    told = {"effect": "thermal_drift", "where": LINK, "shape": {"time": SPAN, "T": 600.0}}
    assert verdict_table(found)["reshaped"] == [told]
    assert any("time constant 600 s" in r and "ask for another shape" in r for r in found.remarks)


@pytest.mark.parametrize(
    ("instance", "effect", "asked"),
    [
        (LASH, lash(), False),
        (LASH, lash(gap=9e-4), False),
        (LASH, lash(gap=9e-4, knee=400.0), True),
        (GROWN, warm(), False),
        (GROWN, warm(turn=[3e-8, -5e-8, 2e-8]), True),
    ],
    ids=["as it was", "larger", "wider", "a link that grows", "and bends"],
)
def test_only_a_shape_that_does_not_fit_is_asked_for_anew(
    instance: EffectInstance, effect: Effect, asked: bool
) -> None:
    table = campaign(effect, kind="absolute" if instance is GROWN else "deflection")
    assert outgrown(start(instance), table, ()) == ((instance,) if asked else ())


def test_what_was_found_beside_does_not_hide_that_a_shape_is_too_old() -> None:
    """Beside a strong effect, and without it in the model, the data do not ask for another shape."""
    spring = Effect("nonlinear_stiffness", {"joint": 2}, "two_slope", {"c": 6e-7, "knee": 1500.0})
    table = campaign(lash(gap=4e-4, knee=300.0), spring)
    other = EffectInstance("nonlinear_stiffness", {"joint": 2}, {"load": 1500.0, "knee": 1.0})
    assert outgrown(start(LASH), table, []) == ()
    assert outgrown(start(LASH), table, [other]) == (LASH,)


@pytest.mark.parametrize(
    ("begin", "left_out"),
    [(0.0, False), (-0.5 * SPAN, False), (-2.0 * SPAN, True), (0.05 * SPAN, False), (3.0 * SPAN, True)],
    ids=["the same", "goes on", "after its end", "a little early", "before its begin"],
)
def test_a_drift_of_another_clock_is_left_out(begin: float, left_out: bool) -> None:
    """Its law tells nothing of another session, and its exponential is beyond all numbers days before its begin."""
    drift = replace(GROWN, shape={"time": SPAN, "start": begin, "T": SPAN / 9})
    model, remarks = on_the_clock(start(drift), design(1, "absolute"))
    assert model.effects == (() if left_out else (drift,))
    assert len(remarks) == left_out
    assert all("thermal drift at link 2: the start model's clock ran from" in r for r in remarks)


@pytest.mark.parametrize("days", [-3, 3])
def test_identification_leaves_a_drift_of_another_day_out(days: int) -> None:
    other = replace(GROWN, shape={"time": SPAN, "start": days * 86400.0, "T": 600.0})
    told = start(other, {"thermal_drift_2_x": 1e-4}, 1e-5)
    fitted = identify(ROBOT, campaign(kind="absolute"), told)
    assert fitted.model.effects == ()
    assert any("clock ran from" in remark for remark in fitted.remarks)


@pytest.mark.slow
def test_a_drift_of_another_day_is_found_anew_by_the_clock_of_these_data() -> None:
    other = replace(GROWN, shape={"time": SPAN, "start": 3 * 86400.0, "T": 600.0})
    found = of_campaign(start(other), warm(rate=[4e-8, 1e-8, -4e-8]), kind="absolute")
    assert found.verdict == "named"
    assert [(e.effect, e.where) for e in found.named] == [("thermal_drift", LINK)]
    assert [e.shape.get("start", 0.0) for e in found.model.effects] == [0.0]


@pytest.mark.parametrize(
    "command", [lambda m, t: diagnose(Task(ROBOT, t, m)), lambda m, t: identify(ROBOT, t, m)]
)
def test_a_table_without_the_time_that_the_model_follows_is_refused(command: Any) -> None:
    table = replace(campaign(kind="absolute"), time=np.full(POSES * len(LEVELS), np.nan))
    with pytest.raises(UserError, match="the model needs the column time"):
        command(start(GROWN), table)


def test_a_robot_file_with_other_masses_than_the_start_model_is_remarked() -> None:
    """Who enters masses and starts from the old model would wait for them in vain."""
    table = to_table(ROBOT)
    table["joint"][1]["link"]["mass"] = 120.0
    heavier, model = from_table(table), joints_only(ROBOT)
    remarks = identify(heavier, campaign(), model).remarks
    assert sum("other masses or centres of mass of links than the robot file" in r for r in remarks) == 1
    assert not any("other masses" in r for r in identify(ROBOT, campaign(), model).remarks)
    assert other_weights(joints_only(heavier), heavier) == []


def test_poses_that_decide_are_thought_of_at_the_end_of_the_session() -> None:
    """At time 0 a drift that begins days later has no size that a computer could hold."""
    taken = replace(design(1, "absolute"), time=1e6 + EVERY * np.arange(POSES * len(LEVELS)))
    offered = _at_the_end(design(2, "absolute"), taken)
    assert set(offered.time) == {taken.time[-1]}
    assert np.isnan(offered.temperature).all()


@pytest.mark.slow
def test_an_old_effect_in_another_shape_and_a_new_one_are_told_apart() -> None:
    spring = Effect("nonlinear_stiffness", {"joint": 2}, "two_slope", {"c": 2e-7, "knee": 1500.0})
    found = of_campaign(start(LASH), lash(gap=9e-4, knee=350.0), spring)
    assert found.verdict == "named"
    assert {(e.effect, e.where["joint"]) for e in found.named} == {
        ("backlash", 3),
        ("nonlinear_stiffness", 2),
    }
    assert [e.effect for e in found.reshaped] == ["backlash"]
    assert headline(found).startswith("Missing: nonlinear stiffness at joint 2; in another shape than")


@pytest.mark.slow
def test_several_effects_in_other_shapes_are_found_at_once() -> None:
    old = EffectInstance("nonlinear_stiffness", {"joint": 2}, {"load": 500.0, "knee": 1.0})
    spring = Effect("nonlinear_stiffness", {"joint": 2}, "two_slope", {"c": 6e-7, "knee": 2500.0})
    model = joints_only(ROBOT).with_effects([LASH, old])
    found = of_campaign(model, lash(gap=9e-4, knee=400.0), spring)
    assert {e.effect for e in found.reshaped} == {e.effect for e in found.named} == {LASH.effect, old.effect}
    assert [step.parameters for step in found.steps] == [8, 6, 7, 8]
    assert sum("ask for other shapes" in r and "takes them out" in r for r in found.remarks) == 1


def test_where_not_all_of_them_have_another_shape_one_may(monkeypatch: pytest.MonkeyPatch) -> None:
    """What looks like another shape of one may be that of the effect beside it."""
    tried: list[tuple[EffectInstance, ...]] = []

    def reshaped(course: Any, old: Any, tell: Any) -> Any:
        tried.append(tuple(old))
        return "anew" if tuple(old) == (GROWN,) else None

    monkeypatch.setattr(workflow, "outgrown", lambda *_: (LASH, GROWN))
    monkeypatch.setattr(workflow, "_reshaped", reshaped)
    found = diagnosis("unexplained", 1.0)
    course: Any = SimpleNamespace(ladder=SimpleNamespace(base=start(LASH)), last=found, table=None)
    assert workflow._shaped_anew(course, lambda stage: None) == "anew"
    assert tried == [(LASH, GROWN), (LASH,), (GROWN,)]
    monkeypatch.setattr(workflow, "outgrown", lambda *_: ())
    assert workflow._shaped_anew(course, lambda stage: None) is course


@pytest.mark.slow
def test_of_two_old_effects_one_has_another_shape_and_beside_the_other_a_gear_saturates() -> None:
    soon = replace(GROWN, shape={"time": SPAN, "T": 600.0})
    late = warm("link_exponential", rate=[4e-4, 1e-4, -2e-4], T=4000.0)
    model = joints_only(ROBOT).with_effects([LASH, soon])
    found = of_campaign(model, late, lash(gap=9e-4, knee=900.0), kind="absolute")
    assert [e.effect for e in found.reshaped] == ["thermal_drift"]
    assert {(e.effect, *e.where.values()) for e in found.named} == {
        ("thermal_drift", 2),
        ("nonlinear_stiffness", 3),
    }
    assert found.rms.after < 0.034e-3


@pytest.mark.slow
def test_behind_elastic_links_that_joined_an_old_shape_is_seen_too() -> None:
    """Beside rigid links what it leaves passes for what they lack."""
    truth = Truth(ROBOT, nominal_truth(ROBOT), (lash(gap=9e-4, knee=400.0),), Noise((0.004,) * 3))
    found = diagnose(Task(ROBOT, simulate(truth, design(1, "deflection"), 1), start(LASH)))
    links = "complete model (all links elastic)"
    assert [s.title for s in found.steps][:3] == [
        "start model",
        links,
        f"{links} without backlash at joint 3",
    ]
    assert {e.effect for e in found.reshaped} == {"backlash"}
    assert {e.where["link"] for e in found.named if e.effect == "link_compliance"} == set(range(7))
    (kept,) = (e for e in found.model.effects if e.effect == "backlash")
    assert kept.shape["width"] > 200.0


@pytest.mark.slow
def test_a_link_whose_growth_the_model_has_is_found_to_bend_as_well() -> None:
    found = of_campaign(start(GROWN), warm(turn=[3e-8, -5e-8, 2e-8]), kind="absolute")
    assert found.verdict == "named"
    assert [(e.effect, e.where, "bends" in e.shape) for e in found.named] == [("thermal_drift", LINK, True)]


def diagnosis(verdict: str, left: float, *names: tuple[str, int]) -> Any:
    """What is asked of one: its leading set, and what its end leaves."""
    noise = SimpleNamespace(by_component=lambda: np.ones(6))
    leading = [(SimpleNamespace(effect=e, where={"joint": j}), {}, {}) for e, j in names]
    residual = np.full(30, left)
    return SimpleNamespace(
        verdict=verdict, leading=leading, noise=noise, growth=[SimpleNamespace(residual=residual)]
    )


OLD, NEW, THIRD = ("backlash", 3), ("hysteresis", 2), ("hysteresis", 4)


@pytest.mark.parametrize(
    ("anew", "found", "better"),
    [
        (diagnosis("named", 1.0, OLD), diagnosis("named", 1.0, NEW), True),
        (diagnosis("named", 1.0, OLD, NEW), diagnosis("named", 2.0, NEW), True),
        (diagnosis("named", 1.0, OLD, NEW), diagnosis("named", 1.0, NEW), False),
        (diagnosis("named", 1.0, OLD, NEW, THIRD), diagnosis("named", 2.0, NEW), False),
        (diagnosis("named", 1.0, NEW), diagnosis("unexplained", 2.0), False),
        (diagnosis("unexplained", 1.0, OLD), diagnosis("unexplained", 2.0), False),
        (diagnosis("ambiguous", 1.0, OLD), diagnosis("unexplained", 2.0), True),
        (diagnosis("named", 1.0, OLD, NEW), diagnosis("insufficient", 2.0, THIRD), True),
    ],
)
def test_another_shape_counts_where_it_accounts_for_more_with_no_more_effects(
    anew: Any, found: Any, better: bool
) -> None:
    assert accounts_better(anew, found, [LASH], np.arange(30) % 3, 30) is better


def test_what_moved_is_told_from_what_the_start_model_says() -> None:
    told = start(LASH, {"backlash_3_gap": 5e-4}, 1e-5)
    found = of_campaign(told, lash(gap=9e-4))
    assert found.verdict == "nothing_missing"
    (gap,) = [m for m in moved(found) if m.name == "backlash_3_gap"]
    assert (gap.before, gap.before_std) == (5e-4, 1e-5)
    assert gap.after == pytest.approx(9e-4, rel=0.1)
    assert verdict_table(found)["as_told_mm"] > 1.5 * verdict_table(found)["rms_mm"]["before"]
    assert sum("with its own values" in r or "its size has changed" in r for r in found.remarks) == 2
    assert headline(found) == "Nothing is missing, but values of the start model do not hold any more"
    assert "once its values are fitted anew" in sentence(found)
    assert "With the values that it was told it leaves" in sentence(found)
    assert verdict_table(longer_session())["as_told_mm"] is not None


@pytest.mark.slow
def test_an_effect_that_goes_astray_in_its_new_shape_keeps_the_old_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Then nothing of the new shape is said, and the written model is that which was fitted."""
    far = {"thermal_drift"}
    monkeypatch.setattr(
        "symstiff.discrepancy.conclusion.astray",
        lambda effects, *_: effects[0].effect in far and effects[0].where == LINK,
    )
    soon = replace(GROWN, shape={"time": SPAN, "T": 600.0})
    late = warm("link_exponential", rate=[4e-4, 1e-4, -2e-4], T=4000.0)
    found = of_campaign(start(soon), late, kind="absolute")
    assert found.reshaped == ()
    assert not any("another shape" in remark for remark in found.remarks)
    assert found.model.effects[0] == soon
