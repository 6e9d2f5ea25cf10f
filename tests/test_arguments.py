"""What callers pass by mistake is refused in one line that says what was expected; nothing is half done."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import symstiff
from symstiff import Goal, Load, StiffnessModel, Task, UserError
from symstiff.calibration.complete import reconstruct_model
from symstiff.calibration.planning import Search
from symstiff.calibration.simulation import Truth, clean_response, nominal_truth, truth_from_table
from symstiff.calibration.tables.measurements import measurements
from symstiff.codegen.options import Options
from symstiff.codegen.runtime import Evaluator
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.model import joints_only
from symstiff.report.folder import Written
from symstiff.robot import from_table, load, parse
from symstiff.symbolic.numeric import forward
from tests.diagnosis_data import ROBOT, measured

Call = Callable[..., Any]


@pytest.fixture(scope="module")
def model() -> StiffnessModel:
    return StiffnessModel.of(symstiff.reduce(load("planar2r"), "gravity", "position"))


def refused(call: Call, *arguments: Any, **more: Any) -> str:
    with pytest.raises(UserError) as caught:
        call(*arguments, **more)
    text = str(caught.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"load": "gravity"}, "expected a load, found 'gravity'"),
        ({"load": Load("wrench")}, "the model is reduced for gravity loads and these are of class wrench"),
        ({"load": Load(cases=((1.0, 0, 0, 0, 0, 0),))}, "these are of class force"),
        ({"markers": "p1"}, "markers: expected a list of texts, found 'p1'"),
        ({"markers": [1]}, "markers: expected a list of texts"),
        ({"sigma": 3e-5}, "sigma: expected two standard deviations"),
        ({"sigma": (3e-5, "1")}, "sigma: expected radians above zero, found '1'"),
        ({"sigma": (0.0, 1e-4)}, "sigma: expected metres above zero, found 0.0"),
        ({"region": 0.3}, "expected a region, found 0.3"),
        ({"fixed": [1]}, "expected fixed by joint, found [1]"),
        ({"fixed": {1: "a"}}, "fixed: q1: expected a finite number, found 'a'"),
        ({"levels": {2: 1.5}}, "levels: q2: expected a whole number from 1 on, found 1.5"),
        ({"levels": {"q2": 3}}, "levels: expected a whole number from 1 on, found 'q2'"),
        ({"search": 500}, "expected a search, found 500"),
        ({"progress": 3}, "expected a function that is told the progress, found 3"),
    ],
)  # fmt: skip
def test_plans(model: StiffnessModel, arguments: dict[str, Any], told: str) -> None:
    assert told in refused(symstiff.plan, model, Goal(4), **arguments)


@pytest.mark.parametrize("poses", [2.5, -1, 0, float("nan"), "3", True, None])
def test_numbers_of_poses(poses: Any) -> None:
    assert "poses: expected a whole number from 1 on" in refused(Goal, poses)


@pytest.mark.parametrize("options", [{"seed": -1}, {"candidates": 1e3}, {"starts": 0}, {"workers": "all"}])
def test_searches(options: dict[str, Any]) -> None:
    assert f"{next(iter(options))}: expected a whole number" in refused(Search, **options)


@pytest.mark.parametrize("size", [{"force": "a"}, {"force": None}, {"moment": "a"}])
def test_loads(size: dict[str, Any]) -> None:
    assert "expected newton" in refused(Load, "wrench", **size)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"seed": 0.5}, "seed: expected a whole number from 0 on, found 0.5"),
        ({"held_out": "a"}, "held_out: expected a share of the poses, found 'a'"),
        ({"per_level": "q2"}, "per_level: expected a whole number from 1 on, found 'q2'"),
        ({"loads": ["gravity"]}, "loads: unknown ['gravity']"),
        ({"measure": 3}, "measure: unknown 3"),
    ],
)
def test_identifications(arguments: dict[str, Any], told: str) -> None:
    assert told in refused(symstiff.identify, load(ROBOT), measured(), **arguments)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"seed": -1}, "seed: expected a whole number from 0 on, found -1"),
        ({"max_effects": 0}, "max_effects: expected a whole number from 1 on, found 0"),
        ({"max_effects": 1.5}, "max_effects: expected a whole number"),
        ({"max_poses": "5"}, "max_poses: expected a whole number"),
        ({"loads": 3}, "loads: unknown 3"),
    ],
)
def test_diagnoses(arguments: dict[str, Any], told: str) -> None:
    assert told in refused(diagnose, Task(load(ROBOT), measured(), **arguments))


def test_simulations() -> None:
    truth = Truth(load(ROBOT), nominal_truth(load(ROBOT)), ())
    for seed in (-1, 1.5, "a"):
        assert "seed: expected a whole number" in refused(symstiff.simulate, truth, measured(), seed)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"loads": ["gravity"]}, "loads: unknown ['gravity']: use"),
        ({"measure": {"pose": 1}}, "measure: unknown"),
        ({"points": "p1"}, "points: expected a list of texts, found 'p1'"),
        ({"prefer": "c2"}, "prefer: expected a list of texts, found 'c2'"),
        ({"avoid": {"c2": 1}}, "avoid: expected a list of texts"),
    ],
)
def test_reductions(arguments: dict[str, Any], told: str) -> None:
    assert told in refused(symstiff.reduce, load("planar2r"), **arguments)


def test_models(model: StiffnessModel) -> None:
    q, w = np.zeros((2, 2)), np.zeros((2, 6))
    for values in (None, [1.0], {"c1": "a"}, {"c1": float("nan")}, {3: 1.0}):
        assert refused(model.with_values, values).startswith(
            ("expected values", "values:", "planar2r: the model has no")
        )
    assert "values: c1: expected a finite number" in refused(model.deflection, q, w, values={"c1": "a"})
    for way in (model.deflection, model.observation):
        assert refused(way, [0.0, math.nan], w) == "q: row 0 holds what is no finite number: correct it"
        assert refused(way, q, [[0] * 6, [0, math.inf, 0, 0, 0, 0]]).startswith("w: row 1 holds")
        with pytest.raises(TypeError, match="positional"):  # values are taken for no context
            way(q, w, {"c1": 1e-6})  # type: ignore[misc]
    for threads in (-1, 0, 1.5, "a"):
        assert "threads: expected a whole number from 1 on" in refused(model.compile, threads)


def test_compensations(model: StiffnessModel) -> None:
    """As a model's own methods: shapes with what was expected, columns by name."""
    arm = StiffnessModel.of(symstiff.reduce(load("ur10"), "gravity", "pose")).with_effect(
        EffectInstance("thermal_drift", {"link": 2})
    )
    q, w = np.zeros((3, 6)), np.zeros((3, 6))
    for call in (symstiff.compensate, symstiff.compensation.compensate_online):
        assert "q: expected an array of shape (N, 6)" in refused(call, arm, q[:, :5], w)
        assert "q: expected numbers of shape (N, 6)" in refused(call, arm, "abc", w)
        assert "w: expected an array of shape (N, 6)" in refused(call, arm, q, w[:, :3])
        assert "expected as many rows" in refused(call, arm, q, w[:2])
        assert "expected a context, found 3" in refused(call, arm, q, w, context=3)
        context = {"temperature": np.zeros(2)}
        assert "expected an array of shape (3,)" in refused(call, arm, q, w, context=context)
        context = {"temperature": "warm"}
        assert "expected numbers of shape (3,)" in refused(call, arm, q, w, context=context)
        assert "the model needs the column time" in refused(call, arm, q, w, context={})


@pytest.mark.parametrize("place", [None, 5, ["a"]])
def test_places(model: StiffnessModel, place: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for call, *first in (
        (model.save,), (symstiff.write_table, measured()), (symstiff.generate, model), (symstiff.load_model,),
        (symstiff.load_truth,), (symstiff.load,),
    ):  # fmt: skip
        assert "expected the path of" in refused(call, *first, place)
    assert not list(tmp_path.iterdir())


def test_tables(tmp_path: Path) -> None:
    assert "expected the path of a table, found 5" in refused(symstiff.read_table, [5])
    assert "in rad or deg" in refused(symstiff.write_table, measured(), tmp_path / "t.csv", "foo")
    assert not list(tmp_path.iterdir())


def test_options_of_code(model: StiffnessModel, tmp_path: Path) -> None:
    told = refused(symstiff.generate, model, tmp_path / "c", {"precision": "float"})
    assert "expected options, found {'precision': 'float'}" in told
    assert "targets: expected a list of texts, found 'c'" in refused(Options, targets="c")
    assert not list(tmp_path.iterdir())


def test_what_a_report_left_is_a_line_in_a_notebook(tmp_path: Path) -> None:
    written = Written(tmp_path / "out", {"verdict": "named", "candidates": [{}] * 200}, "compiled by cc")
    assert (
        repr(written)
        == f"Written({str(tmp_path / 'out')!r}: report.html, verdict.json, model.toml; compiled by cc)"
    )


BACKLASH = EffectInstance("backlash", {"joint": 1})


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda m: m.with_effect("backlash"), "effects: expected a list, [EffectInstance('backlash', {'joint': 2})]"),
        (lambda m: m.with_effects(None), "effects: expected a list"),
        (lambda m: m.with_effects(BACKLASH), "effects: expected a list"),
        (lambda m: m.with_effects([BACKLASH, 3]), "is one, found 3"),
        (lambda m: StiffnessModel(m.robot, m.compliances, effects=["backlash"]), "is one, found 'backlash'"),
        (lambda m: StiffnessModel(m.robot, m.compliances, loads="zz"), "loads: unknown 'zz': use wrench"),
        (lambda m: StiffnessModel(m.robot, m.compliances, measure="zz"), "measure: unknown 'zz': use pose"),
        (lambda m: m.with_effect(EffectInstance("backlash", {"joint": 9})), "backlash cannot be at {'joint': 9}"),
        (
            lambda m: m.with_effect(EffectInstance("hysteresis", {"joint": 1}, {"widht": 5.0})),
            "hysteresis at {'joint': 1} knows no shape key 'widht': correct or remove it",
        ),
        (
            lambda m: m.with_effect(EffectInstance("backlash", {"joint": 1}, {"wdth": 5.0})),
            "backlash at {'joint': 1} knows no shape key 'wdth': correct or remove it",
        ),
    ],
)  # fmt: skip
def test_effects_of_a_model(model: StiffnessModel, call: Call, told: str) -> None:
    assert told in refused(call, model)
    assert model.with_effects([BACKLASH]).effects == model.with_effect(BACKLASH).effects == (BACKLASH,)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"q": "a"}, "q: expected numbers of shape (M, n)"),
        ({"q": np.zeros((2, 2, 2))}, "q: expected an array of shape (M, n), found (2, 2, 2)"),
        ({"w": np.zeros((2, 5))}, "w: expected an array of shape (3, 6), found (2, 5)"),
        ({"w": "down"}, "w: expected numbers of shape (3, 6)"),
        ({"values": [["a"] * 6] * 3}, "values: expected numbers of shape (3, 6)"),
        ({"time": [1.0, 2.0]}, "time: expected an array of shape (3,), found (2,)"),
        ({"branch": [1.0, np.nan, 5.0]}, "branch: expected 1 (up), -1 (down) or NaN, found 5"),
        ({"kind": "zz"}, "kind: expected deflection, absolute, none, found 'zz'"),
        ({"pose": [0, 1, 2], "labels": ["a", "b"]}, "pose: 2 is beyond the 2 names that are given"),
        ({"pose": [0, 1, 1.5]}, "pose: expected whole numbers from 0 on"),
        ({"point": [0, 1, 0]}, "point: 1 is beyond the 1 names that are given"),
        ({"point": [0, -1, 0]}, "point: expected whole numbers from 0 on"),
        ({"point": [0, np.nan, 0]}, "point: expected whole numbers from 0 on"),
        ({"points": "p1"}, "points: expected a list of texts, found 'p1'"),
        ({"joint_units": ["rad"]}, "joint_units: expected rad or m for each of 2 joints, found rad"),
        ({"joint_units": ["rad", "deg"]}, "joint_units: expected rad or m for each of 2 joints, found rad, deg"),
    ],
)  # fmt: skip
def test_tables_of_arrays(arguments: dict[str, Any], told: str) -> None:
    given = {"q": np.zeros((3, 2)), "w": np.zeros(6)} | arguments
    assert told in refused(measurements, **given)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"q": [[0.1, 0.2, 0.3]]}, "3 joint columns, robot planar2r has 2 joints"),
        ({"q": [[0.1]]}, "1 joint columns, robot planar2r has 2 joints"),
        ({"w": [[0] * 7]}, "w: expected an array of shape (1, 6), found (1, 7)"),
        ({"context": {"kind": "zz"}}, "kind: expected deflection or absolute, found 'zz'"),
        ({"context": {"tme": 3.0}}, "context: unknown 'tme': known are branch, kind"),
        ({"context": 3}, "expected a context, found 3"),
        ({"context": {"points": ["p9"]}}, "has no marker 'p9'"),
        ({"truth": "planar2r"}, "expected what is true, found 'planar2r'"),
    ],
)
def test_responses_of_a_truth(arguments: dict[str, Any], told: str) -> None:
    truth = Truth(load(ROBOT), nominal_truth(load(ROBOT)), ())
    given = {"truth": truth, "q": [[0.1, 0.2]], "w": [[0, 10, 0, 0, 0, 0]]} | arguments
    assert told in refused(clean_response, **given)


CHAIN = symstiff.ElasticChain(load(ROBOT))
RED = symstiff.reduce(load(ROBOT), "gravity")


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: RED.full_values({"k9_66": 1e-7}), "reduced: 'k9_66' is no parameter of the identifiable set"),
        (lambda: RED.full_values({RED.parameters[0]: math.nan}), "expected a finite number"),
        (lambda: RED.full_values({}, {RED.parameters[0]: 1e-7}), "is no eliminated parameter of planar2r"),
        (lambda: RED.reduced_values({"c9": 1.0}), "full: 'c9' is no parameter after M3 of planar2r"),
        (lambda: RED.reduced_values(None), "expected full by name, found None"),
        (lambda: nominal_truth("planar2r"), "expected a robot, found 'planar2r'"),
        (lambda: joints_only("kuka"), "expected a robot, found 'kuka'"),
        (lambda: truth_from_table(None), "expected a truth as a table, found None"),
        (lambda: from_table(None), "expected a robot as a table, found None"),
        (lambda: parse("text"), "expected the bytes of a robot file, found 'text'"),
        (lambda: reconstruct_model(RED), "expected an identification, found"),
        (lambda: forward(load(ROBOT), np.zeros((1, 5))), "q: expected an array of shape (N, 2), found (1, 5)"),
        (lambda: forward("ur10", [0.1]), "expected a robot, found 'ur10'"),
        (lambda: symstiff.observation_matrix(CHAIN, W=5), "expected a wrench W, found 5"),
        (lambda: symstiff.observation_matrix(CHAIN, None, ["c1"]), "terms: expected a list"),
        (lambda: symstiff.observation_matrix(CHAIN, None, 3), "terms: expected a list"),
    ],
)  # fmt: skip
def test_values_and_robots(call: Call, told: str) -> None:
    assert told in refused(call)


def test_reduced_values_that_are_left_out_are_zero() -> None:
    name = RED.parameters[0]
    assert {n: v for n, v in RED.full_values({name: 2e-7}).items() if v} == {name: 2e-7}


def test_compiled_models(model: StiffnessModel) -> None:
    evaluator = Evaluator(model, None)
    q, w = np.zeros((2, 2)), np.zeros((2, 6))
    for method in (evaluator.deflection, evaluator.observation):
        assert "q: expected numbers of shape (N, 2)" in refused(method, "a", w)
        assert "q: expected numbers of shape (N, 2)" in refused(method, [[0.1, 0.2], [0.1]], w)
        assert "w: expected numbers of shape (N, 6)" in refused(method, q, "down")
        assert "q: expected an array of shape (N, 2), found (2, 6)" in refused(method, w, w)


def test_progress_of_generation(model: StiffnessModel, tmp_path: Path) -> None:
    told = refused(symstiff.generate, model, tmp_path / "c", progress="yes")
    assert "expected a function that is told the progress, found 'yes'" in told
    assert not list(tmp_path.iterdir())
