"""What commands say beside their result: doubtful units, loads outside a model's class, fits that do not fit."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import OBLIQUE, Result, Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.calibration.rows import predict
from symstiff.calibration.tables.measurements import measurements
from symstiff.calibration.tables.table import read_table, write_table
from symstiff.effects.instance import EffectInstance
from symstiff.model import StiffnessModel, joints_only
from symstiff.robot import load

VALUES = {"c1": 2e-6, "c2": 3e-6}


def arm(loads: str = "wrench") -> StiffnessModel:
    return joints_only(load("planar2r"), loads).with_values(VALUES)


def measured(
    file: Path, scale: float = 1.0, sigma: float = 1e-6, added: float = 0.0, turns: float = 1.0
) -> None:
    """A table of the planar arm; ``scale`` is what the loads are multiplied with before they are written."""
    rng = np.random.default_rng(5)
    q, w = rng.uniform(-1.5, 1.5, (12, 2)) * turns, np.zeros((12, 6))
    w[:, :2] = rng.uniform(-900, 900, (12, 2))
    table = measurements(q, w, kind="deflection")
    values = predict(arm(), table) + rng.normal(0, 1e-6, (12, 6))
    values[:, 1] += added
    values[:, 3:] = np.nan
    known = np.where(np.isfinite(values), sigma, np.nan)
    write_table(replace(table, w=w * scale, values=values, sigma=known), file)


def notes(run: Run, *arguments: object) -> str:
    done = run(*arguments, "-o", "m.toml")
    assert done.code == 0, done.err
    return " ".join(done.out.split())


IDENTIFY = ("identify", "planar2r", "data.csv", "--start", "joints")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_sound_data_need_no_note(run: Run) -> None:
    measured(Path("data.csv"))
    assert "note" not in notes(run, *IDENTIFY)


def test_deflections_of_nanometres_have_another_unit(run: Run) -> None:
    measured(Path("data.csv"), scale=3000.0)
    assert "nm a newton, which no serial robot is stiff enough for" in notes(run, *IDENTIFY)


def test_deflections_of_centimetres_a_newton_have_another_unit(run: Run) -> None:
    measured(Path("data.csv"), scale=1e-3)
    assert "mm a newton, which no serial robot is soft enough for" in notes(run, *IDENTIFY)


def test_deflections_of_a_tenth_of_the_arm_have_another_unit(run: Run) -> None:
    measured(Path("data.csv"), scale=0.02, turns=0.3)
    table = read_table([Path("data.csv")])
    write_table(replace(table, values=60.0 * table.values, w=60.0 * table.w), Path("data.csv"))
    assert "200 mm, which no arm that reaches 1.7 m bends by" in notes(run, *IDENTIFY)


def test_a_sigma_of_translations_alone_is_told_to_be_unused(run: Run) -> None:
    rng = np.random.default_rng(5)
    q, w = rng.uniform(-1.5, 1.5, (12, 2)), np.zeros((12, 6))
    w[:, :2] = rng.uniform(-900, 900, (12, 2))
    table = measurements(q, w, kind="deflection")
    values = predict(arm(), table) + rng.normal(0, 1e-6, (12, 6))
    for rotations, told in ((np.nan, True), (2e-6, False)):
        sigma = np.tile([1e-6] * 3 + [rotations] * 3, (12, 1))
        write_table(replace(table, values=values, sigma=sigma), "data.csv")
        assert ("sigma is stated for translations and not for rotations" in notes(run, *IDENTIFY)) == told


def test_a_fit_beyond_the_stated_sigma_points_to_diagnose(run: Run) -> None:
    measured(Path("data.csv"), added=1e-3)
    said = notes(run, *IDENTIFY)
    assert "fit p < 1e-16" in said
    assert "and the deviations above, which rest on it, are too small: symstiff diagnose" in said


def test_a_sigma_that_is_far_too_large_is_told(run: Run) -> None:
    rng = np.random.default_rng(5)
    q, w = rng.uniform(-1.5, 1.5, (30, 2)), np.zeros((30, 6))
    w[:, :2] = rng.uniform(-900, 900, (30, 2))
    table = measurements(q, w, kind="deflection")
    values = predict(arm(), table)
    values[:, :3] += rng.normal(0, 1e-5, (30, 3))
    values[:, 3:] = np.nan
    for stated, told in ((1e-5, False), (3e-5, True)):
        sigma = np.tile([stated] * 3 + [np.nan] * 3, (30, 1))
        write_table(replace(table, values=values, sigma=sigma), "data.csv")
        said = notes(run, *IDENTIFY)
        assert (
            "what is left is 0.3" in said and "it is too large, and so are the deviations" in said
        ) == told


def rewritten(signs: dict[str, float], names: dict[str, str]) -> None:
    """Signs of some columns of the table changed, and some columns under other names."""
    rows = list(csv.reader(Path("data.csv").read_text().splitlines()))
    factor = [signs.get(header[:2], 1.0) for header in rows[0]]
    told = [names.get(header[:2], header[:2]) + header[2:] for header in rows[0]]
    changed = [[c if f > 0 else str(-float(c)) for c, f in zip(row, factor, strict=True)] for row in rows[1:]]
    Path("data.csv").write_text("".join(",".join(row) + "\n" for row in (told, *changed)))


def test_no_model_is_written_of_deflections_that_point_against_their_loads(run: Run) -> None:
    measured(Path("data.csv"))
    rewritten({"dx": -1.0, "dy": -1.0, "dz": -1.0}, {})
    done = run(*IDENTIFY, "-o", "m.toml")
    assert_users_mistake(done, "the deflections point against their loads", "the sign of the loads")
    assert not Path("m.toml").exists()


def test_swapped_axes_are_a_note_and_come_first_where_the_model_is_not_determined(run: Run) -> None:
    measured(Path("data.csv"))
    rewritten({}, {"dx": "dy", "dy": "dx"})
    assert "axes look swapped: x = y, y = x" in notes(run, *IDENTIFY)
    complete = run("identify", "planar2r", "data.csv", "-o", "m.toml")
    assert_users_mistake(complete, "axes look swapped: x = y, y = x")
    assert complete.err.index("look swapped") < complete.err.index("do not determine the model")


def test_compliances_far_from_the_robot_files_question_the_units(run: Run) -> None:
    text = OBLIQUE.replace('name = "oblique"', 'name = "arm"').replace(
        "d = 0.2", "d = 0.2\ncompliance = 2e-6"
    )
    Path("arm.toml").write_text(text.replace("beam_axis = [0.5, 0, 0.2]", 'template = "rigid"'))
    robot = load("arm.toml")
    model = joints_only(robot).with_values({"c1": 2e-6, "c2": 3e-6})
    rng = np.random.default_rng(1)
    table = measurements(rng.uniform(-1, 1, (9, 2)), rng.uniform(-500, 500, (9, 6)), kind="deflection")
    table = replace(table, values=predict(model, table) + rng.normal(0, 1e-7, (9, 6)))
    for scale, doubted in ((1.0, False), (1e-3, True)):
        write_table(replace(table, w=table.w * scale), "data.csv")
        said = notes(run, "identify", "arm.toml", "data.csv", "--start", "joints")
        assert ("far from the robot file's (c1 1e+03 times)" in said) == doubted
        assert ("such as kN under fz[N]" in said) == doubted


def test_loads_outside_a_models_class_are_named(run: Run) -> None:
    measured(Path("data.csv"))
    said = notes(run, *IDENTIFY, "--loads", "force")
    assert "reduced for" not in said
    arm("force").save("force.toml")
    Path("way.csv").write_text("q1[deg],q2[deg],fx[N],mz[N*m]\n0,30,100,5\n")
    said = notes(run, "compensate", "force.toml", "way.csv")
    assert "reduced for force loads (fx, fy, fz), and these have mz too" in said
    assert "use --loads wrench" in said


def test_radians_under_degrees_are_asked_about(run: Run) -> None:
    measured(Path("data.csv"), turns=0.06)
    assert "if these are radians, write q1[rad]" in notes(run, *IDENTIFY)


@pytest.mark.slow
def test_a_link_that_cannot_hold_its_joint_is_remarked_by_identify_and_diagnose(run: Run) -> None:
    from symstiff.reduction import reduce

    Path("arm.toml").write_text(OBLIQUE)
    model = StiffnessModel.of(reduce(load("arm.toml"), "wrench", "pose"))
    model = model.with_values(dict.fromkeys(model.parameters, 1e-6))
    rng = np.random.default_rng(1)
    table = measurements(rng.uniform(-1, 1, (40, 2)), rng.uniform(-500, 500, (40, 6)), kind="deflection")
    write_table(replace(table, values=predict(model, table) + rng.normal(0, 1e-5, (40, 6))), "data.csv")
    assert "M3 gives c2 to link 1" in notes(run, "identify", "arm.toml", "data.csv")
    done = run("diagnose", "arm.toml", "data.csv", "-o", "report")
    assert "M3 gives c2 to link 1" in " ".join(done.out.split())


@pytest.mark.parametrize(
    ("effect", "shape"),
    [
        ("backlash", {"width": 20.0}),
        ("hysteresis", {"width": 20.0, "load": 7.5, "power": 0.5}),
        ("nonlinear_stiffness", {"load": 7.5, "knee": 1.0}),
    ],
)
@pytest.mark.parametrize("wrong", ["0.0", "-5.0"])
def test_a_shape_that_divides_by_zero_is_a_users_mistake(
    run: Run, effect: str, shape: dict[str, float], wrong: str
) -> None:
    arm().with_effect(EffectInstance(effect, {"joint": 2}, shape)).save("model.toml")
    text = Path("model.toml").read_text()
    told = "load = 7.5" if "load" in shape else "width = 20.0"
    assert told in text
    Path("model.toml").write_text(text.replace(told, f"{told.split()[0]} = {wrong}"))
    Path("way.csv").write_text("q1[deg],q2[deg],fx[N],branch\n0,30,10,up\n")
    measured(Path("data.csv"))
    for command in (
        ("compensate", "model.toml", "way.csv"),
        ("generate", "planar2r", "--model", "model.toml"),
        ("identify", "planar2r", "data.csv", "--start", "model.toml"),
    ):
        assert_users_mistake(
            run(*command, "-o", "out"),
            "model.toml",
            effect,
            f"{told.split()[0]} = {wrong}: give a value above zero",
        )


def test_a_plan_says_what_it_takes_to_be_measured(run: Run) -> None:
    plan = ("plan", "planar2r", "--candidates", "100", "--no-refine", "--poses", "8", "--sigma", "0.06")
    said = notes(run, *plan, "--json", "plan.json")
    assert "assumed measured: position and rotation of the tool, σ 0.06 mm a coordinate, 0.2 mrad" in said
    assert json.loads(Path("plan.json").read_text())["measured"]["sigma_mm"] == 0.06
    notes(run, *plan[:-2], "--json", "plan.json")
    assert '"sigma_mm": 0.03,' in Path("plan.json").read_text()
    said = notes(run, *plan, "--loads", "force", "--measure", "position")
    assert "assumed measured: position of the tool centre point, σ 0.06 mm" in said


def test_generate_says_that_a_stated_compliance_without_a_place_is_no_default(run: Run) -> None:
    Path("arm.toml").write_text(OBLIQUE.replace("alpha = 0\n", "alpha = 0\ncompliance = 2e-6\n"))
    done = run("generate", "arm.toml", "-o", "code", "--no-compile")
    assert done.code == 0, done.err
    assert "warning: c2: the file's 2e-06 is left out of the values" in " ".join(done.out.split())
    assert not any(json.loads(Path("code/manifest.json").read_text())["default_parameters"])


def test_a_compiler_is_advised_only_where_one_was_wanted(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    where = ("generate", "planar2r", "--targets", "c", "-o")
    assert "not compiled: not wanted\n" in run(*where, tmp_path / "a", "--no-compile").out
    monkeypatch.setattr("symstiff.codegen.generate.find_compiler", lambda: None)
    lacking = " ".join(run(*where, tmp_path / "b").out.split())
    assert "no C compiler was found (pip install symstiff[compiler] brings a compiler)" in lacking


@pytest.mark.parametrize("columns", [20, 60, 80])
def test_tables_cut_no_name_and_no_number_on_a_narrow_terminal(
    run: Run, monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    measured(Path("data.csv"))
    laws = [EffectInstance("nonlinear_stiffness", {"joint": j}) for j in (1, 2)]
    arm().with_effects(laws).save("start.toml")
    done = run(*IDENTIFY[:3], "--start", "start.toml", "--json", "fit.json", "-o", "m.toml")
    assert done.code == 0, done.err
    fit = json.loads(Path("fit.json").read_text())["parameters"]
    assert any(len(name) > 20 for name in fit)
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in done.out.splitlines()]
    shown = {row[0]: row[1:] for row in rows if len(row) == 6}
    for name, p in fit.items():
        value, std, *_, unit = shown[name]
        assert float(value) == pytest.approx(p["value"], rel=1e-4)
        assert (float(std), unit) == (pytest.approx(p["std"], rel=0.05), p["unit"])
    assert "…" not in done.out


@pytest.mark.slow
def test_a_plan_says_what_identify_may_find_undetermined_and_identify_does(run: Run) -> None:
    """One test pose asks for few combinations of the parameters: a plan for it alone leaves others to the noise."""
    Path("test.csv").write_text(
        "q1[deg],q2[deg],q3[deg],q4[deg],q5[deg],q6[deg],fz[N]\n10,-60,80,-90,-80,10,-100\n"
    )
    Path("truth.toml").write_text('format = 1\nrobot = "ur10"\n[noise]\nsigma_mm = 0.03\n')
    plan = ("plan", "ur10", "--poses", "12", "--loads", "gravity", "--force", "25", "--markers", "p1,p2,p3")
    plan = (*plan, "--candidates", "2000", "--json", "plan.json")
    for criterion, doubted in (("test", True), ("D", False)):
        own = ("--test-poses", "test.csv") if criterion == "test" else ()
        done = run(*plan, "--criterion", criterion, *own, "-o", "poses.csv")
        assert done.code == 0, done.err
        assert ("note: identify may not determine" in done.out) == doubted
        names = json.loads(Path("plan.json").read_text())["doubtful"]
        assert bool(names) == doubted
        assert (
            run("simulate", "truth.toml", "--poses", "poses.csv", "--seed", "1", "-o", "data.csv").code == 0
        )
        fit = run("identify", "ur10", "data.csv", "--loads", "gravity", "-o", "m.toml")
        assert fit.code == (2 if doubted else 0), fit.err
        assert all(name in fit.err for name in names)
