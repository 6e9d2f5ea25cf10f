"""Deciding poses on made-up columns, against plain least squares."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise, permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symstiff.calibration.tables.table import write_table
from symstiff.calibration.tables.writing import LOADS
from symstiff.discrepancy.apart.deciding import decide_poses
from symstiff.discrepancy.apart.separate import Wish, separate
from symstiff.discrepancy.apart.separation import Decider, Hypotheses, deciding_poses
from symstiff.effects.instance import EffectInstance
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.robot import load

SIGMA = 0.1


def hypotheses(model: np.ndarray, signals: np.ndarray, blocks: Sequence[Sequence[np.ndarray]]) -> Hypotheses:
    """Every block with columns of its own."""
    ends = iter(np.cumsum([0, *(b.shape[1] for rival in blocks for b in rival)]).tolist())
    numbers = tuple(tuple(next(ends) + np.arange(b.shape[1]) for b in rival) for rival in blocks)
    return Hypotheses(model, signals, np.hstack([b for rival in blocks for b in rival]), numbers)


def made_up(seed: int, shapes: int = 1) -> tuple[Hypotheses, np.ndarray]:
    """Eight poses of five rows, a model of three columns, three rivals of one or two columns."""
    rng = np.random.default_rng(seed)
    pose = np.repeat(np.arange(8), 5)
    widths = (1, 2, 1)
    blocks = tuple(tuple(rng.normal(size=(40, k)) for _ in range(shapes)) for k in widths)
    signals = np.stack([b[0] @ rng.normal(size=b[0].shape[1]) for b in blocks], axis=1)
    return hypotheses(rng.normal(size=(40, 3)), signals, blocks), pose


def by_least_squares(columns: Hypotheses) -> float:
    """Smallest squared distance, over pairs and shapes, of a signal from what model and rival can fit."""
    found = []
    for i, j in permutations(range(columns.signals.shape[1]), 2):
        for block in columns.blocks[j]:
            X = np.hstack([columns.model, columns.laws[:, block]])
            signal = columns.signals[:, i]
            left = signal - X @ np.linalg.lstsq(X, signal, rcond=None)[0]
            found.append(float(left @ left) / SIGMA**2)
    return min(found)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 3))
def test_separation_is_what_least_squares_leaves_on_the_chosen_poses(seed: int, shapes: int) -> None:
    columns, pose = made_up(seed, shapes)
    columns = replace(columns, signals=1e3 * columns.signals)  # none is hopeless
    chosen = deciding_poses(columns, pose, SIGMA, 4)
    for k in range(2, 5):
        expected = by_least_squares(columns.rows(np.isin(pose, chosen.poses[:k])))
        assert chosen.separation[k - 1] == pytest.approx(expected, rel=1e-5, abs=1e-6)
    assert all(b >= a * (1 - 1e-9) for a, b in pairwise(chosen.separation))


def test_data_already_taken_count() -> None:
    columns, pose = made_up(1)
    old = np.isin(pose, (0, 1, 2))
    have, offered = columns.rows(old), columns.rows(~old)
    chosen = deciding_poses(offered, pose[~old], SIGMA, 2, have)
    assert not set(chosen.poses) & {0, 1, 2}
    expected = by_least_squares(columns.rows(old | np.isin(pose, chosen.poses)))
    assert chosen.separation[-1] == pytest.approx(expected, rel=1e-6)


def test_a_rival_that_may_change_its_shape_is_harder_to_tell_apart() -> None:
    columns, pose = made_up(2, shapes=3)
    rigid = columns.of(tuple(b[:1] for b in columns.blocks))
    soft = deciding_poses(columns, pose, SIGMA, 8).separation[-1]
    assert soft < deciding_poses(rigid, pose, SIGMA, 8).separation[-1]


def test_the_choice_ends_where_it_is_ample() -> None:
    columns, pose = made_up(3)
    every = deciding_poses(columns, pose, SIGMA, 8)
    enough = every.separation[4] - 1e-9
    assert deciding_poses(columns, pose, SIGMA, 8, enough=enough).poses == every.poses[:5]
    assert len(deciding_poses(columns, pose, SIGMA, 8, enough=enough, least=7).poses) == 7


def test_an_explanation_that_holds_another_is_told_apart_one_way_only() -> None:
    columns, pose = made_up(4)
    one, other = (columns.laws[:, columns.blocks[k][0]] for k in (0, 1))
    two = np.hstack([one, other])
    nested = hypotheses(columns.model, np.stack([one[:, 0], two.sum(axis=1)], axis=1), ((one,), (two,)))
    chosen = deciding_poses(nested, pose, SIGMA, 3)
    assert chosen.separation[-1] > 10


def test_equal_explanations_have_no_deciding_pose() -> None:
    columns, pose = made_up(5)
    one = columns.laws[:, columns.blocks[0][0]]
    same = hypotheses(columns.model, np.hstack([one, 2 * one]), ((one,), (one,)))
    assert deciding_poses(same, pose, SIGMA, 3) == Decider((), ())


def told(robot: str, **changed: object) -> dict[str, object]:
    """A verdict between two gears, on data with two markers, two loads and a small noise."""
    effects = [
        {
            "effect": "hysteresis",
            "where": {"joint": j},
            "set": j,
            "parameters": {f"hysteresis_{j}_width": {"value": 2e-4}},
        }
        for j in (1, 2)
    ]
    load = dict.fromkeys(LOADS, 0.0)
    decide = {
        "kind": "deflection", "components": [0, 1, 2], "points": ["p1", "p2"], "branches": ["up", "down"],
        "loads": [{**load, "fz[N]": -90.0}, {**load, "fx[N]": 40.0}], "poses": [],
    }  # fmt: skip
    return {
        "robot": robot, "effects": effects, "decide": decide, "noise": {"sigma_mm": 0.03, "approach_mm": 0.04},
        "model": {"loads": "force", "measure": "position", "values": {}},
    } | changed  # fmt: skip


def test_poses_for_a_robot_that_slides_are_in_its_units_and_have_labels_of_their_own(tmp_path: Path) -> None:
    verdict = tmp_path / "verdict.json"
    decide = {"poses": [{"pose": "decide1"}, {"pose": "decide2"}]}
    rivals = told("scara")["effects"]
    verdict.write_text(json.dumps({"robot": "scara", "effects": rivals, "decide": decide}))
    robot = load("scara")
    table, found, *_ = separate(robot, verdict, Wish(3, "force", "position", 100.0))
    assert len(found.poses) == 3
    assert table.joint_units == ("rad", "rad", "m", "rad")
    assert table.labels == ("decide3", "decide4", "decide5")
    write_table(table, tmp_path / "p.csv", "deg")
    assert "q3[m]" in (tmp_path / "p.csv").read_text().splitlines()[0]
    low, high = robot.joint[2].range
    assert np.all((table.q[:, 2] >= float(low)) & (table.q[:, 2] <= float(high)))
    np.testing.assert_allclose(1e4 * table.q[:, 2], np.round(1e4 * table.q[:, 2]), atol=1e-9)


def test_poses_for_a_verdict_are_measured_as_its_data_were_unless_something_else_is_wished(
    tmp_path: Path,
) -> None:
    verdict = tmp_path / "verdict.json"
    verdict.write_text(json.dumps(told("ur10")))
    table, _, _, means = separate(load("ur10"), verdict, Wish(2))
    assert table.points == ("p1", "p2")
    assert {tuple(w) for w in table.w} == {(0, 0, -90, 0, 0, 0), (40, 0, 0, 0, 0, 0)}
    assert set(table.branch) == {1.0, -1.0}
    np.testing.assert_allclose(means.sigma[:3], 5e-5, rtol=1e-12)
    assert (means.loads, means.measure) == ("force", "position")
    table, _, _, means = separate(load("ur10"), verdict, Wish(2, force=20.0, markers=("p3",), sigma=1e-5))
    assert table.points == ("p3",)
    assert np.abs(table.w).max() == 20.0
    assert not table.w[:, 3:].any()
    np.testing.assert_allclose(means.sigma[:3], 1e-5, rtol=1e-12)


def test_a_verdict_without_the_poses_that_decide_is_enough(tmp_path: Path) -> None:
    verdict = tmp_path / "verdict.json"
    verdict.write_text(json.dumps(told("planar2r", decide=None)))
    assert len(separate(load("planar2r"), verdict, Wish(2, "force", "position", 100.0))[1].poses) == 2


def test_what_the_start_model_holds_is_in_the_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a verdict from a grown model, whose file may be elsewhere by now."""
    verdict, seen = tmp_path / "verdict.json", []
    held = {"effect": "backlash", "where": {"joint": 2}, "shape": {"width": 3.0}}
    values = {"c1": 2e-6, "backlash_2_gap": 1e-3}
    model = {"loads": "force", "measure": "position", "values": values, "effects": [held]}
    verdict.write_text(json.dumps(told("planar2r", model=model, start="gone/model.toml")))

    def watched(model: StiffnessModel, *others: Any) -> Any:
        seen.append(model)
        return decide_poses(model, *others)

    monkeypatch.setattr("symstiff.discrepancy.apart.separate.decide_poses", watched)
    separate(load("planar2r"), verdict, Wish(2))
    assert dict(seen[0].values) == values
    assert seen[0].effects == (EffectInstance("backlash", {"joint": 2}, {"width": 3.0}),)


@pytest.mark.parametrize(
    ("changed", "clue"),
    [
        ({"decide": {"components": [0, 1, 2]}}, "do not tell an experiment"),
        ({"noise": {"sigma_mm": "much"}}, "do not tell an experiment"),
        ({"decide": "x"}, "decide is no table"),
        ({"model": [1]}, "model is no table"),
        ({"decide": {"components": [9]}}, "decide.components"),
        ({"decide": {"components": []}}, "decide.components"),
        ({"decide": {"points": []}}, "decide.points"),
        ({"decide": {"loads": "x"}}, "decide.loads is no list"),
        ({"decide": {"kind": None}}, "decide.kind"),
        ({"noise": {"sigma_mm": float("nan")}}, "do not tell an experiment"),
        ({"model": {"effects": [3]}}, "its effects or its model are not"),
        ({"model": {"loads": "all"}}, "use gravity, force or wrench"),
        (
            {"verdict": "nothing_missing", "effects": []},
            "nothing to decide between: the verdict is nothing_missing",
        ),
    ],
)
def test_a_verdict_that_tells_no_experiment_is_refused(tmp_path: Path, changed: dict, clue: str) -> None:
    verdict = tmp_path / "verdict.json"
    verdict.write_text(json.dumps(told("ur10", **changed)))
    with pytest.raises(UserError, match=clue):
        separate(load("ur10"), verdict, Wish(2))
