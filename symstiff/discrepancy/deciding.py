"""Poses and loads that would tell rival explanations apart: T-optimal choice over the joint range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.calibration.measurements import Measurements, measurements
from symstiff.discrepancy.design import Decider, deciding_poses
from symstiff.discrepancy.growth import columns_of
from symstiff.discrepancy.problem import Array
from symstiff.discrepancy.situation import Laws, Situation, has_weights, load_factor, look, under_weights
from symstiff.effects.base import EffectInstance
from symstiff.model import StiffnessModel

OFFERED = 300
"""Configurations over the joint limits from which the deciding ones are chosen."""
_WEAK = 0.5
"""Second load level, where the effects are to be told apart by several."""


@dataclass(frozen=True)
class Rival:
    """One explanation: its effects, and its parameters' values."""

    effects: tuple[EffectInstance, ...]
    values: Mapping[str, float]


@dataclass(frozen=True)
class Experiment:
    """How the next poses can be measured: markers, what is read, load cases of every pose (k, 6) [N, N·m]."""

    kind: str
    points: tuple[str, ...]
    components: tuple[int, ...]
    loads: Array
    branches: tuple[float, ...] = (float("nan"),)
    joint_units: tuple[str, ...] = ()


def experiment_like(table: Measurements) -> Experiment:
    """The experiment that a table came from: its markers, components, and the loads of its richest pose."""
    share = np.abs(load_factor(table))
    poses = np.unique(table.pose)
    rich = max(poses, key=lambda p: (len(np.unique(np.round(share[table.pose == p], 6))), -p))
    loads = np.unique(np.round(table.w[table.pose == rich], 9), axis=0)
    both = (table.branch > 0).any() and (table.branch < 0).any()
    return Experiment(
        table.kind, table.points, tuple(int(k) for k in np.flatnonzero(table.measured.any(axis=0))), loads,
        (1.0, -1.0) if both else (float("nan"),), table.joint_units,
    )  # fmt: skip


def decide_poses(
    model: StiffnessModel, rivals: Sequence[Rival], experiment: Experiment, sigma: float, count: int,
    seed: int = 0, have: tuple[Array, Sequence[Array]] | None = None, offered: int = OFFERED,
) -> tuple[Measurements, Decider]:  # fmt: skip
    """A table of ``count`` poses with their loads that tells the rivals apart, and how far it does.

    ``model`` has its fitted values; ``sigma`` the noise of a coordinate [m]; ``have`` the model's columns
    and the rivals' (as ``rival_columns`` gives them) on data already taken.
    """
    table = _on_offer(model, experiment, offered, seed)
    A, blocks = rival_columns(model, rivals, table)
    theta = [np.array([r.values.get(n, 0.0) for n in names_of(model, r)]) for r in rivals]
    state, _ = np.nonzero(table.measured)
    found = deciding_poses(A, blocks, theta, table.pose[state], sigma, count, have)
    rows = np.concatenate([np.flatnonzero(table.pose == p) for p in found.poses])
    chosen = table.select(rows)
    number = {p: k for k, p in enumerate(found.poses)}
    chosen = replace(
        chosen, kind="none", values=np.full((len(rows), 6), np.nan),
        labels=tuple(f"decide{k + 1}" for k in range(len(found.poses))),
        pose=np.array([number[int(p)] for p in chosen.pose], dtype=np.intp),
    )  # fmt: skip
    return chosen, found


def names_of(model: StiffnessModel, rival: Rival) -> list[str]:
    """Parameters that a rival adds to the model."""
    realised = [e.realise(model.robot) for e in rival.effects]
    names = dict.fromkeys(p.name for r in realised for p in r.parameters)
    return [n for n in names if n not in model.parameters]


def rival_columns(
    model: StiffnessModel, rivals: Sequence[Rival], table: Measurements
) -> tuple[Array, list[Array]]:
    """The model's columns on a table's measured rows, the device's placement included, and each rival's."""
    view = look(model.robot, table)
    if table.kind == "absolute" and has_weights(model.robot):
        view = under_weights(view)
    situation = Situation(view, Laws(view, model.terms, dict(model.values)))
    A = situation.columns(model.terms, list(model.parameters))
    if table.kind == "absolute":
        A = np.hstack([A, _placement(situation)])
    blocks = []
    for rival in rivals:
        parts, seen = [], set(model.parameters)
        for effect in rival.effects:
            own = [p.name for p in effect.realise(model.robot).parameters if p.name not in seen]
            seen |= set(own)
            parts.append(columns_of(situation, effect, own))
        blocks.append(np.hstack(parts))
    return A, blocks


def _placement(situation: Situation) -> Array:
    """(M, 6) shifts and turns of the device about the robot's base."""
    view = situation.view
    point = view.found.T[:, :3, 3] + view.offset
    twist = np.zeros((len(point), 6, 6))
    for k in range(3):
        twist[:, k, k] = 1.0
        twist[:, :3, 3 + k] = np.cross(np.eye(3)[k], point)
        twist[:, 3 + k, 3 + k] = 1.0
    return np.asarray(twist[view.state, view.component])


def _on_offer(model: StiffnessModel, experiment: Experiment, offered: int, seed: int) -> Measurements:
    """Configurations over the joint limits, each under every load case, branch and marker."""
    from symstiff.calibration.planning import Load, Space, geometry
    from symstiff.calibration.planning.candidates import draw

    q = draw(Space(geometry(model.robot), Load()), offered, seed).q
    cases = [
        (w, b, p)
        for w in experiment.loads
        for b in experiment.branches
        for p in range(len(experiment.points))
    ]
    values = np.full((len(cases), 6), np.nan)
    values[:, list(experiment.components)] = 0.0
    return measurements(
        np.repeat(q, len(cases), axis=0),
        np.tile(np.array([w for w, _, _ in cases]), (len(q), 1)),
        labels=[f"p{k}" for k in range(len(q))],
        pose=np.repeat(np.arange(len(q)), len(cases)),
        points=experiment.points,
        point=np.tile([p for _, _, p in cases], len(q)),
        kind="absolute" if experiment.kind == "absolute" else "deflection",
        values=np.tile(values, (len(q), 1)),
        branch=np.tile([b for _, b, _ in cases], len(q)),
        joint_units=experiment.joint_units or None,
    )


def several_levels(load: Array) -> Array:
    """A load and half of it: what tells laws that are not proportional to the load from those that are."""
    return np.stack([load, _WEAK * load])
