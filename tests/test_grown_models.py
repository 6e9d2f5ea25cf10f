"""Models grown from joints by links, which no measurement tells apart as a whole: identify and diagnose go on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.identify import identify
from symstiff.calibration.redundant import redundant
from symstiff.calibration.rows import predict
from symstiff.calibration.tables.measurements import Measurements
from symstiff.calibration.tables.poses import with_markers
from symstiff.discrepancy.apart.distinguish import distinction
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only
from symstiff.reduction import reduce
from symstiff.robot import load

LINKS = (0, 2, 4)


def grown(name: str, loads: str = "wrench", measure: str = "pose") -> tuple[StiffnessModel, int]:
    """Joints and links, and how many of their parameters are independent: told modulo a prime, link by link."""
    model = joints_only(load(name), loads, measure)
    count = len(model.parameters)
    for link in LINKS:
        count += distinction(model, "link_compliance", {"link": link}).gained
        model = model.with_effect(EffectInstance("link_compliance", {"link": link}))
    return model, count


def experiment(model: StiffnessModel, n: int = 40) -> Measurements:
    """Three markers under loads of the model's class, nothing read yet."""
    rng = np.random.default_rng(6)
    w = rng.normal(size=(n, 6)) * [300, 300, 300, 60, 60, 60]
    w[:, {"wrench": [], "force": [3, 4, 5], "gravity": [0, 1, 3, 4, 5]}[model.loads]] = 0.0
    q = np.array([rng.uniform(*joint.range, n) for joint in model.robot.joint]).T
    table = with_markers(q, w, ("p1", "p2", "p3"))
    return replace(
        table, kind="deflection", values=np.where([True] * 3 + [False] * 3, np.zeros((len(table), 6)), np.nan)
    )


def filled(model: StiffnessModel, sigma: float = 0.0) -> tuple[StiffnessModel, Measurements]:
    """A model with sizes for joints and links, and what the markers do."""
    values = {n: 1e-6 if n[0] == "c" else 2e-8 for n in model.parameters}
    values |= {n: 5e-9 for n in model.parameters if n[0] == "k" and n[-2] != n[-1]}
    return read(model.with_values(values), sigma)


def read(model: StiffnessModel, sigma: float) -> tuple[StiffnessModel, Measurements]:
    """The model, and what the markers do."""
    table = experiment(model)
    moved = predict(model, table) + sigma * np.random.default_rng(3).normal(size=(len(table), 6))
    return model, replace(table, values=np.where(table.measured, moved, np.nan))


@pytest.mark.parametrize("name", ["ur10", "kuka_kr270", "scara"])
@pytest.mark.parametrize(("loads", "measure"), [("wrench", "pose"), ("force", "pose"), ("gravity", "pose")])
def test_as_many_are_redundant_as_the_structure_says(name: str, loads: str, measure: str) -> None:
    model, independent = grown(name, loads, measure)
    held = redundant(model, experiment(model))
    assert len(held) == len(model.parameters) - independent > 0


def test_parameters_without_a_value_are_the_first_to_go() -> None:
    model, _ = grown("kuka_kr270")
    table = experiment(model)
    assert "c1" not in redundant(model.with_values({"c1": 1e-6}), table)
    told = {n: 1e-8 for n in model.parameters if n != "c1"}
    assert "c1" in redundant(model.with_values(told), table)


def test_what_has_no_law_or_other_moments_would_tell_is_not_redundant() -> None:
    """A table without a change of temperature shows no drift; another one would. Outliers are of their table."""
    model, _ = grown("kuka_kr270")
    table = experiment(model)
    alone = redundant(model, table)
    for effect, where, shape in (
        ("thermal_drift", {"link": 3}, {"time": 100.0}),
        ("hysteresis", {"joint": 2}, {"width": 10.0}),
        ("bad_poses", {"rows": [table.labels[0]]}, {}),
        ("large_deflection", {"robot": "all"}, {}),
    ):
        more = model.with_effect(EffectInstance(effect, where, shape))
        still = replace(table, time=np.zeros(len(table)), branch=np.ones(len(table)))
        assert redundant(more, still).keys() == alone.keys()


def test_components_that_were_not_read_make_nothing_redundant() -> None:
    truth, table = filled(grown("kuka_kr270")[0])
    heights = np.where([False, False, True, False, False, False], table.values, np.nan)
    held = redundant(truth, table)
    assert redundant(truth, replace(table, values=heights)).keys() == held.keys()


@pytest.mark.parametrize("robust", [False, True])
def test_identify_keeps_what_nothing_tells_apart(robust: bool) -> None:
    truth, table = filled(grown("kuka_kr270")[0], 1e-7)
    start = truth.with_values({})
    found = identify(load("kuka_kr270"), table, start, robust=robust)
    held = set(redundant(start, table))
    assert held
    assert set(found.fit.names) == set(truth.parameters) - held
    assert not any(found.model.values[n] for n in held)
    assert not held & set(found.model.deviations)
    left = predict(found.model, table) - predict(truth, table)
    assert np.nanmax(np.abs(left[:, :3])) < 1e-6
    (remark,) = (r for r in found.remarks if "no poses and loads of this kind tell them" in r)
    assert all(f"{n} = 0" in remark for n in sorted(held)[:3])


def test_identify_keeps_the_value_that_the_model_has() -> None:
    truth, table = filled(grown("kuka_kr270")[0])
    found = identify(load("kuka_kr270"), table, truth)
    held = redundant(truth, table)
    assert {n: found.model.values[n] for n in held} == {n: truth.values[n] for n in held}
    for n in found.fit.names:
        assert found.model.values[n] == pytest.approx(truth.values[n], rel=1e-6)


def test_physical_compliances_need_a_model_that_was_reduced() -> None:
    truth, table = filled(grown("kuka_kr270")[0], 1e-6)
    with pytest.raises(UserError, match=r"physical: no poses and loads tell .* start from complete"):
        identify(load("kuka_kr270"), table, truth, physical=True)


def test_compliances_beside_an_effect_are_refitted_under_physical_bounds() -> None:
    reduced = StiffnessModel.of(reduce(load("planar2r"), "wrench", "pose"))
    model = reduced.with_effect(EffectInstance("backlash", {"joint": 2}, {"width": 5.0}))
    size = {
        n: 1e-4 if n.startswith("backlash") else -1e-7 if n.endswith("_33") else 2e-7
        for n in model.parameters
    }
    truth, table = read(model.with_values(size), 1e-7)
    free, bounded = (identify(truth.robot, table, model, physical=physical) for physical in (False, True))
    assert bounded.physical is not None
    name = next(n for n in model.parameters if n.startswith("backlash"))
    assert bounded.model.values[name] == pytest.approx(1e-4, rel=0.05)
    assert free.model.values["k1_33"] < 0
    assert bounded.model.values["k1_33"] >= -1e-12
    assert dict(bounded.model.values) == pytest.approx(bounded.physical.to_dict()["parameters"], rel=1e-9)


def test_compliances_that_effects_replaced_have_no_physical_bounds() -> None:
    reduced = StiffnessModel.of(reduce(load("kuka_kr270"), "gravity", "position"))
    model = reduced.with_effect(EffectInstance("link_compliance", {"link": 3}))
    truth, table = read(model.with_values(dict.fromkeys(model.parameters, 2e-7)), 1e-7)
    with pytest.raises(UserError, match="physical: "):
        identify(truth.robot, table, model, physical=True)


@pytest.mark.slow
def test_a_diagnosis_counts_what_can_be_told_and_asks_for_nothing_more(tmp_path: Path) -> None:
    model, independent = grown("kuka_kr270")
    truth, table = filled(model, 5e-6)
    truth.save(tmp_path / "model.toml")
    found = diagnose(Task(load("kuka_kr270"), table, start=str(tmp_path / "model.toml")))
    assert found.verdict == "nothing_missing"
    assert found.steps[0].parameters == independent
    assert any("no poses and loads of this kind tell them from the start model's" in r for r in found.remarks)
    assert not any("would show more" in r for r in found.remarks)
