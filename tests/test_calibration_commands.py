"""plan, simulate, identify, generate, compensate: one after the other, as a user would."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.tables.table import read_poses
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel, load_model
from symstiff.reduction import reduce
from symstiff.robot import load

TRUTH = 'format = 1\nrobot = "kuka_kr270"\n[noise]\nsigma_mm = 0.02\n'


def symstiff(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "symstiff", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def succeeded(folder: Path, *arguments: str) -> str:
    done = symstiff(folder, *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which a robot was planned, measured and identified."""
    folder = tmp_path_factory.mktemp("calibration")
    (folder / "truth.toml").write_text(TRUTH)
    succeeded(
        folder, "plan", "kuka_kr270", "--poses", "15", "--loads", "gravity", "--force", "2500", "--candidates",
        "1500", "--markers", "p1,p2,p3", "--no-refine", "--floor", "0.2", "--plot", "poses.png", "-o", "poses.csv",
        "--json", "plan.json",
    )  # fmt: skip
    succeeded(folder, "simulate", "truth.toml", "--poses", "poses.csv", "--seed", "3", "-o", "data.csv")
    succeeded(
        folder, "identify", "kuka_kr270", "data.csv", "--held-out", "0.2", "--physical", "-o", "model.toml", "--json",
        "fit.json", "--reconstruct", "complete.json", "--plot", "residuals.svg",
    )  # fmt: skip
    return folder


def test_the_plan_promises_deviations_and_beats_random_poses(folder: Path) -> None:
    plan = json.loads((folder / "plan.json").read_text())
    assert len(plan["std"]) == 26
    assert plan["efficiency"]["over_random"] > 1.2
    assert (folder / "poses.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_planned_load_comes_in_steps_and_a_sliding_joint_stays_in_metres(folder: Path) -> None:
    succeeded(
        folder, "plan", "scara", "--poses", "4", "--loads", "gravity", "--force", "60", "--candidates", "200",
        "--markers", "p1,p2", "--steps", "3", "--no-refine", "-o", "steps.csv",
    )  # fmt: skip
    rows = list(csv.DictReader((folder / "steps.csv").read_text().splitlines()))
    assert len(rows) == 4 * 3 * 2
    assert [(float(r["fz[N]"]), float(r["load_step"]), r["point"]) for r in rows[:6]] == [
        (-20.0, 1, "p1"), (-20.0, 1, "p2"), (-40.0, 2, "p1"), (-40.0, 2, "p2"), (-60.0, 3, "p1"), (-60.0, 3, "p2"),
    ]  # fmt: skip
    assert "q3[m]" in rows[0]
    done = symstiff(folder, "plan", "scara", "--poses", "4", "--margin", "50", "-o", "none.csv")
    assert (done.returncode, "--margin 50: a part of a joint's range" in done.stderr) == (2, True)
    done = symstiff(folder, "plan", "scara", "--poses", "4", "--steps", "0", "-o", "none.csv")
    assert (done.returncode, "--steps 0" in done.stderr) == (2, True)


@pytest.mark.slow
def test_one_marker_beside_the_tool_centre_point_is_planned_for_what_it_shows(tmp_path: Path) -> None:
    succeeded(
        tmp_path, "plan", "kuka_kr270", "--poses", "12", "--loads", "gravity", "--candidates", "500", "--markers", "p1",
        "--no-refine", "-o", "one.csv", "--json", "one.json",
    )  # fmt: skip
    assert len(json.loads((tmp_path / "one.json").read_text())["std"]) == 25


def test_the_data_carry_no_trace_of_the_truth(folder: Path) -> None:
    header = next(csv.reader((folder / "data.csv").read_text().splitlines()))
    assert all("[" in h or h in ("pose", "point", "repeat", "load_step", "branch") for h in header)
    assert "truth" not in (folder / "data.csv").read_text()


def test_the_fit_is_reported_with_uncertainty_and_held_out_residuals(folder: Path) -> None:
    fit = json.loads((folder / "fit.json").read_text())
    assert set(fit["parameters"]["k1_66"]) == {"value", "std", "lower", "upper", "unit"}
    assert fit["parameters"]["k1_66"]["unit"] == "rad/(N*m)"
    assert fit["held_out"]["compensated"] > 0.9
    assert "<svg" in (folder / "residuals.svg").read_text()


def test_the_complete_set_has_bounds_for_every_parameter(folder: Path) -> None:
    complete = json.loads((folder / "complete.json").read_text())
    assert len(complete["values"]) == 62
    assert complete["bounds"] is not None


@pytest.mark.slow
def test_an_identified_model_generates_code_with_its_values(folder: Path) -> None:
    succeeded(folder, "generate", "kuka_kr270", "--model", "model.toml", "-o", "code")
    manifest = json.loads((folder / "code" / "manifest.json").read_text())
    fit = json.loads((folder / "fit.json").read_text())
    physical = fit["physical"]["parameters"]
    by_name = dict(zip(manifest["parameters"], manifest["default_parameters"], strict=True))
    assert by_name == pytest.approx(physical, rel=1e-12)


def test_a_trajectory_is_corrected(folder: Path) -> None:
    (folder / "trajectory.csv").write_text(
        "q1[deg],q2[deg],q3[deg],q4[deg],q5[deg],q6[deg],fz[N]\n0,-60,70,10,30,0,-2000\n5,-60,75,10,35,0,-2000\n"
    )
    succeeded(folder, "compensate", "model.toml", "trajectory.csv", "-o", "out.csv", "--json", "out.json")
    record = json.loads((folder / "out.json").read_text())
    assert record["rms_mm"]["before"] > 0.5
    assert record["rms_mm"]["after"] < 1e-6
    rows = list(csv.DictReader((folder / "out.csv").read_text().splitlines()))
    assert len(rows) == 2
    assert any(k.startswith("q1") for k in rows[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("plan", "kuka_kr270", "--poses", "2", "-o", "x.csv"), "poses"),
        (("plan", "kuka_kr270", "--poses", "15", "--levels", "q9=3", "-o", "x.csv"), "--levels: q9"),
        (("simulate", "missing.toml", "--poses", "poses.csv", "-o", "x.csv"), "missing.toml"),
        (("simulate", "truth.toml", "--poses", "poses.csv", "--noise", "-1", "-o", "x.csv"), "noise"),
        (("identify", "kuka_kr270", "poses.csv", "-o", "x.toml"), "measured"),
        (("identify", "ur10", "data.csv", "--start", "model.toml", "-o", "x.toml"), "kuka_kr270"),
        (("identify", "scara", "data.csv", "-o", "x.toml"), "joint"),
        (("compensate", "data.csv", "poses.csv", "-o", "x.csv"), "TOML"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(folder: Path, arguments: tuple[str, ...], says: str) -> None:
    done = symstiff(folder, *arguments)
    assert done.returncode == 2, done.stdout + done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert says in done.stderr
    assert not (folder / "x.csv").exists()
    assert not (folder / "x.toml").exists()


@pytest.mark.slow
def test_a_planned_moment_is_told_and_can_be_given(tmp_path: Path) -> None:
    plan = (
        "plan", "scara", "--poses", "8", "--force", "40", "--candidates", "200", "--no-refine", "-o", "p.csv",
        "--json", "plan.json",
    )  # fmt: skip
    printed = " ".join(succeeded(tmp_path, *plan).split())
    assert "assumed applied: 40 N and 20 N·m, each in any direction" in printed
    printed = " ".join(succeeded(tmp_path, *plan, "--moment", "3").split())
    assert "assumed applied: 40 N and 3 N·m, each in any direction" in printed
    table = read_poses(tmp_path / "p.csv")
    np.testing.assert_allclose(np.linalg.norm(table.w[:, 3:], axis=1), 3.0, rtol=1e-2)
    told = json.loads((tmp_path / "plan.json").read_text())["load"]
    assert told == {"class": "wrench", "force": 40.0, "moment": 3.0}


@pytest.mark.slow
def test_a_plan_with_load_steps_promises_what_the_fit_to_all_of_them_states(tmp_path: Path) -> None:
    printed = succeeded(
        tmp_path, "plan", "scara", "--poses", "8", "--loads", "gravity", "--force", "60", "--candidates", "200",
        "--markers", "p1,p2,p3", "--steps", "4", "--sigma", "0.02", "--no-refine", "-o", "steps.csv",
        "--json", "plan.json",
    )  # fmt: skip
    assert "each of 4 load steps an independent reading" in " ".join(printed.split())
    (tmp_path / "truth.toml").write_text('format = 1\nrobot = "scara"\n[noise]\nsigma_mm = 0.02\n')
    succeeded(tmp_path, "simulate", "truth.toml", "--poses", "steps.csv", "--seed", "1", "-o", "data.csv")
    succeeded(
        tmp_path, "identify", "scara", "data.csv", "--loads", "gravity", "-o", "m.toml", "--json", "fit.json"
    )
    promised = json.loads((tmp_path / "plan.json").read_text())["std"]
    found = json.loads((tmp_path / "fit.json").read_text())["parameters"]
    assert set(promised) == set(found)
    for name, std in promised.items():
        assert found[name]["std"] == pytest.approx(std, rel=1e-3)


def test_a_trajectory_is_compensated_with_a_note_on_what_is_no_law_of_the_robot(tmp_path: Path) -> None:
    model = StiffnessModel.of(reduce(load("scara"), "gravity"))
    model = model.with_effect(EffectInstance("large_deflection", {"robot": "all"}))
    model.with_values(dict.fromkeys(model.parameters, 1e-7)).save(tmp_path / "m.toml")
    (tmp_path / "t.csv").write_text("q1[deg],q2[deg],q3[m],q4[deg],fz[N]\n10,40,0.05,0,-50\n")
    printed = succeeded(tmp_path, "compensate", "m.toml", "t.csv", "-o", "out.csv")
    assert "without large deflection" in printed


@pytest.mark.slow
def test_physical_bounds_say_what_they_cost(folder: Path) -> None:
    succeeded(folder, "simulate", "truth.toml", "--poses", "poses.csv", "--seed", "5", "-o", "other.csv")
    printed = succeeded(folder, "identify", "kuka_kr270", "other.csv", "--physical", "-o", "again.toml")
    words = " ".join(printed.split())
    assert "physics: " in words
    assert "noise alone makes these bounds cost as much with p = " in words
    assert "contradict" not in words


@pytest.mark.slow
def test_a_model_file_is_refitted_under_the_same_physical_bounds_as_a_robot(folder: Path) -> None:
    for name, start in (("one.toml", "complete"), ("two.toml", "model.toml")):
        succeeded(folder, "identify", "kuka_kr270", "data.csv", "--start", start, "--physical", "-o", name)
    one, two = (load_model(folder / name).values for name in ("one.toml", "two.toml"))
    assert dict(two) == pytest.approx(dict(one), rel=1e-4)
