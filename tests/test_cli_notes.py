"""What commands say beside their result: doubtful units, loads outside a model's class, fits that do not fit."""

from __future__ import annotations

import csv
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import OBLIQUE, Result, Run, assert_users_mistake, run_command_line  # noqa: F401

from symstiff.calibration.measurements import measurements
from symstiff.calibration.rows import predict
from symstiff.calibration.table import write_table
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


def test_negated_deflections_look_swapped(run: Run) -> None:
    measured(Path("data.csv"))
    rows = list(csv.reader(Path("data.csv").read_text().splitlines()))
    signed = [k for k, header in enumerate(rows[0]) if header[:2] in ("dx", "dy", "dz")]
    negated = [[str(-float(c)) if k in signed else c for k, c in enumerate(row)] for row in rows[1:]]
    Path("data.csv").write_text("".join(",".join(row) + "\n" for row in (rows[0], *negated)))
    assert "axes look swapped" in notes(run, *IDENTIFY)


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
    assert "identify with --loads wrench" in said


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


def test_a_trajectory_keeps_its_columns_units_and_order(run: Run) -> None:
    arm().save("model.toml")
    text = (
        "fx[N],q2[deg],pose,q1[rad],time[s],temperature[degC]\n100,30,a,0.5,0.10,\n-50,40,b,0.25,0.20,21.50\n"
    )
    Path("way.csv").write_text(text)
    notes(run, "compensate", "model.toml", "way.csv")
    before, after = (list(csv.reader(t.splitlines())) for t in (text, Path("m.toml").read_text()))
    assert after[0] == before[0]
    for old, new in zip(before[1:], after[1:], strict=True):
        assert [new[k] for k in (0, 2, 4, 5)] == [old[k] for k in (0, 2, 4, 5)]
        assert all(0 < abs(float(new[k]) - float(old[k])) < 0.2 for k in (1, 3))


def test_one_pose_under_several_loads_becomes_several_only_where_its_commands_part(run: Run) -> None:
    arm().with_values({"c1": 2e-5, "c2": 3e-5}).save("model.toml")
    rows = ("a,0,30,1", "a,0,30,2", "a,0,30,900", "b,0,40,900")
    Path("way.csv").write_text("pose,q1[deg],q2[deg],fy[N]\n" + "\n".join(rows) + "\n")
    said = notes(run, "compensate", "model.toml", "way.csv")
    assert "pose a became a/1, a/2, …" in said
    labels = [row[0] for row in csv.reader(Path("m.toml").read_text().splitlines())]
    assert labels == ["pose", "a/1", "a/2", "a/3", "b"]
    from symstiff.calibration.table import read_poses

    assert len(read_poses("m.toml")) == 4


def test_a_path_with_labels_may_come_to_a_point_again(run: Run) -> None:
    arm().save("model.toml")
    Path("way.csv").write_text("pose,q1[deg],q2[deg],fy[N]\nhome,10,40,50\naway,20,40,50\nhome,10,40,50\n")
    notes(run, "compensate", "model.toml", "way.csv")
    home, _, again = list(csv.reader(Path("m.toml").read_text().splitlines()))[1:]
    assert home == again


def test_a_load_through_zero_may_tell_the_way_it_goes_on_a_path_as_in_a_table(run: Run) -> None:
    """From -60 N to 60 N and back: going up it first falls in size and then grows, and the other way round."""
    arm().with_effect(EffectInstance("hysteresis", {"joint": 2})).with_values(
        {**VALUES, "hysteresis_2_width": 1e-3}
    ).save("model.toml")
    loads = (-60, -30, 30, 60, 30, -30, -60)
    written = []
    for name, branches in (
        ("way", ("up",) * 4 + ("down",) * 3),
        ("size", ("down", "down", "up", "up", "down", "up", "up")),
    ):
        label = ["a" if name == "way" else f"a{k}" for k in range(len(loads))]
        rows = [f"{p},10,40,{f},{b}\n" for p, f, b in zip(label, loads, branches, strict=True)]
        Path("way.csv").write_text("pose,q1[deg],q2[deg],fy[N],branch\n" + "".join(rows))
        notes(run, "compensate", "model.toml", "way.csv")
        written.append([row[1:3] for row in csv.reader(Path("m.toml").read_text().splitlines())])
    assert written[0] == written[1]
    assert written[0][1] != written[0][7]


def test_a_deflection_that_moves_the_loads_levers_leaves_more_than_the_model_tells(run: Run) -> None:
    """Of second order: its square over the reach, which a small one does not leave."""
    arm().with_values({"c1": 2e-5, "c2": 3e-5}).save("model.toml")
    for force, told in ((900, True), (9, False)):
        Path("way.csv").write_text(f"q1[deg],q2[deg],fy[N]\n0,30,{force}\n")
        said = notes(run, "compensate", "model.toml", "way.csv")
        assert " mm by the model" in said
        assert ("move the levers of the loads: of the order of " in said) == told


def test_rows_without_a_correction_and_commands_beyond_the_limits_are_named_by_their_lines(run: Run) -> None:
    """No small motion answers 50 kN, and at its limit joint 1 goes beyond it against a force that turns it back."""
    arm().with_values({"c1": 2e-5, "c2": 3e-5}).save("model.toml")
    rows = ("a,10,40,50", "b,20,40,50000", "c,180,40,50")
    Path("way.csv").write_text("pose,q1[deg],q2[deg],fy[N]\n" + "\n".join(rows) + "\n")
    said = notes(run, "compensate", "model.toml", "way.csv", "--json", "out.json")
    assert "1 of 3 poses (line 3) keep their command: a joint would have to move by more" in said
    assert "1 of 3 poses (line 4) have a command beyond the joint limits" in said
    told = json.loads(Path("out.json").read_text())
    assert told["kept"] == [{"line": 3, "pose": "b", "reason": "too_far"}]
    assert told["beyond_limits"] == [4]
    written = list(csv.DictReader(Path("m.toml").read_text().splitlines()))
    assert [float(row["q1[deg]"]) > 180 for row in written] == [False, False, True]


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="pipes have no path here")
def test_a_trajectory_may_come_through_a_pipe(run: Run) -> None:
    arm().save("model.toml")
    text = "q1[deg],q2[deg],fy[N]\n10,40,50\n"
    Path("way.csv").write_text(text)
    notes(run, "compensate", "model.toml", "way.csv")
    from_file = Path("m.toml").read_bytes()
    reading, writing = os.pipe()
    os.write(writing, text.encode())
    os.close(writing)
    notes(run, "compensate", "model.toml", f"/dev/fd/{reading}")
    os.close(reading)
    assert Path("m.toml").read_bytes() == from_file


@pytest.mark.parametrize("left", ["[values]\nc1 = 0.0\nc2 = 0.0\n", ""])
def test_a_model_without_values_compensates_nothing_and_is_refused(run: Run, left: str) -> None:
    arm().with_values({}).save("model.toml")
    zeros = "[values]\nc1 = 0.0\nc2 = 0.0\n"
    text = Path("model.toml").read_text()
    assert zeros in text
    Path("model.toml").write_text(text.replace(zeros, left))
    Path("way.csv").write_text("q1[deg],q2[deg],fx[N]\n0,30,10\n")
    assert_users_mistake(
        run("compensate", "model.toml", "way.csv", "-o", "m.csv"),
        "model.toml",
        "values",
        "identify",
        "--start",
    )
    assert not Path("m.csv").exists()


def test_a_row_without_what_the_model_follows_is_named(run: Run) -> None:
    slack = arm().with_effect(EffectInstance("hysteresis", {"joint": 2}, {"width": 20.0}))
    slack.with_values(dict(VALUES) | {n: 1e-4 for n in slack.parameters if n not in VALUES}).save(
        "model.toml"
    )
    row, command = "0,30,10", ("compensate", "model.toml", "way.csv", "-o", "m.csv")
    Path("way.csv").write_text(f"q1[deg],q2[deg],fx[N],branch,time[s]\n{row},up,1\n{row},down,\n\n{row},,3\n")
    assert_users_mistake(run(*command), "way.csv: line 5: column branch: missing value")
    Path("way.csv").write_text(f"q1[deg],q2[deg],fx[N],time[s]\n{row},1\n")
    assert_users_mistake(run(*command), "way.csv: the model needs the column branch: add it")
    Path("way.csv").write_text(f"q1[deg],q2[deg],fx[N],branch,time[s]\n{row},up,\n{row},down,1\n")
    assert run(*command).code == 0  # the time is nothing that it follows


def test_a_trajectory_without_loads_is_remarked(run: Run) -> None:
    arm().save("model.toml")
    Path("way.csv").write_text("q1[deg],q2[deg]\n0,30\n")
    assert "no loads at the tool: nothing that the model compensates" in notes(
        run, "compensate", "model.toml", "way.csv"
    )


@pytest.mark.parametrize(("robot", "told"), [("ur10", True), ("planar2r", False)])
def test_that_the_own_weight_is_not_compensated_is_told(run: Run, robot: str, told: bool) -> None:
    """A robot whose masses are known sags by itself, and the model gives what loads at the tool add to that."""
    model = joints_only(load(robot), "wrench")
    model.with_values(dict.fromkeys(model.parameters, 1e-6)).save("model.toml")
    names = [f"q{k + 1}[deg]" for k in range(model.robot.dof)]
    Path("way.csv").write_text(",".join([*names, "fy[N]"]) + "\n" + "30," * len(names) + "10\n")
    assert ("own weight bends the arm as well" in notes(run, "compensate", "model.toml", "way.csv")) == told


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
