"""symstiff diagnose from table to folder: what it says, what it leaves behind, what it refuses."""

from __future__ import annotations

import json
import math
import tomllib
import warnings
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.tables.measurements import Measurements
from symstiff.calibration.tables.table import read_poses, read_table
from symstiff.codegen.compiler import find_compiler
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.findings.remarks import remarked
from symstiff.discrepancy.findings.result import Name
from symstiff.discrepancy.findings.used import MOST_POSES, thinned
from symstiff.discrepancy.reasons import Why
from symstiff.discrepancy.workflow import diagnose
from symstiff.model import load_model
from symstiff.report import words
from symstiff.robot import load
from tests.diagnosis_data import HARDENING, ROBOT, design, measured, saved

UR10 = Path(__file__).resolve().parents[2] / "shared" / "data" / "ur10" / "series_a.csv"


def command(*arguments: object) -> int:
    """Run the program as from a shell; the exit code."""
    import sys
    from unittest.mock import patch

    from symstiff.cli import main

    with patch.object(sys, "argv", ["symstiff", *map(str, arguments)]):
        try:
            main()
        except SystemExit as stop:
            return int(stop.code or 0)
    return 0


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an arm whose second gear hardens."""
    place = tmp_path_factory.mktemp("named")
    data = saved(measured(HARDENING), place / "data.csv")
    assert command("diagnose", ROBOT, data, "-o", place / "out", "--json", place / "out.json") == 0
    return place / "out"


@pytest.fixture(scope="module")
def verdict(named: Path) -> dict[str, object]:
    return json.loads((named / "verdict.json").read_text())  # type: ignore[no-any-return]


def test_a_hardening_gear_is_named_at_its_joint(verdict: dict) -> None:
    assert verdict["verdict"] == "named"
    assert [(e["effect"], e["where"]) for e in verdict["effects"]] == [("nonlinear_stiffness", {"joint": 2})]


def test_the_verdict_has_the_keys_that_other_programs_rely_on(verdict: dict) -> None:
    effect, candidate = verdict["effects"][0], verdict["candidates"][0]
    assert {"effect", "where", "parameters", "p_value", "confidence", "confounded_with"} <= set(effect)
    assert all({"value", "std", "unit"} == set(p) for p in effect["parameters"].values())
    wanted = {"effect", "where", "p_value", "testable", "sufficient", "smallest_detectable"}
    assert wanted <= set(candidate)
    assert {"value", "unit"} <= set(candidate["smallest_detectable"])
    (leading,) = verdict["leading"]
    assert all(effect[key] == leading[key] for key in ("effect", "where", "shape"))
    assert set(leading["parameters"]) == set(effect["parameters"])
    assert verdict["rival"] is None or set(verdict["rival"]) == {"place", "law", "lead"}
    assert set(verdict["rms_mm"]) == {"before", "after", "held_out_before", "held_out_after", "noise"}
    assert 0 <= effect["p_value"] < 0.01
    assert 0.5 < effect["confidence"] <= 1


def test_the_gap_closes_down_to_the_noise_on_held_out_poses(verdict: dict) -> None:
    rms = verdict["rms_mm"]
    assert rms["noise"] == pytest.approx(0.02, rel=0.25)
    assert rms["before"] > 1.5 * rms["noise"]
    assert rms["held_out_after"] < 1.15 * rms["noise"]


def test_json_on_request_is_the_verdict(named: Path, verdict: dict) -> None:
    assert json.loads((named.parent / "out.json").read_text()) == verdict


def test_the_grown_model_predicts_the_data_to_the_noise(named: Path, verdict: dict) -> None:
    from symstiff.calibration.rows import predict

    model = load_model(named / "model.toml")
    table = read_table(named.parent / "data.csv")
    assert model.seen["q2"] == (table.q[:, 1].min(), table.q[:, 1].max())
    left = (table.values - predict(model, table))[:, :3]
    assert 1e3 * math.sqrt(float(np.mean(left**2))) == pytest.approx(verdict["rms_mm"]["after"], rel=0.05)
    assert [e.effect for e in model.effects] == ["nonlinear_stiffness"]
    for name, p in verdict["effects"][0]["parameters"].items():
        assert model.values[name] == pytest.approx(p["value"])
        assert model.deviations[name] == pytest.approx(p["std"])


def test_the_code_is_regenerated_with_the_effect(named: Path) -> None:
    manifest = json.loads((named / "code" / "manifest.json").read_text())
    with (named / "code" / "model.toml").open("rb") as file:
        model = tomllib.load(file)
    assert [e["effect"] for e in model["effect"]] == ["nonlinear_stiffness"]
    assert len(manifest["effect_parameters"]) == 1
    assert manifest["verified"]["compiled"] == (find_compiler() is not None)
    assert manifest["verified"]["max_relative_error"] < 1e-9


def test_a_folder_of_an_earlier_diagnosis_is_replaced_and_a_foreign_one_refused(
    named: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = tmp_path / "mine"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("years of work")
    assert command("diagnose", ROBOT, named.parent / "data.csv", "-o", foreign) == 2
    assert "thesis.txt" in capsys.readouterr().err
    assert (foreign / "thesis.txt").read_text() == "years of work"


def test_an_arm_with_nothing_missing_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = saved(measured(), tmp_path / "data.csv")
    assert command("diagnose", ROBOT, data, "-o", tmp_path / "out") == 0
    found = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert (found["verdict"], found["effects"]) == ("nothing_missing", [])
    assert found["rms_mm"]["before"] == found["rms_mm"]["after"] == pytest.approx(0.02, rel=0.15)
    seen = [c for c in found["candidates"] if c["testable"]]
    assert seen
    assert all(c["smallest_detectable"]["value"] > 0 for c in seen)
    assert "accounts for the data" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_a_fault_in_the_code_loses_no_verdict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyError("DiracDelta")

    monkeypatch.setattr("symstiff.codegen.generate.generate", broken)
    data = saved(measured(HARDENING, poses=6), tmp_path / "data.csv")
    assert command("diagnose", ROBOT, data, "-o", tmp_path / "out") == 1
    kept = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert kept["effects"][0]["effect"] == "nonlinear_stiffness"
    assert "a fault of ours: KeyError: 'DiracDelta'" in kept["code"]["text"]
    assert "fault of ours" in (tmp_path / "out" / "report.html").read_text()
    assert not (tmp_path / "out" / "code").exists()


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_one_pose_without_sigma_or_repeats_is_untestable_and_no_error(tmp_path: Path, rows: int) -> None:
    table = measured(stated=0.0, poses=1, levels=(1.0,))
    data = saved(table.select(np.arange(rows)), tmp_path / "data.csv")
    assert command("diagnose", ROBOT, data, "-o", tmp_path / "out") == 0
    found = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert (found["verdict"], found["testable"], found["effects"]) == ("unexplained", False, [])
    assert not any(c["testable"] for c in found["candidates"])
    assert "measure more poses" in found["reason"]
    assert (found["p_missing"], found["p_unnamed"], found["steps"][0]["p_left"]) == (None, None, None)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "from what the model leaves" in page
    assert "everything found" not in page


def test_a_small_rest_that_passes_for_a_shape_is_told_with_what_it_looks_like() -> None:
    found = diagnose(Task(load(ROBOT), measured(HARDENING)))
    view, last = found.assembly.situation.view, found.last
    end = last.growth[-1]
    assert end.further is not None
    assert end.further.effect != "nonlinear_stiffness"
    assert not any("no noise" in r for r in remarked(view, last))  # p is large there
    rest = replace(end, p_left=4e-4, further=Name("large_deflection", {"model": "all"}))
    (said,) = [r for r in remarked(view, replace(last, growth=(*last.growth[:-1], rest))) if "no noise" in r]
    assert "p = 0.0004" in said
    assert "most like large deflection" in said


def test_a_search_that_stops_at_the_most_effects_says_so() -> None:
    """The second effect is clearly there, and would be named: it is not too faint."""
    table = measured(HARDENING, HARDENING | {"where": {"joint": 1}}, poses=14)
    both = diagnose(Task(load(ROBOT), table))
    assert (both.verdict, len(both.named)) == ("named", 2)
    one = diagnose(Task(load(ROBOT), table, max_effects=1))
    assert one.verdict == "named_insufficient"
    assert one.because.why is Why.ENOUGH
    told = words.sentence(one)
    assert "stands out beside as many effects as were looked for: allow more (--max-effects)" in told
    assert "too faint" not in told


def test_one_row_says_nothing_of_its_sigma(tmp_path: Path) -> None:
    data = saved(measured(poses=1, levels=(1.0,)), tmp_path / "data.csv")
    first = data.read_text().splitlines()[:2]
    data.write_text("\n".join(first) + "\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert command("diagnose", ROBOT, data, "-o", tmp_path / "out") == 0
    found = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert (found["testable"], found["noise"]["misstated"], found["noise"]["ratio"]) == (False, False, None)
    assert not any("stated sigma" in remark for remark in found["remarks"])


@pytest.mark.parametrize(
    ("text", "clue"),
    [
        ("pose,q1[deg],q2[deg]\np1,0,0\n", "dx"),
        ("pose,q1[deg],q2[deg],fx[N],dx[mm]\np1,0,0,10\n", "line 2"),
        ("pose,q1[deg],q2[deg],q3[deg],fx[N],dx[mm]\np1,0,0,0,10,1\n", "joint"),
    ],
)
def test_a_bad_table_is_refused_in_one_line_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, clue: str
) -> None:
    (tmp_path / "data.csv").write_text(text)
    assert command("diagnose", ROBOT, tmp_path / "data.csv", "-o", tmp_path / "out") == 2
    error = capsys.readouterr().err.strip()
    assert clue in error
    assert "\n" not in error
    assert [p.name for p in tmp_path.iterdir()] == ["data.csv"]


def test_a_plan_separates_the_explanations_of_a_verdict(tmp_path: Path) -> None:
    hardening = {"nonlinear_stiffness_2_c": {"value": 3e-6, "std": 1e-7, "unit": "rad/(N*m)"}}
    gap = {"backlash_2_gap": {"value": 1e-3, "std": 1e-5, "unit": "rad"}}
    effects = [
        {"effect": "nonlinear_stiffness", "where": {"joint": 2}, "parameters": hardening, "set": 0},
        {"effect": "backlash", "where": {"joint": 2}, "parameters": gap, "set": 1},
    ]
    (tmp_path / "verdict.json").write_text(json.dumps({"robot": ROBOT, "effects": effects}))
    arguments = ("plan", ROBOT, "--poses", 6, "--loads", "force", "-o", tmp_path / "poses.csv")
    assert command(*arguments, "--separate", tmp_path / "verdict.json", "--json", tmp_path / "p.json") == 0
    table = read_poses(tmp_path / "poses.csv")
    assert len(table.labels) == 6
    loads = {tuple(w) for w in np.round(table.w, 6).tolist()}
    assert len({abs(w[2]) for w in loads if w[2]}) == 2  # two levels: what a nonlinear gear shows in
    separation = json.loads((tmp_path / "p.json").read_text())["separation"]
    assert all(b >= a for a, b in pairwise(separation))
    assert separation[-1] > 10


def test_a_verdict_with_one_explanation_needs_no_plan(
    named: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("plan", ROBOT, "--poses", 4, "-o", tmp_path / "poses.csv")
    assert command(*arguments, "--separate", named / "verdict.json") == 2
    assert "nothing to decide between: the verdict is named" in capsys.readouterr().err
    assert not (tmp_path / "poses.csv").exists()


def test_a_thinned_table_says_so(tmp_path: Path) -> None:
    found = diagnose(Task(load(ROBOT), measured(), max_poses=6))
    assert found.assembly.problem.poses == 6
    assert any("6 of 10 poses" in remark for remark in found.remarks)


def read(table: Measurements) -> Measurements:
    """A table of which the translations are measured."""
    return replace(table, values=np.where(np.arange(6) < 3, np.zeros((len(table), 1)), np.nan))


@pytest.mark.parametrize(
    ("poses", "used"), [(161, 160), (160, 160), (20, 20)], ids=["many", "just enough", "few"]
)
def test_a_long_table_is_thinned_though_nobody_asks_for_it(poses: int, used: int) -> None:
    """45 readings a pose: room and time of a diagnosis grow with them."""
    whole = read(design(poses))
    table, remarks = thinned(whole, None)
    assert len(np.unique(table.pose)) == used
    assert [f"{used} of {poses} poses are used" in r for r in remarks] == [True] * (used < poses)
    assert thinned(whole, poses) == (whole, [])


def test_poses_of_one_reading_are_thinned_by_their_number() -> None:
    table, _ = thinned(read(design(230, (1.0,))), None)
    assert len(np.unique(table.pose)) == MOST_POSES
    assert {int(table.pose.min()), int(table.pose.max())} == {0, 229}


@pytest.mark.slow
def test_the_same_table_gives_the_same_bytes(named: Path, tmp_path: Path) -> None:
    assert command("diagnose", ROBOT, named.parent / "data.csv", "-o", tmp_path / "again") == 0
    for name in ("report.html", "verdict.json", "model.toml"):
        assert (tmp_path / "again" / name).read_bytes() == (named / name).read_bytes()


@pytest.mark.slow
@pytest.mark.skipif(not UR10.exists(), reason="the measured UR10 data are not there")
def test_a_real_ur10_shows_its_geometry_and_its_gears() -> None:
    found = diagnose(Task(load("ur10"), read_table(UR10), "joints", max_poses=100))
    named = {e.effect for e in found.named}
    assert named & {"geometric_error", "joint_offset"}
    assert "transmission_error" in named
    # what gives way under the arm's own weight looks like geometry in so few poses: then both stand in the set;
    # in 60 poses the ripple of several gears cannot be told from joints that stand a little elsewhere each time
    assert named <= {
        "geometric_error",
        "joint_offset",
        "transmission_error",
        "link_compliance",
        "base_compliance",
    }
    assert found.rms.held_out_after < 0.75 * found.rms.held_out_before
    assert any("mm from the tool centre point" in remark for remark in found.remarks)
