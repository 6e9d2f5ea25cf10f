"""docs/formats.md: its examples go through the real readers, and its tables name what the code knows."""

from __future__ import annotations

import ast
import inspect
import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import Run, run_command_line  # noqa: F401
from definition import motion

from symstiff.calibration.complete import reconstruct_model
from symstiff.calibration.identify import identify
from symstiff.calibration.simulation import SHAPES, load_truth
from symstiff.calibration.tables.checks import check_robot
from symstiff.calibration.tables.measurements import measurements
from symstiff.calibration.tables.table import read_poses, read_table
from symstiff.codegen.verify import Verification
from symstiff.effects.registry import catalogue
from symstiff.model import StiffnessModel
from symstiff.model_file import ModelFile
from symstiff.reduction import reduce
from symstiff.report import verdict
from symstiff.robot import load, parse
from symstiff.robot.schema import KEYS, Robot
from symstiff.symbolic.chain import ElasticChain

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
SPOKEN = set(re.findall(r"`([^`\n]+)`", PAGE))
WORDS = set(re.findall(r"[A-Za-z_]\w*", " ".join(SPOKEN)))


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def arm() -> Robot:
    robot_file, truth = blocks("toml")
    assert "[[joint]]" in robot_file
    assert "[[effect]]" in truth
    return parse(robot_file.encode(), "the page")


# --- examples --------------------------------------------------------------------------------------------


def test_the_robot_of_the_page_is_what_its_comments_say(arm: Robot) -> None:
    assert (arm.dof, arm.joint[2].prismatic, arm.convention) == (3, True, "standard")
    assert arm.links[2].compliance["66"] == 4e-7
    assert arm.gravity_compensator is not None
    assert arm.gravity_compensator.s0 == 0.2
    reduction = reduce(arm, "gravity", "position")
    names = [p.name for p in reduction.stages[2].parameters]
    assert [n for n in names if n.startswith("k2")] == ["k2_11", "k2_22", "k2_26", "k2_66"]
    assert not [n for n in names if n.startswith("k3")]
    assert np.isfinite(StiffnessModel.of(reduction).vector()).all()


def test_the_beam_and_the_weight_of_the_page_lie_along_their_link(arm: Robot) -> None:
    """Frame 0's origin seen in frame 1 from the product of the row's matrices, not from the page's formula."""
    step = np.eye(4)
    for kind, value in (("tz", arm.joint[0].d), ("tx", arm.joint[0].a), ("rx", arm.joint[0].alpha)):
        step = step @ motion(kind, float(value)).astype(complex).real
    back = np.linalg.inv(step)[:3, 3]
    link = arm.links[1]
    assert link.beam_axis is not None
    np.testing.assert_allclose([float(v) for v in link.beam_axis], -back, atol=1e-12)
    np.testing.assert_allclose(link.com, back / 2, atol=1e-12)


def test_the_rule_for_the_beam_axis_is_the_one_of_the_page() -> None:
    robot = load("kuka_kr270").model_copy(
        update={
            "joint": tuple(j.model_copy(update={"link": type(j.link)()}) for j in load("kuka_kr270").joint)
        }
    )
    chain = ElasticChain(robot)
    for i, joint in enumerate(robot.joint, start=1):
        a, alpha, d = float(joint.a), float(joint.alpha), float(joint.d)
        along = np.round(np.abs([a, d * np.sin(alpha), d * np.cos(alpha)]), 12)
        assert chain._default_axis(i) == "xyz"[int(np.argmax(along))]


def test_the_tables_of_the_page_are_read(arm: Robot, tmp_path: Path) -> None:
    deflections, absolute, trajectory = blocks("csv")
    file = tmp_path / "table.csv"
    for text, reader, kind, rows in (
        (deflections, read_table, "deflection", 5),
        (absolute, read_table, "absolute", 3),
        (trajectory, read_poses, "none", 2),
    ):
        file.write_text(text)
        table = reader(file)
        assert (table.kind, len(table)) == (kind, rows)
        assert check_robot(table, arm) == []


def test_the_truth_of_the_page_is_read(tmp_path: Path) -> None:
    (tmp_path / "truth.toml").write_text(blocks("toml")[1])
    truth = load_truth(tmp_path / "truth.toml")
    assert [e.effect for e in truth.effects] == ["backlash", "bad_poses"]
    assert truth.noise.growth_ppm == 5.0
    for name in ("noise", "device", "environment"):
        assert set(vars(getattr(truth, name))) <= set(re.findall(r"^\w+", blocks("toml")[1], re.MULTILINE))


def test_the_json_of_inspect_is_what_the_command_writes(run: Run, tmp_path: Path) -> None:
    told = json.loads(blocks("json")[2])
    place = tmp_path / "inspect.json"
    assert (
        run("inspect", "planar2r", "--loads", "gravity", "--measure", "position", "--json", place).code == 0
    )
    assert json.loads(place.read_text()) == told


def test_the_json_of_identify_and_of_complete_matrices_has_the_keys_of_the_page() -> None:
    identified, complete = (json.loads(text) for text in blocks("json")[:2])
    robot = load("planar2r")
    rng = np.random.default_rng(0)
    q, w = rng.uniform(-1, 1, (40, 2)), np.tile([0.0, 0, -100, 0, 0, 0], (40, 1))
    model = StiffnessModel.of(reduce(robot, "gravity", "pose"))
    truth = model.with_values(dict.fromkeys(model.parameters, 1e-07))
    values = truth.deflection(q, w) + 1e-9 * rng.normal(size=(40, 6))
    result = identify(robot, measurements(q, w, kind="deflection", values=values), robust=True, physical=True)
    found = result.to_dict()
    assert set(found) == {*identified, "robust"}
    assert set(found["residuals"]) == set(identified["residuals"])
    assert set(found["rank"]) == set(identified["rank"])
    assert {*found["robust"], *found["physical"]} <= WORDS
    (entry,) = identified["parameters"].values()
    assert all(set(p) == set(entry) for p in found["parameters"].values())
    rebuilt = reconstruct_model(result).to_dict()
    assert set(rebuilt) == set(complete)
    assert set(rebuilt["bounds"]) == set(complete["bounds"])
    assert all(set(r) == {"value", "shift_std"} for r in rebuilt["reduced"].values())


def test_the_entry_of_a_verdict_is_json_with_the_keys_of_a_verdict() -> None:
    *_, entry = (json.loads(text) for text in blocks("json"))
    assert set(entry) == keys_of("effect_table")


# --- tables ----------------------------------------------------------------------------------------------


def keys_of(function: str) -> set[str]:
    """Keys of the dictionary that a function of the verdict's module returns, nested ones included."""
    tree = ast.parse(Path(verdict.__file__).read_text(encoding="utf-8"))
    (body,) = (n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == function)
    dictionaries = (n for n in ast.walk(body) if isinstance(n, ast.Dict))
    return {k.value for d in dictionaries for k in d.keys if isinstance(k, ast.Constant)}


@pytest.mark.parametrize(
    "function", ["verdict_table", "_candidate", "_stratum", "_noise", "_law", "_device_law"]
)
def test_every_key_of_a_verdict_is_told(function: str) -> None:
    assert keys_of(function) <= WORDS | {"law", "value", "std", "unit"}


def test_every_key_of_robot_model_and_manifest_is_told() -> None:
    examples = set(re.findall(r"\w+", " ".join(blocks("toml"))))
    assert set(KEYS) <= WORDS | examples
    assert set(ModelFile.model_fields) <= WORDS | examples
    manifest = json.loads((ROOT / "generated" / "kuka_kr270" / "manifest.json").read_text())
    told = {*manifest, *manifest["options"], *manifest["operations"]["deflection"]}
    assert told | set(inspect.signature(Verification).parameters) - {"selftest"} <= WORDS
    (options,) = re.findall(r"^\| `options` \| (.*) \|$", PAGE, re.MULTILINE)
    assert set(manifest["options"]) <= set(re.findall(r"`(\w+)`", options))


def test_every_shape_of_an_effect_is_told_with_its_options() -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("| ")]
    effect = ""
    told: dict[tuple[str, str], str] = {}
    for row in rows:
        cells = [c.strip() for c in row.replace(r"\|", "").strip("|").split("|")]
        effect = cells[0] or effect
        for name in re.findall(r"`(\w+)`", effect):
            for shape in re.findall(r"`(\w+)`", cells[1]):
                told.setdefault((name, shape), row)
    for (name, shape), entry in SHAPES.items():
        assert (name, shape) in told, f"{name} ({shape}) is not told"
        place = entry.place if entry.place in ("joint", "joints", "link") else "none"
        row = told[name, shape]
        assert place in re.split(r"[ ;|]+", row), f"{name} ({shape}) is at {place}"
        for option in {*entry.amplitudes, *entry.defaults}:
            assert option in row or "…" in row or "the same" in row, f"{name} ({shape}): {option}"


def test_the_page_knows_no_shape_that_the_simulator_does_not() -> None:
    sections = PAGE.split("## Truth file")[1].split("## model.toml")[0]
    first = {
        n
        for row in sections.splitlines()
        for n in re.findall(r"`(\w+)`", row.split("|")[1] if "|" in row else "")
    }
    assert first - {"toml"} == {effect for effect, _ in SHAPES}


def test_every_effect_of_the_catalogue_has_its_form_of_where() -> None:
    section = PAGE.split("`where` takes these forms")[1].split("## manifest.json")[0]
    rows = [line for line in section.splitlines() if line.startswith("| `{")]
    robot = load("kuka_kr270")
    for effect in catalogue().values():
        places = effect.places(robot) or ({"rows": ["p4"]},)
        for keys in {tuple(place) for place in places}:
            pattern = ".*".join(f'"{key}"' for key in keys)
            assert any(
                re.search(rf"\{{{pattern}: [^}}]*\}}`.*\b{effect.identifier}\b", row) for row in rows
            ), f"{effect.identifier} at {keys}"


def test_every_error_of_the_c_interface_is_told_with_its_value() -> None:
    told = dict(re.findall(r"\| (\S+) \| `KUKA_KR270_(\w+)` \|", PAGE))
    header = (ROOT / "generated" / "kuka_kr270" / "kuka_kr270.h").read_text(encoding="utf-8")
    templates = [
        (ROOT / "templates" / "c" / f"{n}.h.j2").read_text(encoding="utf-8") for n in ("params", "rls")
    ]
    text = "".join((header, *templates)).replace("{{ upper }}", "KUKA_KR270")
    found = {"0": "OK"} | {v: n for n, v in re.findall(r"#define KUKA_KR270_(E_\w+) +\((-\d+)\)", text)}
    assert {k.replace("−", "-"): v for k, v in told.items()} == found


def test_the_c_functions_of_the_page_are_those_of_the_header() -> None:
    header = (ROOT / "generated" / "kuka_kr270" / "kuka_kr270.h").read_text(encoding="utf-8")
    (shown,) = blocks("c")
    for line in shown.splitlines():
        if line.startswith(("int ", "extern ")):
            assert line in header


def test_the_readme_links_to_the_page() -> None:
    assert "docs/formats.md" in (ROOT / "README.md").read_text(encoding="utf-8")
