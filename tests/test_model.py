"""StiffnessModel: saved and read back, spoilt files, known values, the joints-only models."""

from __future__ import annotations

import copy
import errno
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from definition import jacobians, places, samples

from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import catalogue, find
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only, load_model
from symstiff.reduction import reduce
from symstiff.reduction.complete import known_values
from symstiff.robot import from_table, library, load
from symstiff.robot.table import to_table

KR270 = load("kuka_kr270")


def small() -> StiffnessModel:
    model = StiffnessModel.of(reduce(load("planar2r"), "wrench"))
    values = {n: 1e-7 * (k + 1) for k, n in enumerate(model.parameters)}
    return model.with_values(values, {model.parameters[0]: 1e-9})


# --- saving and loading ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", library())
def test_a_saved_model_reads_back_the_same_and_saves_the_same_bytes(name: str, tmp_path: Path) -> None:
    model = StiffnessModel.of(reduce(load(name), "gravity"))
    rng = np.random.default_rng(1)
    size = {n: float(x) for n, x in zip(model.parameters, rng.lognormal(-15, 3, 99), strict=False)}
    model = model.with_values(size, {n: v / 7 for n, v in size.items()})
    model.save(tmp_path / "model.toml")
    again = load_model(tmp_path / "model.toml")
    assert again == model
    assert again.structure_hash == model.structure_hash
    again.save(tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_bytes() == (tmp_path / "model.toml").read_bytes()


def test_what_the_values_were_fitted_to_is_kept_and_changes_no_hash(tmp_path: Path) -> None:
    plain = small()
    seen = {"q1": (-0.5, 0.5), "fz": (-100.0, 0.0), "time": (0.0, 60.0)}
    model = plain.with_seen(seen)
    assert model.structure_hash == plain.structure_hash
    assert model.with_values(dict(plain.values)).seen == seen
    model.save(tmp_path / "model.toml")
    assert "fz = [" in (tmp_path / "model.toml").read_text()
    assert load_model(tmp_path / "model.toml") == model != plain
    plain.save(tmp_path / "old.toml")
    assert "seen" not in (tmp_path / "old.toml").read_text()
    assert load_model(tmp_path / "old.toml").seen == {}


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ({"compliances": ("c1",)}, "compliances: expected a list"),
        ({"compliances": 3}, "compliances: expected a list"),
        ({"file_tool": "abc"}, "file_tool: expected numbers"),
        ({"file_tool": (0.0, 1.0)}, "file_tool: expected three lengths"),
        ({"file_tool": (0.0, 1.0, np.nan)}, "file_tool: expected three lengths"),
    ],
)
def test_parts_that_are_none_of_a_model_are_refused_where_they_are_given(parts: Any, told: str) -> None:
    with pytest.raises(UserError, match=re.escape(told)):
        replace(joints_only(load("planar2r")), **parts)


@pytest.mark.parametrize("between", [3.0, [1.0], [2.0, 1.0], [[0.0], [1.0]]])
def test_a_range_of_what_was_seen_has_two_ends(between: Any) -> None:
    with pytest.raises(UserError, match="seen: q1: expected the least and the greatest value"):
        joints_only(load("kuka_kr270")).with_seen({"q1": between})


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("q9 = [0.0, 1.0]", "seen: q9: no such name"),
        ("fz = [1.0, 0.0]", "seen: fz: expected the least and the greatest value"),
        ("fz = [0.0]", "seen.fz"),
        ("fz = [0.0, nan]", "seen.fz"),
    ],
)
def test_a_range_that_is_none_is_a_mistake_of_the_file(tmp_path: Path, line: str, told: str) -> None:
    path = tmp_path / "model.toml"
    small().save(path)
    path.write_text(path.read_text() + f"\n[seen]\n{line}\n")
    with pytest.raises(UserError, match=re.escape(told)) as raised:
        load_model(path)
    assert str(path) in str(raised.value)


def test_a_model_with_effects_survives_the_file_and_predicts_the_same(tmp_path: Path) -> None:
    model = small()
    for effect in (
        EffectInstance("backlash", {"joint": 2}, {"width": 1.0}),
        EffectInstance("wrist_coupling", {"joints": [1, 2]}),
    ):
        try:
            effect.realise(model.robot)
        except UserError:
            continue
        model = model.with_effect(effect)
    model = model.with_effect(EffectInstance("joint_compliance", {"joint": 2}))
    model = model.with_values(dict.fromkeys(model.parameters, 2e-6))
    model.save(tmp_path / "model.toml")
    again = load_model(tmp_path / "model.toml")
    assert again.parameters == model.parameters
    q, w = samples(model.robot, 5, 1)
    np.testing.assert_array_equal(again.deflection(q, w), model.deflection(q, w))


@pytest.mark.parametrize("identifier", catalogue())
def test_a_model_with_any_effect_reads_back_the_same(identifier: str, tmp_path: Path) -> None:
    robot = load("kuka_kr270")
    effect = find(identifier)
    place = {**(effect.places(robot) or ({"rows": ["p4", "a pose"]},))[0]}
    lists = {k: list(v) if isinstance(v, list | tuple) else v for k, v in place.items()}
    for shape in effect.shapes(robot, place, Scales(context={"time": 60.0}))[:1]:
        model = joints_only(robot, "gravity").with_effect(EffectInstance(identifier, lists, dict(shape)))
        model = model.with_values(
            dict.fromkeys(model.parameters, 1e-7), dict.fromkeys(model.parameters, 1e-9)
        )
        model.save(tmp_path / "model.toml")
        again = load_model(tmp_path / "model.toml")
        assert again == model
        assert again.parameters == model.parameters


def test_a_deviation_of_a_compliance_that_an_effect_replaced_does_not_spoil_the_file(tmp_path: Path) -> None:
    model = joints_only(KR270, "gravity")
    model = model.with_values(model.values, dict.fromkeys(model.parameters, 1e-9))
    angles = EffectInstance("gravity_compensator", {"joint": 2}, {"angle_1": -1.0, "angle_2": 0.0})
    grown = model.with_effect(angles)
    assert "c2" not in grown.parameters
    grown.save(tmp_path / "model.toml")
    assert load_model(tmp_path / "model.toml").deviations == {
        n: 1e-9 for n in grown.parameters if n[0] == "c"
    }


def test_observation_times_values_is_the_deflection_and_any_number_of_poses_will_do() -> None:
    model = small()
    q, w = samples(model.robot, 7, 3)
    A = model.observation(q, w)
    assert A.shape == (7, 6, len(model.parameters))
    np.testing.assert_allclose(A @ model.vector(), model.deflection(q, w), atol=1e-20)
    np.testing.assert_array_equal(model.observation(q[:1], w)[0], A[0])


def test_the_structure_hash_depends_on_everything_but_values_and_words() -> None:
    model = small()
    assert model.with_values({}).structure_hash == model.structure_hash
    table = to_table(model.robot)
    table["title"], table["source"] = "another", "elsewhere"
    assert StiffnessModel.of(reduce(from_table(table), "wrench")).structure_hash == model.structure_hash
    table["joint"][0] |= {"limits": [-1.0, 2.0], "compliance": 3e-7}
    table["joint"][0].setdefault("link", {})["compliance"] = {"66": 2e-8}
    assert StiffnessModel.of(reduce(from_table(table), "wrench")).structure_hash == model.structure_hash
    heavier = to_table(model.robot)
    heavier["joint"][0].setdefault("link", {})["mass"] = 3.0  # laws act under the weight
    assert StiffnessModel.of(reduce(from_table(heavier), "wrench")).structure_hash != model.structure_hash
    table["joint"][0]["a"] = 0.9
    assert StiffnessModel.of(reduce(from_table(table), "wrench")).structure_hash != model.structure_hash


@pytest.mark.parametrize("change", [{"loads": "force"}, {"measure": "position"}, {"fixed": {1: 0.5}}])
def test_what_a_model_was_reduced_for_counts_in_its_structure_hash(change: dict[str, Any]) -> None:
    model = small()
    assert replace(model, **change).structure_hash != model.structure_hash


def test_the_stroke_of_a_slide_is_a_length_of_the_arm_and_counts_in_the_structure_hash() -> None:
    """An arm without masses may weigh what its law says, along its stroke too: other limits are another law."""
    table = to_table(load("scara"))
    hashes = set()
    for joint, limits in ((3, [-0.1, 0.0]), (3, [-0.3, 0.0]), (1, [-1.0, 1.0]), (1, [-2.0, 2.0])):
        changed = copy.deepcopy(table)
        changed["joint"][joint - 1]["limits"] = limits
        hashes.add(StiffnessModel.of(reduce(from_table(changed), "gravity")).structure_hash)
    assert len(hashes) == 3


@pytest.mark.parametrize("place", ["missing/model.toml", "file/model.toml", ""])
def test_a_place_that_cannot_be_written_is_a_users_mistake(place: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot write"):
        small().save(tmp_path / place)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: Any) -> None:
    model = small()
    model.save(tmp_path / "model.toml")
    before = (tmp_path / "model.toml").read_bytes()

    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(UserError, match="No space left on device"):
        model.with_values({}).save(tmp_path / "model.toml")
    assert [p.name for p in tmp_path.iterdir()] == ["model.toml"]
    assert (tmp_path / "model.toml").read_bytes() == before


# --- spoilt files ----------------------------------------------------------------------------------------


def test_the_joints_only_model_under_gravity_has_the_seeds_five_parameters() -> None:
    """Joint 1 does not move a vertical load (seed Table 2, J1)."""
    assert joints_only(KR270, loads="gravity").parameters == ("c2", "c3", "c4", "c5", "c6")
    assert joints_only(KR270).parameters == ("c1", "c2", "c3", "c4", "c5", "c6")


def joint_deflection(robot: Any, q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Σ J_j c_j J_jᵀ W over the joints, by the definition."""
    J = jacobians(robot, q)
    joints = [places(robot).index(("joint", j, 0)) for j in range(1, robot.dof + 1)]
    compliances = np.array([joint.compliance for joint in robot.joint])
    return np.einsum("nrj,j,nsj,ns->nr", J[:, :, joints], compliances, J[:, :, joints], w)


@pytest.mark.parametrize("name", ["kuka_kr270", "kuka_kr240", "scara"])
@pytest.mark.parametrize("loads", ["gravity", "wrench"])
def test_the_files_joint_compliances_deflect_the_complete_and_the_joints_only_model_alike(
    name: str, loads: str
) -> None:
    table = to_table(load(name))
    for k, row in enumerate(table["joint"]):
        row["compliance"] = 1e-6 * (k + 1)
        row["link"].pop("compliance", None)
    robot = from_table(table)
    q, w = samples(robot, 4, 2, loads)
    expected = joint_deflection(robot, q, w)
    for model in (joints_only(robot, loads), StiffnessModel.of(reduce(robot, loads))):
        np.testing.assert_allclose(model.deflection(q, w), expected, atol=1e-17)


def test_a_joint_oblique_to_a_link_with_all_terms_keeps_its_known_compliance() -> None:
    table = to_table(load("scara"))
    for row in table["joint"]:
        row["compliance"] = 1e-6
        row["link"] |= {"template": "full", "beam_axis": [1, 2, 3]}
    table["base"]["link"] = {"template": "full", "beam_axis": [1, 0, -1]}
    robot = from_table(table)
    q, w = samples(robot, 3, 2)
    model = StiffnessModel.of(reduce(robot))
    np.testing.assert_allclose(model.deflection(q, w), joint_deflection(robot, q, w), atol=1e-16)


def test_two_sliding_joints_in_line_add_their_known_compliances() -> None:
    """Where the class cannot tell two joints apart the kept one stands for both."""
    slide = {"type": "prismatic", "a": 0, "alpha": 0, "d": 0, "link": {"template": "rigid"}}
    table = {
        "format": 1,
        "name": "slides",
        "base": {"link": {"template": "rigid"}},
        "joint": [{**slide, "compliance": 1e-6}, {**slide, "compliance": 2e-6}],
    }
    model = joints_only(from_table(table))
    assert len(model.parameters) == 1
    assert model.vector() == pytest.approx([3e-6])


def test_known_link_entries_enter_the_model() -> None:
    table = to_table(KR270)
    table["joint"][1]["link"]["compliance"] = {"66": 3e-8, "26": 1e-8}
    robot = from_table(table)
    reduction = reduce(robot)
    known = known_values(reduction)
    full = {"k2_66": 3e-8, "k2_26": 1e-8}
    before = known_values(reduce(KR270))
    added = reduction.reduced_values(full)
    assert {n: known[n] - before[n] for n in known} == pytest.approx(added, abs=1e-18)


def test_a_length_that_is_all_but_nothing_is_saved_and_read_again(tmp_path):
    table = to_table(load("planar2r"))
    table["joint"][0]["d"] = 1e-200
    StiffnessModel.of(reduce(from_table(table, "small"))).save(tmp_path / "model.toml")
    assert float(load_model(tmp_path / "model.toml").robot.joint[0].d) == pytest.approx(1e-200, rel=1e-12)
