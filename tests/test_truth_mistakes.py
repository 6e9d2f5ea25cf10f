"""Mistakes in a truth: one line that names the file, the key and what would be right."""

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.simulation import (
    Effect,
    Environment,
    Noise,
    load_truth,
    simulate,
)
from symstiff.calibration.tables.table import write_table
from symstiff.cli.calibrate import run_simulate
from symstiff.errors import UserError
from tests.test_truths import BARE, TRUTH, design


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (
            Effect("base_slip", None, "threshold", {"c": 1e-6, "axis": 7}),
            "axis 7: a whole number from 1 to 6",
        ),
        (Effect("base_slip", None, "threshold", {"c": 1e-6, "axis": 0}), "axis 0: a whole number"),
        (
            Effect("configuration_dependent_link", {"link": 2}, "sine", {"fraction": 0.1, "joint": 2.5}),
            "joint 2.5: a whole number from 1 to 6",
        ),
        (
            Effect("link_asymmetry", {"link": 2}, "tilted", {"angle": 0.1, "axis": [0.0, 0.0, 0.0]}),
            "has a length",
        ),
    ],
)
def test_a_number_that_counts_nothing_of_the_robot_is_refused(effect: Effect, message: str) -> None:
    with pytest.raises(UserError, match=message):
        simulate(BARE.with_effects(effect), design(2), 1)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (Effect("hysteresis", {"joint": 3}, values={"width": 1e-4}), "follows the branch.*column branch"),
        (Effect("thermal_drift", values={"rate": 1e-6}), r"follows the time.*time\[s\], or \[environment\]"),
        (
            Effect("thermal_drift", None, "temperature", {"rate": 1e-6}),
            r"the temperature.*temperature\[degC\], or",
        ),
        (
            Effect("bad_poses", values={"poses": ["zz"], "shift": 1e-3}),
            "no pose is called zz: the table has p1",
        ),
    ],
)
def test_an_effect_that_would_leave_no_trace_is_refused(effect: Effect, message: str) -> None:
    truth, table = BARE.with_effects(effect), design(2)
    with pytest.raises(UserError, match=message):
        simulate(truth, table, 1)
    rows = len(table)
    told = replace(
        table,
        labels=("zz", *table.labels[1:]),
        time=np.arange(rows) * 60.0,
        temperature=20.0 + np.arange(rows),
        branch=np.where(np.arange(rows) % 2, -1.0, 1.0),
    )
    left = simulate(truth, told, 1).values - simulate(BARE, told, 1).values
    assert np.nanmax(np.abs(left)) > 1e-6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('robot = "kuka_kr270"', 'robot = "no_such_robot"'),
        ("c2 = 0.3e-6", "c9 = 1e-6"),
        ("c2 = 0.3e-6", "c2 = nan"),
        ("c2 = 0.3e-6", "c2 = -0.3e-6"),
        ("k2_12 = 1e-9", "k2_11 = -1e-9"),
        ("gap = 2e-4", "gapp = 2e-4"),
        ("gap = 2e-4", "gap = inf"),
        ("gap = 2e-4", 'gap = "wide"'),
        ("gap = 2e-4", "gap = [1e-4, 2e-4]"),
        ("gap = 2e-4", ""),
        ('"backlash"', '"backslash"'),
        ("joint = 3", "joint = 7"),
        ("joint = 3", "link = 3"),
        ("growth_ppm", "growth"),
        ("sigma_mm = [0.02, 0.02, 0.04]", "sigma_mm = [0.02, 0.02]"),
        ("quantum_mm = 0.001", "quantum_mm = -1"),
        ("format = 1", "format = 2"),
        ("[noise]", "[noise"),
    ],
)
def test_a_mistake_in_a_truth_is_one_line_with_the_file(tmp_path, change, message):
    assert change in TRUTH
    (tmp_path / "truth.toml").write_text(TRUTH.replace(change, message))
    write_table(design(1), tmp_path / "poses.csv")
    with pytest.raises(UserError) as error:
        run_simulate(tmp_path / "truth.toml", tmp_path / "poses.csv", tmp_path / "data.csv", None, 1)
    assert "truth.toml" in str(error.value)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "data.csv").exists()


@pytest.mark.parametrize(
    ("effect", "says"),
    [
        (
            '"link_compliance"\nwhere = {link = 1}\nentries = 1e-9',
            r"entries: expected a table .*, found 1e-09",
        ),
        ('"link_compliance"\nwhere = {link = 1}\nentries = {}', "entries: expected a table"),
        (
            '"link_compliance"\nwhere = {link = 1}\nentries = {26 = 1e-7, 62 = 2e-7}',
            "entry '62': .* row ≤ column",
        ),
        ('"wrist_coupling"\nwhere = {joints = [2, 2]}\nc = 1e-7', r"joints = \[2, 2\]: name two joints"),
        (
            '"link_compliance"\nwhere = {link = 1}\nentries = {11 = [1e-9]}',
            r"entries.11: expected a finite number",
        ),
        ('"backlash"\nwhere = {joint = 2}\ngap = {joints = [1]}', "gap: expected a finite number, found {"),
        (
            '"backlash"\nwhere = {joint = 2}\ngap = [1e-4, 2e-4]',
            r"gap: expected a finite number, found \[0.0001, 0",
        ),
        (
            '"force_sensor_bias"\nbias = [1, 2, 3]',
            r"bias: expected 6 numbers, or one for all, found \[1, 2, 3\]",
        ),
        (
            '"link_weight"\nwhere = {link = 1}\nmass = 5\ncom = [0.1]',
            "com: expected 3 numbers, or one for all",
        ),
        ('"transmission_error"\nwhere = {joint = 1}\na = []', r"a: expected a list of numbers, found \[\]"),
        (
            '"bad_poses"\nposes = ["p1"]\nshift = {x = 1e-3}',
            "shift: expected 3 numbers, or one for all, found {",
        ),
        ('"bad_poses"\nposes = "p1"\nshift = 1e-3', "poses: expected a list of labels .*, found 'p1'"),
        ('"bad_poses"\nshift = 1e-3', "poses: expected a list of labels"),
    ],
)
def test_a_size_of_another_form_is_told_with_what_would_be_right(tmp_path, effect, says):
    (tmp_path / "truth.toml").write_text(f'format = 1\nrobot = "planar2r"\n[[effect]]\neffect = {effect}\n')
    with pytest.raises(UserError, match=says) as error:
        load_truth(tmp_path / "truth.toml")
    assert "truth.toml: effect " in str(error.value)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("effect", "says"),
    [
        ('"thermal_drift"\nshape = "time"\nwhere = {link = 1}\nrate = 1e-4', "link is no place .*(link_time"),
        (
            '"force_sensor_bias"\nwhere = {joint = 1}\nbias = 1',
            "joint is no place of this shape: leave it out",
        ),
        (
            '"transmission_error"\nwhere = {joint = 1, harmonics = [5]}\na = 1e-4\nharmonics = [7]',
            "harmonics is no place of this shape: leave it out",
        ),
        ('"force_sensor_bias"\nwhere = 3\nbias = 1', "where: expected a table, found 3"),
        (
            '"backlash"\nwhere = {joint = 1, foo = 2}\ngap = 1e-4',
            "foo is no place of this shape: leave it out",
        ),
        (
            '"backlash"\nwhere = {joint = 1}\nshape = "ramp"\ngap = 1e-4\nknee = -5',
            "knee: expected a .*than 0",
        ),
        (
            '"backlash"\nwhere = {joint = 1}\nshape = "ramp"\ngap = 1e-4\nknee = 0',
            "knee: expected a .*than 0",
        ),
        (
            '"nonlinear_stiffness"\nwhere = {joint = 1}\nshape = "tanh"\na = 1\ntau0 = 0',
            "tau0: expected a .*than 0",
        ),
        ('"creep"\nwhere = {joint = 1}\nc = 1e-7\nT = 0', "T: expected a number greater than 0, found 0"),
    ],
)
def test_a_place_or_a_scale_that_a_shape_does_not_use_is_refused(tmp_path, effect, says):
    (tmp_path / "truth.toml").write_text(f'format = 1\nrobot = "planar2r"\n[[effect]]\neffect = {effect}\n')
    with pytest.raises(UserError, match=says.replace("(", r"\(")):
        load_truth(tmp_path / "truth.toml")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("truth", "says"),
    [
        (replace(BARE, environment=Environment(interval=1e308)), r"row 2: time\[s\] would be 1e\+308"),
        (replace(BARE, environment=Environment(interval=1e12)), r"row 2: time\[s\] would be 1e\+12"),
        (
            replace(BARE, environment=Environment(temperature=1e9)),
            r"row 1: temperature\[degC\] would be 1e\+09",
        ),
        (
            BARE.with_effects(Effect("bad_poses", values={"poses": ["p1"], "shift": 2.0})),
            r"row 1: dx\[mm\] would be",
        ),
        (replace(BARE, noise=Noise(sigma_mm=(1e4,) * 3, quantum_mm=1.0)), r"row 1: dx\[mm\] would be"),
        (replace(BARE, noise=Noise(sigma_mm=(1e308,) * 3)), r"row 1: dx\[mm\] would be"),
        (replace(BARE, noise=Noise(sigma_mm=(1e-5, 100.0, 100.0))), "differ by more than 1e\\+06"),
        (replace(BARE, noise=Noise(sigma_mm=(1e-12,) * 3)), r"row 1: sigma_x\[mm\] would be 1e-12"),
    ],
)
def test_no_table_is_made_that_would_not_be_read(truth, says):
    with pytest.raises(UserError, match=says):
        simulate(truth, design(2), 1)


@pytest.mark.parametrize("stated", ["true", "1.0", '"1"', "2"])
def test_another_format_of_a_truth_is_refused(tmp_path, stated):
    (tmp_path / "truth.toml").write_text(f'format = {stated}\nrobot = "planar2r"\n')
    with pytest.raises(UserError, match="this program reads format = 1"):
        load_truth(tmp_path / "truth.toml")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "effect",
    [
        Effect("force_sensor_bias", values={"bias": 1e30}),
        Effect("backlash", {"joint": 2}, values={"gap": 1e308}),
        Effect("joint_compliance", {"joint": 2}, values={"c": 1e30}),
    ],
)
def test_sizes_beyond_all_measure_have_no_equilibrium(effect):
    with pytest.raises(UserError, match="no static equilibrium"):
        simulate(BARE.with_effects(effect), design(2), 1)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("c2 = " + "9" * 1900, "compliance.c2: expected a finite number"),
        ("c2 = " + "\n".join(["[", *["9,"] * 2, "]"]), "compliance.c2: expected a finite number"),
        ("c2 = " + "9" * 5000, "longer than 2000 characters"),
    ],
)
def test_a_number_of_thousands_of_digits_is_a_users_mistake(tmp_path, line, says):
    (tmp_path / "truth.toml").write_text(f'format = 1\nrobot = "planar2r"\n[compliance]\n{line}\n')
    with pytest.raises(UserError, match=says):
        load_truth(tmp_path / "truth.toml")
