"""Poses that decide between rivals, against least squares on the deflections that the grown models predict."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import look
from symstiff.calibration.planning import Box, Region
from symstiff.calibration.tables.measurements import Measurements, concatenate
from symstiff.discrepancy.apart.deciding import (
    Choice,
    Rival,
    Setup,
    _hypotheses,
    _of_another_file,
    _on_offer,
    decide_by,
    decide_poses,
    names_of,
    setups_like,
)
from symstiff.discrepancy.bridge.candidates import scales_of
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel, joints_only
from symstiff.robot import Robot, from_table, load
from symstiff.robot.table import to_table
from symstiff.symbolic.numeric import forward
from tests.diagnosis_data import ROBOT, measured

LOADS = np.array([[60.0, 30.0, -50.0, 0.0, 0.0, 0.0], [0.0, 0.0, -90.0, 0.0, 0.0, 0.0]])
AXES = (0, 2, 5)
SIGMA = np.array([1e-5, 1e-5, 2e-5, 3e-5, 3e-5, 4e-5])


def stiff() -> StiffnessModel:
    model = joints_only(load(ROBOT))
    return model.with_values(dict.fromkeys(model.parameters, 2e-6))


def rival(effect: str, size: float, shape: dict[str, float] | None = None, **where: int) -> Rival:
    instance = EffectInstance(effect, where, shape or {})
    own = [p.name for p in instance.realise(load(ROBOT)).parameters]
    return Rival((instance,), {n: size * (k + 1) for k, n in enumerate(own)})


def offered_like(kind: str = "deflection") -> Setup:
    return Setup(kind, ("tcp",), AXES, LOADS)


def test_what_rivals_have_in_common_is_held_once() -> None:
    """Each of its copies, and products of all of them at every pose on offer, took gigabytes."""
    model, table = stiff(), measured(poses=6)
    base = rival("base_compliance", 1e-8, link=0).effects[0]
    gears = [rival("nonlinear_stiffness", 1e-7, joint=j).effects[0] for j in (1, 2)]
    found = _hypotheses(model, [Rival((base, gear), {}) for gear in gears], table, SIGMA)
    blocks = [block for of_rival in found.blocks for block in of_rival]
    shared = set(blocks[0].tolist()) & set(blocks[-1].tolist())
    assert len(shared) == found.laws.shape[1] - sum(len(set(b.tolist()) - shared) for b in blocks) > 1
    assert all(shared <= set(block.tolist()) for block in blocks)


def columns(model: StiffnessModel, instance: EffectInstance, table: Measurements) -> np.ndarray:
    """(rows, own parameters) what a unit of each parameter that an effect adds does to the readings."""
    grown = model.with_effect(instance)
    own = [n for n in grown.parameters if n not in model.parameters]
    zero = dict.fromkeys(grown.parameters, 0.0)
    units = [grown.deflection(table.q, table.w, values=zero | {n: 1.0}) for n in own]
    return weighed(np.stack(units, axis=-1))


def weighed(full: np.ndarray) -> np.ndarray:
    return (full[:, AXES] / SIGMA[list(AXES), None]).reshape(-1, full.shape[-1])


def placements(robot: Robot, q: np.ndarray) -> np.ndarray:
    """(rows, 6) shifts and small turns of everything that is seen, about the base."""
    moves = np.tile(np.eye(6), (len(q), 1, 1))
    for k, axis in enumerate(np.eye(3)):
        moves[:, :3, 3 + k] = np.cross(axis, forward(robot, q)[:, :3, 3])
    return weighed(moves)


def apart(
    model: StiffnessModel, rivals: list[Rival], table: Measurements, placed: bool = False, bends: bool = False
) -> float:
    """The smallest squared distance of a rival's signal from what the model and another rival can fit.

    placed: the device may stand elsewhere; bends: a rival may take every shape that its law has for this table.
    """
    A = weighed(model.observation(table.q, table.w))
    if placed:
        A = np.hstack([A, placements(model.robot, table.q)])
    found = []
    for one, other in permutations(rivals, 2):
        signal = columns(model, one.effects[0], table) @ np.array(list(one.values.values()))
        theirs = other.effects[0]
        entry, scales = find(theirs.effect), scales_of(look(model.robot, table))
        for shape in (theirs.shape, *(entry.shapes(model.robot, theirs.where, scales) if bends else ())):
            X = np.hstack([A, columns(model, replace(theirs, shape=dict(shape)), table)])
            X = X / np.maximum(np.linalg.norm(X, axis=0), 1e-300)
            left = signal - X @ np.linalg.lstsq(X, signal, rcond=1e-10)[0]
            found.append(float(left @ left))
    return min(found)


def as_read(table: Measurements) -> Measurements:
    values = np.full((len(table), 6), np.nan)
    values[:, AXES] = 0.0
    return replace(table, kind="deflection", values=values)


LINKS = [rival("link_compliance", 1e-6, link=k) for k in (1, 2)]


@pytest.mark.parametrize("kind", ["deflection", "absolute"])
def test_the_separation_is_what_least_squares_leaves_of_the_predicted_deflections(kind: str) -> None:
    """Of positions a part passes for the device standing elsewhere."""
    model = stiff()
    table, best = decide_poses(model, LINKS, offered_like(kind), SIGMA, Choice(4))
    assert best.separation[-1] > 5.0
    assert best.separation[-1] == pytest.approx(apart(model, LINKS, table, kind == "absolute"), rel=1e-5)


def test_data_already_taken_count_and_their_labels_stay_theirs() -> None:
    model = stiff()
    had = as_read(decide_poses(model, LINKS, offered_like(), SIGMA, Choice(3))[0])
    table, best = decide_poses(model, LINKS, offered_like(), SIGMA, Choice(2), had)
    assert table.labels == ("decide4", "decide5")
    both = concatenate([had, as_read(table)])
    assert best.separation[-1] == pytest.approx(apart(model, LINKS, both), rel=1e-5)


def test_a_rival_may_fit_with_every_shape_of_its_law() -> None:
    model, all_of_them = stiff(), Choice(8, 8, offered=8)
    gears = [rival("backlash", 2e-3, {"width": width}, joint=1) for width in (16.0, 80.0)]
    table, best = decide_poses(model, gears, offered_like(), SIGMA, all_of_them)
    assert len(table.labels) == 8
    bent = apart(model, gears, as_read(table), bends=True)
    assert best.separation[-1] == pytest.approx(bent, rel=1e-5)
    assert bent < 0.9 * apart(model, gears, as_read(table))


def test_what_the_model_has_already_is_no_rivals_own() -> None:
    instance = EffectInstance("link_compliance", {"link": 1})
    entries = [p.name for p in instance.realise(load(ROBOT)).parameters]
    model = joints_only(load(ROBOT)).with_effect(instance)
    names = names_of(model, Rival((instance, LINKS[1].effects[0]), {}))
    assert not set(names) & set(entries)
    assert set(names) == set(names_of(model, LINKS[1]))


def test_deciding_poses_keep_the_region_and_another_seed_offers_others() -> None:
    wall = Region((Box((0.3, -9.0, -9.0), (9.0, 9.0, 9.0)),))
    table, _ = decide_poses(stiff(), LINKS, offered_like(), SIGMA, Choice(4, 4, region=wall, offered=40))
    assert np.all(forward(load(ROBOT), table.q)[:, 0, 3] <= 0.3)
    one, two = (
        decide_poses(stiff(), LINKS, offered_like(), SIGMA, Choice(2, seed=seed, offered=20))[0]
        for seed in (0, 1)
    )
    assert not np.array_equal(one.q, two.q)


def test_deciding_poses_have_few_digits_where_the_limits_leave_room_for_them() -> None:
    raw = to_table(load(ROBOT))
    raw["joint"][0]["limits"] = [0.1001, 0.1008]  # between 5.7 and 5.8 degrees
    robot = from_table(raw)
    model = joints_only(robot)
    model = model.with_values(dict.fromkeys(model.parameters, 2e-6))
    table, _ = decide_poses(model, LINKS, offered_like(), SIGMA, Choice(4, 4, offered=40))
    assert np.all((table.q[:, 0] >= 0.1001) & (table.q[:, 0] <= 0.1008))
    tenths = 10 * np.degrees(table.q[:, 1])
    np.testing.assert_allclose(tenths, np.round(tenths), atol=1e-9)


def test_an_experiment_is_told_from_the_richest_pose_and_goes_both_ways_if_the_data_do() -> None:
    table = measured(poses=4, levels=(0.15, 1.0))
    few = table.select(np.flatnonzero((table.pose != 2) & (np.arange(len(table)) % 6 > 2)))
    (found,) = setups_like(concatenate([few, table.select(np.flatnonzero(table.pose == 2))]))
    rich = np.unique(np.round(table.w[table.pose == 2], 9), axis=0)
    assert {tuple(w) for w in rich} <= {tuple(w) for w in found.loads}
    up = np.ones(len(table))
    for branch, both in ((up, False), (-up, False), (np.where(np.arange(len(up)) % 2, 1.0, -1.0), True)):
        ways = setups_like(replace(table, branch=branch))[0].branches
        assert (ways == (1.0, -1.0)) is both
        assert both or np.isnan(ways).all()


def test_loads_in_another_direction_of_the_data_are_tried_where_the_first_do_not_decide() -> None:
    """A force along z bends the links and turns no joint of an arm whose axes are along z."""
    model = stiff()
    along = np.array([[0.0, 0.0, -90.0, 0.0, 0.0, 0.0], [0.0, 0.0, -45.0, 0.0, 0.0, 0.0]])
    gears = [rival("backlash", 1e-4, joint=j) for j in (1, 2)]
    blind, sees = (replace(offered_like(), loads=loads) for loads in (along, along[:, [2, 0, 1, 3, 4, 5]]))
    taken, _ = decide_poses(model, LINKS, offered_like(), SIGMA, Choice(2, 2, offered=20))
    taken = replace(taken, kind="deflection", values=np.zeros_like(taken.values))
    for order in ([blind, sees], [sees, blind]):
        setup, table, found = decide_by(
            order, model, gears, SIGMA, Choice(3, 1, enough=1e9, offered=40), taken
        )
        assert setup is sees
        assert np.ptp(table.w[:, 0]) > 0
        assert found.separation


def test_the_loads_that_are_tried_do_not_depend_on_the_order_of_poses() -> None:
    table = measured(poses=5)
    relabelled = replace(table, pose=table.pose.max() - table.pose, labels=table.labels[::-1])
    one, other = setups_like(table), setups_like(relabelled)
    assert len(one) == len(other) == 3
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.loads, b.loads)
    largest = [e.loads[np.argmax(np.linalg.norm(e.loads, axis=1))] for e in one]
    for a, b in permutations(largest, 2):
        assert abs(a @ b) < 0.9 * np.linalg.norm(a) * np.linalg.norm(b)


def test_positions_to_be_measured_are_of_a_place_of_the_device_that_is_found_anew() -> None:
    """They will be a file of their own."""
    setup = Setup("absolute", ("tcp",), (0, 1, 2), LOADS)
    first, offered = (
        _of_another_file(stiff(), _on_offer(stiff(), setup, Choice(2, offered=20, seed=s))) for s in (0, 1)
    )
    table = concatenate([replace(first, files=("data.csv",)), offered])
    assert np.array_equal(table.station, np.repeat([0, 1], len(offered)))
    away, _ = decide_poses(
        stiff(), LINKS, setup, SIGMA, Choice(2, offered=20), replace(first, files=("data.csv",))
    )
    assert away.kind == "none"
    assert not np.isfinite(away.values).any()
