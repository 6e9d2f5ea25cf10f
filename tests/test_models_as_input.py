"""Model files and tables as input: what does not belong together is refused, what is not told is filled."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tomli_w
from command_line import OBLIQUE, Run, assert_users_mistake, run_command_line  # noqa: F401

import symstiff
from symstiff.calibration.identify import identify
from symstiff.calibration.kept import seen_in
from symstiff.calibration.rows import equations, stated_sigma
from symstiff.calibration.tables.measurements import measurements
from symstiff.calibration.tables.writing import write_table
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import catalogue
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only, load_model
from symstiff.reduction.reduce import reduce
from symstiff.report.folder import write_report
from symstiff.robot import load
from symstiff.robot.table import to_table
from tests.diagnosis_data import ROBOT, measured

DRIFT = EffectInstance("thermal_drift", {"measurement": "frame"}, {"T": 3600.0})


def scara() -> StiffnessModel:
    return StiffnessModel.of(reduce(load("scara")))


def test_a_model_of_another_geometry_is_refused(run: Run, tmp_path: Path) -> None:
    scara().save(tmp_path / "model.toml")
    table = to_table(load("scara"))
    table["tool"] = {"xyz": [0.0, 0.0, 0.3]}
    (tmp_path / "longer.toml").write_text(tomli_w.dumps(table))
    data = "pose,q1[deg],q2[deg],q3[m],q4[deg],fz[N],dz[mm]\n" + "".join(
        f"p{k},{10 * k},{5 * k},0.05,{7 * k},-50,0.1\n" for k in range(9)
    )
    (tmp_path / "data.csv").write_text(data)
    model, robot = tmp_path / "model.toml", tmp_path / "longer.toml"
    for command in (
        ("generate", robot, "--model", model, "-o", tmp_path / "out"),
        ("identify", robot, tmp_path / "data.csv", "--start", model, "-o", tmp_path / "out.toml"),
        ("diagnose", robot, tmp_path / "data.csv", "--start", model, "-o", tmp_path / "out"),
    ):
        assert_users_mistake(run(*command), "model.toml", "another geometry", "mm apart")
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "out.toml").exists()


def test_a_diagnosis_starts_from_a_model_that_is_no_file_too(tmp_path: Path) -> None:
    table, complete = measured(), StiffnessModel.of(reduce(load(ROBOT), "force", "position"))
    given = diagnose(Task(load(ROBOT), table, complete))
    complete.save(tmp_path / "model.toml")
    read = diagnose(Task(load(ROBOT), table, str(tmp_path / "model.toml")))
    assert (given.verdict, given.rms, given.task.origin) == (read.verdict, read.rms, "a model")
    with pytest.raises(
        UserError, match=f"the start model is a model of scara, not of {ROBOT}: name that robot"
    ):
        identify(load(ROBOT), table, scara())


def test_generated_code_leaves_out_what_the_measuring_device_does(run: Run, tmp_path: Path) -> None:
    scara().with_effect(DRIFT).save(tmp_path / "model.toml")
    done = run(
        "generate", "scara", "--model", tmp_path / "model.toml", "-o", tmp_path / "out", "--no-compile"
    )
    assert done.code == 0
    assert "without thermal drift (measuring frame)" in done.out + done.err
    assert "thermal" not in (tmp_path / "out" / "scara.h").read_text()
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["left_out"] == ["thermal drift (measuring frame)"]


def test_a_misspelt_key_of_a_shape_is_refused(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    scara().with_effect(EffectInstance("backlash", {"joint": 2}, {"width": 3.0})).save(path)
    assert "width = 3.0" in path.read_text()
    path.write_text(path.read_text().replace("width = 3.0", "widht = 3.0"))
    mistake = run("generate", "scara", "--model", tmp_path / "model.toml", "-o", tmp_path / "out")
    assert_users_mistake(mistake, "model.toml", "backlash", "widht")


@pytest.mark.parametrize("harmonics", ["-1", "0", "1, 1", ""])
def test_harmonics_that_are_none_are_refused(run: Run, tmp_path: Path, harmonics: str) -> None:
    path = tmp_path / "model.toml"
    scara().with_effect(EffectInstance("transmission_error", {"joint": 2, "harmonics": [3]})).save(path)
    text, place = path.read_text(), re.compile(r"harmonics = \[\s*3,?\s*\]")
    assert place.search(text)
    path.write_text(place.sub(f"harmonics = [{harmonics}]", text))
    mistake = run("generate", "scara", "--model", path, "-o", tmp_path / "out", "--no-compile")
    assert_users_mistake(
        mistake, "model.toml", "transmission_error", "give different numbers above zero in a list"
    )


def test_a_stiffness_among_a_models_compliances_is_refused(run: Run, tmp_path: Path) -> None:
    model = scara()
    name = next(iter(model.parameters))
    model.with_values({name: 76245.0}).save(tmp_path / "model.toml")
    mistake = run("generate", "scara", "--model", tmp_path / "model.toml", "-o", tmp_path / "out")
    assert_users_mistake(mistake, "model.toml", f"values: {name}: 76245 looks like a stiffness", "1/76245")
    assert not (tmp_path / "out").exists()


def test_a_robot_file_given_as_a_model_is_told_as_one(run: Run, tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(OBLIQUE)
    mistake = run("generate", "scara", "--model", tmp_path / "arm.toml", "-o", tmp_path / "out")
    assert_users_mistake(mistake, "arm.toml: this is a robot file", "symstiff identify")
    lost = run("generate", "scara", "--model", tmp_path / "none.toml", "-o", tmp_path / "out")
    assert_users_mistake(lost, "none.toml: cannot read the model", "check the path")


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_a_misspelt_start_is_told_what_a_start_may_be(run: Run, tmp_path: Path, command: str) -> None:
    write_table(measured(), tmp_path / "data.csv")
    mistake = run(command, ROBOT, tmp_path / "data.csv", "--start", "joint", "-o", tmp_path / "out")
    assert_users_mistake(mistake, "--start: joint: no such model file", "complete, joints")


@pytest.mark.parametrize("effect", sorted(catalogue()))
@pytest.mark.parametrize("kind", ["deflection", "absolute"])
def test_every_shape_of_the_catalogue_is_read_whole(effect: str, kind: str) -> None:
    robot, entry = load("ur10"), catalogue()[effect]
    scales = Scales(kind, angles=((0.1, 0.4),) * robot.dof, context={"time": 10.0, "temperature": 5.0})
    for where in entry.places(robot):
        for shape in entry.shapes(robot, where, scales):
            assert not EffectInstance(effect, where, shape).unread(robot)


def test_a_gap_in_sigma_takes_the_median_of_its_kind_and_a_kind_without_any_is_unknown() -> None:
    model, n = scara(), 6
    q, w = np.linspace(0.1, 0.6, 4 * n).reshape(n, 4), np.tile([0, 0, -50.0, 0, 0, 0], (n, 1))
    sigma = np.full((n, 6), np.nan)
    sigma[:, 0], sigma[0, 1] = 1e-5, 3e-5
    values = np.where(np.arange(6) < 3, 1e-4, np.nan) * np.ones((n, 1))
    table = measurements(
        q, w, values=values, sigma=sigma, kind="deflection", joint_units=["rad", "rad", "m", "rad"]
    )
    found = equations(model, table).sigma
    assert found is not None
    assert sorted(found)[-1] == 3e-5
    assert np.sum(found == 1e-5) == 3 * n - 1
    rotations = np.array([3, 4, 5])
    assert stated_sigma(table, np.zeros(3, dtype=np.intp), rotations) is None


def test_columns_that_are_the_rounding_of_others_are_told_as_not_loaded() -> None:
    robot = load("planar2r")
    model = StiffnessModel.of(reduce(robot))
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.5, 2.5, (40, 2))
    w = rng.normal(size=(40, 6)) * [100, 100, 100, 0, 0, 50]
    values = model.deflection(q, w) + 1e-7 * rng.normal(size=(40, 6))
    table = measurements(q, w, values=values, kind="deflection", joint_units=["rad", "rad"])
    with pytest.raises(UserError, match=r"not loaded at all: .*k2_44"):
        identify(robot, table)


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect",
    [
        EffectInstance("joint_offset", {"joint": 2}),
        EffectInstance("transmission_error", {"joint": 1, "harmonics": [8]}),
        EffectInstance("geometric_error", {"link": 1}),
    ],
)
def test_what_deflections_do_not_show_stays_as_it_was_told(effect: EffectInstance, tmp_path: Path) -> None:
    """An offset cancels in loaded minus unloaded: fitted to what is second order it would be overwritten."""
    robot, table = load(ROBOT), measured()
    bare = StiffnessModel.of(reduce(robot, "force", "position"))
    grown = bare.with_effect(effect)
    names = [p.name for p in grown.effect_parameters]
    told = grown.with_values(dict(bare.values) | dict.fromkeys(names, 1e-3), dict.fromkeys(names, 2e-5))
    without, kept = identify(robot, table, bare), identify(robot, table, told)
    assert {n: kept.model.values[n] for n in names} == dict.fromkeys(names, 1e-3)
    assert {n: kept.model.deviations[n] for n in names} == dict.fromkeys(names, 2e-5)
    assert {n: kept.model.values[n] for n in bare.parameters} == dict(without.model.values)
    assert any("deflections do not show it" in r for r in kept.remarks)
    found = diagnose(Task(robot, table, told))
    assert found.verdict == diagnose(Task(robot, table, bare)).verdict
    write_report(found, tmp_path / "report")
    saved = load_model(tmp_path / "report" / "model.toml")
    assert {n: saved.values[n] for n in names} == dict.fromkeys(names, 1e-3)
    assert effect.effect in [e.effect for e in saved.effects]
    assert any("deflections do not show it" in r for r in found.remarks)


def test_a_start_of_nothing_that_deflections_show_has_nothing_to_identify() -> None:
    offset = EffectInstance("joint_offset", {"joint": 1})
    start = StiffnessModel(load("planar2r"), (), "gravity", "position", (offset,))
    q, w, sunk = (
        np.radians([[10.0, 20.0], [60.0, -50.0]]),
        [0, 0, -100, 0, 0, 0],
        [0, 0, -5e-4, *[np.nan] * 3],
    )
    table = measurements(q, [w] * 2, kind="deflection", values=[sunk] * 2)
    with pytest.raises(
        UserError, match=r"nothing to identify: joint offset \(1\): deflections do not show it"
    ):
        identify(load("planar2r"), table, start)


def test_a_weight_that_a_bending_law_would_feel_is_told() -> None:
    """Loaded minus unloaded shows no weight, but a gear that bends stands elsewhere on its law under it."""
    robot = load(ROBOT)
    bent = StiffnessModel.of(reduce(robot, "force", "position")).with_effect(
        EffectInstance("nonlinear_stiffness", {"joint": 2}, {"load": 500.0, "power": 2.0})
    )
    for other, told in (("link_weight", True), ("geometric_error", False)):
        _, remarks = seen_in(bent.with_effect(EffectInstance(other, {"link": 1})), "deflection")
        assert any("the law of joint2 bends under the links' weight too" in r for r in remarks) == told
    plain = StiffnessModel.of(reduce(robot, "force", "position"))
    _, remarks = seen_in(plain.with_effect(EffectInstance("link_weight", {"link": 1})), "deflection")
    assert len(remarks) == 1


PLANAR = load("planar2r")


@pytest.mark.parametrize(
    "mistake",
    [
        lambda: symstiff.reduce("planar2r"),
        lambda: symstiff.reduce(PLANAR, fixed={"q1": 0}),
        lambda: symstiff.reduce(PLANAR, fixed="q1=0"),
        lambda: symstiff.load(None),
        lambda: symstiff.load_model(None),
        lambda: symstiff.load_truth(None),
        lambda: symstiff.read_table(3),
        lambda: symstiff.read_table(pd.DataFrame({"q1[rad]": [0.0]})),
        lambda: symstiff.observation_matrix(symstiff.ElasticChain(PLANAR), W=[0, 0, -1]),
        lambda: symstiff.identify("planar2r", "data.csv"),
        lambda: symstiff.identify(PLANAR, "data.csv"),
        lambda: symstiff.diagnose("planar2r"),
        lambda: symstiff.plan("planar2r", symstiff.Goal(5)),
        lambda: symstiff.simulate("truth.toml", None, 1),
        lambda: symstiff.compensate("model.toml", [0, 0], [0] * 6),
        lambda: symstiff.generate("planar2r", "folder"),
        lambda: symstiff.write_table("data.csv", "data.csv"),
        lambda: symstiff.write_report("planar2r", "folder"),
        lambda: symstiff.ElasticChain("planar2r"),
        lambda: symstiff.observation_matrix(PLANAR),
        lambda: symstiff.virtual_jacobian("planar2r"),
        lambda: symstiff.StiffnessModel.of("planar2r"),
    ],
)
def test_an_argument_of_another_type_is_a_users_mistake_of_one_line(mistake: Callable[[], object]) -> None:
    with pytest.raises(UserError, match=r"^[^\n]*expected[^\n]*found[^\n]*$"):
        mistake()


@pytest.mark.parametrize("value", [np.nan, np.inf, "a", "1e-9", None, [1.0, 2.0]])
def test_a_model_has_finite_numbers(value: object) -> None:
    model = joints_only(PLANAR)
    with pytest.raises(UserError, match="values: c1: expected a finite number"):
        model.with_values({"c1": value})  # type: ignore[dict-item]
    with pytest.raises(UserError, match="deviations: c1: expected a finite number"):
        model.with_values({"c1": 1e-7}, {"c1": value})  # type: ignore[dict-item]
    with pytest.raises(UserError, match="deviations: c1: expected 0 or more"):
        model.with_values({"c1": 1e-7}, {"c1": -1e-9})


def test_numbers_of_numpy_and_joints_that_it_counts_are_taken() -> None:
    assert joints_only(PLANAR).with_values({"c1": np.float64(1e-7), "c2": 0}).values == {
        "c1": 1e-7,
        "c2": 0.0,
    }
    assert (
        symstiff.reduce(PLANAR, fixed={np.int64(1): 0}).parameters
        == symstiff.reduce(PLANAR, fixed={1: 0}).parameters
    )


@pytest.mark.parametrize(
    ("effect", "where"),
    [
        ("frame_misalignment", {"measurement": "frame"}),
        ("force_sensor_bias", {"load": "force_sensor"}),
        ("link_weight", {"link": 1}),
    ],
)
def test_a_law_at_no_virtual_joint_has_no_column_in_closed_form(
    effect: str, where: dict[str, object]
) -> None:
    terms = joints_only(PLANAR).with_effect(EffectInstance(effect, where)).terms
    with pytest.raises(UserError, match="no virtual joint of planar2r"):
        symstiff.observation_matrix(symstiff.ElasticChain(PLANAR), terms=terms)


def test_two_laws_of_one_parameter_are_refused_and_equal_ones_are_not(run: Run, tmp_path: Path) -> None:
    """A gap that turns over within two widths would be two laws with one size."""
    path = tmp_path / "model.toml"
    wide, sharp = (EffectInstance("backlash", {"joint": 2}, {"width": w}) for w in (50.0, 5.0))
    grown = scara().with_effect(wide)
    with pytest.raises(UserError, match="two laws of one parameter, backlash_2_gap"):
        _ = grown.with_effect(sharp).parameters
    grown.save(path)
    (entry,) = re.findall(r"^ *\{ effect = .*$", path.read_text(), re.MULTILINE)
    path.write_text(path.read_text().replace(entry, f"{entry}\n{entry.replace('50', '5')}"))
    mistake = run("generate", "scara", "--model", path, "-o", tmp_path / "out", "--no-compile")
    assert_users_mistake(
        mistake, "model.toml", "effect: backlash", "two laws of one parameter, backlash_2_gap"
    )
    blocks = tuple(EffectInstance(name, {"link": 2}) for name in ("link_compliance", "link_asymmetry"))
    scara().with_effects(blocks).save(path)
    assert load_model(path).effects == blocks
