"""A second campaign: effects of the start model that changed their shape or size since the first, or are gone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Environment, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.bridge.growth import fit
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.since import since
from symstiff.discrepancy.outgrown import accounts_better, outgrown
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance
from symstiff.model import StiffnessModel, joints_only
from symstiff.report.verdict import verdict_table
from symstiff.report.words import headline, sentence
from symstiff.robot import load

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
    assert sentence(found).endswith("The start model has thermal drift at link 2 in another shape.")
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


@pytest.mark.parametrize(
    ("now", "said"),
    [((lash(gap=9e-4),), "its size has changed"), ((), "nothing is left of it"), ((lash(),), None)],
    ids=["larger", "gone", "as it was"],
)
def test_sizes_that_do_not_hold_any_more_are_remarked(now: tuple[Effect, ...], said: str | None) -> None:
    told = start(LASH, {"backlash_3_gap": 5e-4}, 1e-5)
    remarks = since(told, fit(told, campaign(*now)).model)
    assert len(remarks) == (said is not None)
    if said:
        assert remarks[0].startswith(f"backlash at joint 3: {said}")
        assert "backlash_3_gap 0.500 ± 0.010 mrad, now" in remarks[0]


def test_a_size_of_which_the_start_model_does_not_tell_how_sure_it_is_is_not_remarked() -> None:
    told = start(LASH, {"backlash_3_gap": 5e-4})
    bare = told.with_values(told.values)
    assert since(bare, fit(bare, campaign()).model) == []
