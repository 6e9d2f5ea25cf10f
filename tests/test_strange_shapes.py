"""Shapes and places that nobody means are refused in a line; NumPy's numbers are numbers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.effects import EffectInstance
from symstiff.errors import UserError
from symstiff.model import joints_only, load_model
from symstiff.robot import from_table, load
from symstiff.robot.table import to_table

SPRING = {"a": 0.7, "L": 0.2, "s0": 0.46}


@pytest.mark.parametrize(
    ("effect", "shape", "why"),
    [
        ("nonlinear_stiffness", {"load": 100.0, "power": 1e6}, "power = 1e+06: give one from 0 to 10"),
        ("nonlinear_stiffness", {"load": 100.0, "power": -3.0}, "power = -3: give one from 0 to 10"),
        ("hysteresis", {"width": 5.0, "load": 100.0, "power": 300.0}, "power = 300: give one from 0 to 10"),
        ("backlash", {"width": 1e-320}, "give a size from 1e-12 to 1e+12"),
        ("backlash", {"width": 5.0, "mass": 1e300}, "give a size from 1e-12 to 1e+12"),
        ("backlash", {"width": "wide"}, "expected a finite number"),
        ("backlash", {"width": float("inf")}, "expected a finite number"),
        ("backlash", None, "give a dictionary"),
        ("gravity_compensator", {**SPRING, "a": 0.0}, "give distances above zero"),
        ("gravity_compensator", {**SPRING, "L": 0.7}, "the spring's anchors meet"),
        ("gravity_compensator", {**SPRING, "ratio": 1.5}, "the joint is not stiff at every angle"),
    ],
)  # fmt: skip
def test_a_shape_that_nobody_means_is_refused(effect: str, shape: Any, why: str) -> None:
    with pytest.raises(UserError) as refused:
        EffectInstance(effect, {"joint": 2}, shape).realise(load("ur10"))
    assert why in str(refused.value)


@pytest.mark.parametrize("where", [None, [2], {"joint": "2"}, {"joint": 2.5}, {"joint": 99}])
def test_a_place_that_is_none_is_refused(where: Any) -> None:
    with pytest.raises(UserError):
        EffectInstance("backlash", where, {"width": 5.0}).realise(load("ur10"))


def test_numpy_s_numbers_are_numbers(tmp_path: Path) -> None:
    model = joints_only(load("ur10"))
    gap = EffectInstance("backlash", {"joint": np.int64(2)}, {"width": np.float64(5.0)})
    error = EffectInstance("transmission_error", {"joint": 3.0, "harmonics": np.array([1, 2])})
    assert gap == EffectInstance("backlash", {"joint": 2}, {"width": 5})
    assert error == EffectInstance("transmission_error", {"joint": 3, "harmonics": [1, 2]})
    grown = model.with_effect(gap).with_effect(error)
    grown.save(tmp_path / "model.toml")
    assert load_model(tmp_path / "model.toml").effects == grown.effects


def test_a_model_file_with_such_a_shape_is_bad_input(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    joints_only(load("ur10")).with_effect(
        EffectInstance("nonlinear_stiffness", {"joint": 2}, {"load": 100.0, "power": 3.0})
    ).save(path)
    for wrong, why in (("3e300", "give a size from"), ("30.0", "give one from 0 to 10")):
        path.write_text(path.read_text().replace("power = 3.0", f"power = {wrong}"))
        assert_users_mistake(run("generate", "ur10", "--model", path, "-o", tmp_path / "code"), why)
        path.write_text(path.read_text().replace(f"power = {wrong}", "power = 3.0"))


@pytest.mark.parametrize("where", ["true", "2.5", "[true]", '[1, "a"]', "[[1]]", "{a = 1}"])
def test_a_place_of_a_wrong_type_is_named_with_what_is_expected(where: str, tmp_path: Path) -> None:
    path = waves([1], tmp_path)
    path.write_text(path.read_text().replace("harmonics = [1]", f"harmonics = {where}"))
    with pytest.raises(UserError) as refused:
        load_model(path)
    expected = "expected a whole number, a name, or a list of numbers or names"
    assert f"effect[1].where.harmonics: {expected}, found" in str(refused.value)


@pytest.mark.parametrize("harmonics", [[0.5], [7, 0.5], [1, 2], [2.0]])
def test_harmonics_that_are_no_whole_numbers_are_read_back(harmonics: list[float], tmp_path: Path) -> None:
    (effect,) = load_model(waves(harmonics, tmp_path)).effects
    assert effect == EffectInstance("transmission_error", {"joint": 2, "harmonics": harmonics})


def waves(harmonics: list[float], folder: Path) -> Path:
    """A model file with a gear's waves, its list in one line."""
    path = folder / "model.toml"
    effect = EffectInstance("transmission_error", {"joint": 2, "harmonics": harmonics})
    joints_only(load("ur10")).with_effect(effect).save(path)
    path.write_text(
        re.sub(r"harmonics = \[\s*(.*?),?\s*\]", r"harmonics = [\1]", path.read_text(), flags=re.DOTALL)
    )
    return path


def test_a_spring_whose_ends_meet_is_no_spring() -> None:
    table = to_table(load("kuka_kr270"))
    table["gravity_compensator"] = {"joint": 2, "L": 0.5, "ax": 0.3, "ay": 0.4, "s0": 0.46}
    with pytest.raises(UserError, match="at one angle both ends meet"):
        from_table(table)
