"""An effect from outside the package, from data that contain it to the report, by the program alone."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

import symstiff
from symstiff.calibration.identify import identify
from symstiff.calibration.tables.table import read_table
from symstiff.codegen.compiler import find_compiler
from symstiff.discrepancy.apart.distinguish import distinction
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects import EffectInstance, catalogue
from symstiff.model import StiffnessModel, load_model
from symstiff.reduction import reduce
from symstiff.robot import load
from symstiff.symbolic.latex import letter
from tests.diagnosis_data import ROBOT, design, saved
from tests.plugins import discovered, install

SIZE, PHASE = 6e-7, 0.4
"""Of what is hidden: joint 1 gives way by SIZE·cos(3·q2 + PHASE)·τ1 more than it should."""
WHERE = {"joints": [1, 2]}
TRUTH = f"""
format = 1
robot = "{ROBOT}"
noise = {{ sigma_mm = 0.02 }}
[[effect]]
effect = "angle_dependent_compliance"
where = {{ joints = [1, 2] }}
shape = "cosine"
c = {SIZE}
order = 3.0
phase = {PHASE}
"""


def command(*arguments: object, plugin: Path | None = None) -> None:
    """Run the program in a process of its own, with or without the plugin on its path."""
    paths = [str(Path(symstiff.__file__).parents[1]), *([str(plugin)] if plugin else [])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [sys.executable, "-m", "symstiff", *map(str, arguments)], env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plugin, data of an arm with hoses, and the folder of its diagnosis with the plugin installed."""
    place = tmp_path_factory.mktemp("plugin")
    install(place)
    (place / "truth.toml").write_text(TRUTH)
    saved(design(), place / "poses.csv")
    command("simulate", place / "truth.toml", "--poses", place / "poses.csv", "-o", place / "data.csv")
    command("diagnose", ROBOT, place / "data.csv", "-o", place / "with", plugin=place)
    return place


@pytest.fixture
def installed(place: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The plugin in this process too."""
    with discovered(place, monkeypatch):
        yield place


def verdict_of(folder: Path) -> Any:
    return json.loads((folder / "verdict.json").read_text())


def test_the_package_does_not_know_the_effect() -> None:
    sources = Path(symstiff.__file__).parent.rglob("*")
    text = "".join(p.read_text(errors="ignore") for p in sources if p.suffix in (".py", ".toml", ".j2"))
    assert "nonlinear_stiffness" in text
    assert "hose_package" not in text
    assert "hose_package" not in catalogue()


@pytest.mark.slow
def test_without_the_plugin_its_effect_gets_no_name_of_the_catalogue(place: Path) -> None:
    found = diagnose(Task(load(ROBOT), read_table(place / "data.csv")))
    assert found.verdict in ("unexplained", "named_insufficient")


def test_diagnose_names_it_at_its_place(place: Path) -> None:
    verdict = verdict_of(place / "with")
    assert verdict["verdict"] == "named"
    (effect,) = verdict["effects"]
    assert (effect["effect"], effect["where"]) == ("hose_package", WHERE)
    assert effect["confidence"] > 0.8
    assert verdict["rms_mm"]["held_out_after"] < 1.2 * verdict["rms_mm"]["noise"]
    a, b = (effect["parameters"][f"hose_package_1_2_{w}"] for w in "ab")
    assert a["value"] == pytest.approx(SIZE * np.cos(PHASE), abs=4 * a["std"])
    assert b["value"] == pytest.approx(-SIZE * np.sin(PHASE), abs=4 * b["std"])


def test_exact_reduction_tells_which_of_its_effects_stand_out(installed: Path) -> None:
    model = StiffnessModel.of(reduce(load(ROBOT), "force", "pose"))
    hoses = distinction(model, "hose_package", WHERE)
    assert (hoses.distinguishable, hoses.gained, hoses.inside) == (True, 2, ())
    belt = distinction(model, "soft_belt", {"joint": 1})
    assert (belt.distinguishable, belt.inside) == (False, ("soft_belt_1_c",))
    listed = [c for c in verdict_of(installed / "with")["candidates"] if c["effect"] == "soft_belt"]
    assert [c["testable"] for c in listed] == [False, False]
    assert all("combinations of the model" in c["reason"] for c in listed)


def test_the_grown_model_loads_and_is_identified_again(installed: Path) -> None:
    grown = load_model(installed / "with" / "model.toml")
    assert [(e.effect, dict(e.where)) for e in grown.effects] == [("hose_package", WHERE)]
    table = read_table(installed / "data.csv")
    again = identify(load(ROBOT), table, str(installed / "with" / "model.toml")).model
    for name in ("hose_package_1_2_a", "hose_package_1_2_b"):
        assert again.values[name] == pytest.approx(grown.values[name], abs=again.deviations[name])
        assert 0 < again.deviations[name] < 0.1 * SIZE


def test_its_law_stands_in_the_latex_of_the_model(installed: Path) -> None:
    text = load_model(installed / "with" / "model.toml")._repr_latex_()
    assert letter(sp.Symbol("hose_package_1_2_a")) in text
    assert r"\cos{\left(3\,q_{2} \right)}" in text


def test_c_and_casadi_evaluate_it_and_the_self_test_passed(installed: Path) -> None:
    import casadi as ca

    code, model = installed / "with" / "code", load_model(installed / "with" / "model.toml")
    manifest = json.loads((code / "manifest.json").read_text())
    assert list(manifest["effect_parameters"]) == ["hose_package_1_2_a", "hose_package_1_2_b"]
    assert manifest["verified"]["compiled"] == (find_compiler() is not None)
    assert manifest["verified"]["max_relative_error"] < 1e-9
    assert "p->hose_package_1_2_a" in (code / f"{ROBOT}.c").read_text()
    table = read_table(installed / "data.csv")
    function = ca.Function.load(str(code / f"{ROBOT}_deflection.casadi"))
    columns = [
        np.array(function(model.vector(), q, w)).ravel() for q, w in zip(table.q, table.w, strict=True)
    ]
    np.testing.assert_allclose(columns, model.deflection(table.q, table.w), atol=1e-15)


def test_the_report_shows_its_term_and_what_it_changed_in_the_code(place: Path) -> None:
    page = (place / "with" / "report.html").read_text()
    assert "What is missing: hose package between joints 1, 2" in page
    assert "Hoses along the arm pull the joint back" in page
    laws = page[page.index('id="laws"') : page.index('id="candidates"')]
    assert "joint1 += hose_package_1_2_a*(tau_joint1*cos(3*q_2)) + hose_package_1_2_b*" in laws
    assert "<svg" in laws
    code = page[page.index('id="code"') :]
    assert '<span class="add">' in code
    assert "p-&gt;hose_package_1_2_a" in code


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder whose distributions are installed in this process."""
    with discovered(tmp_path, monkeypatch):
        yield tmp_path


@pytest.mark.slow
def test_the_documents_example_is_a_whole_plugin(path: Path) -> None:
    page = (Path(__file__).parent.parent / "docs" / "plugins.md").read_text(encoding="utf-8")
    (project,), (module,) = (
        re.findall(rf"```{kind}\n(.*?)```", page, re.DOTALL) for kind in ("toml", "python")
    )
    points = tomllib.loads(project)["project"]["entry-points"]["symstiff.effects"]
    install(path, "angle_dependent_gear", module, "".join(f"{n} = {at}\n" for n, at in points.items()))
    command("effects", ROBOT, "--json", path / "effects.json", plugin=path)
    (listed,) = (
        e
        for e in json.loads((path / "effects.json").read_text())["effects"]
        if e["effect"] == "angle_dependent_gear"
    )
    assert [p["told"] for p in listed["places"]] == [2, 2]
    gear = EffectInstance("angle_dependent_gear", {"joint": 2}, {"order": 3.0})
    plain = StiffnessModel.of(reduce(load(ROBOT)))
    grown = plain.with_effect(gear).with_values(
        dict(plain.values) | {"angle_dependent_gear_2_c": 4e-6, "angle_dependent_gear_2_s": -2e-6}
    )
    grown.save(path / "model.toml")
    q, force = np.array([0.3, 0.8]), np.array([20.0, 50.0, 0.0])
    added = load_model(path / "model.toml").deflection(q, [*force, 0, 0, 0]) - plain.deflection(
        q, [*force, 0, 0, 0]
    )
    # by hand: the lever from joint 2 to the tool of a planar arm, and the turn about z that its torque makes
    length = float(load(ROBOT).joint[1].a)
    lever = length * np.array([np.cos(q.sum()), np.sin(q.sum())])
    torque = lever[0] * force[1] - lever[1] * force[0]
    turn = (4e-6 * np.cos(3 * q[1]) - 2e-6 * np.sin(3 * q[1])) * torque
    by_hand = [-lever[1] * turn, lever[0] * turn, 0, 0, 0, turn]
    np.testing.assert_allclose(added[0], by_hand, rtol=1e-9, atol=1e-12)
