"""Poses that decide among the explanations of an ambiguous verdict, from its verdict.json alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from symstiff.calibration.measurements import Measurements
from symstiff.discrepancy.deciding import Experiment, Rival, decide_poses, several_levels
from symstiff.discrepancy.design import Decider
from symstiff.discrepancy.problem import Array
from symstiff.discrepancy.speech import named
from symstiff.effects.base import EffectInstance, Scales, find
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.reduction.physical import physical_stages
from symstiff.robot.schema import Robot

_LEVER = 0.5
"""Moment of a wrench for each newton of its force [m]."""


@dataclass(frozen=True)
class Wish:
    """What the plan may use: poses, class of loads and measurement, force [N], markers, noise [m], seed."""

    poses: int
    loads: str = "wrench"
    measure: str = "pose"
    force: float = 1000.0
    markers: tuple[str, ...] = ()
    sigma: float = 30e-6
    seed: int = 0


def separate(robot: Robot, verdict: Path, wish: Wish) -> tuple[Measurements, Decider, list[str]]:
    """The deciding poses with their loads, how far they separate, and the explanations in words.

    Raises UserError for a file that is no verdict of this robot, or that holds fewer than two explanations.
    """
    table = _read(verdict)
    if table.get("robot", robot.name) != robot.name:
        raise UserError(f"{verdict} is a verdict on {table['robot']}, not on {robot.name}")
    rivals = _rivals(robot, table, str(verdict))
    if wish.poses < 1:
        raise UserError(f"--poses {wish.poses}: 1 or more")
    model = _model(robot, table, wish)
    chosen, found = decide_poses(
        model,
        rivals,
        _experiment(rivals, wish),
        wish.sigma,
        wish.poses,
        wish.seed,
        offered=max(300, 4 * wish.poses),
    )
    return chosen, found, [" with ".join(named(e.effect, e.where) for e in r.effects) for r in rivals]


def _read(path: Path) -> Mapping[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: cannot read the verdict: {error.strerror}") from error
    except ValueError as error:
        raise UserError(f"{path}: not a verdict.json: {error}") from error
    if not isinstance(table, dict) or not isinstance(table.get("effects"), list):
        raise UserError(f"{path}: not a verdict.json: it has no list of effects")
    return table


def _rivals(robot: Robot, table: Mapping[str, Any], origin: str) -> list[Rival]:
    """One explanation a set; entries without a set are one each."""
    sets: dict[Any, list[Mapping[str, Any]]] = {}
    for k, entry in enumerate(table["effects"]):
        if not isinstance(entry, dict) or not isinstance(entry.get("effect"), str):
            raise UserError(f"{origin}: effects: entry {k + 1} has no effect")
        sets.setdefault(entry.get("set", ("alone", k)), []).append(entry)
    if len(sets) < 2:
        raise UserError(
            f"{origin}: {len(sets)} explanation(s): only an ambiguous verdict needs poses that decide"
        )
    return [_rival(robot, entries) for entries in sets.values()]


def _rival(robot: Robot, entries: list[Mapping[str, Any]]) -> Rival:
    instances, values = [], {}
    for entry in entries:
        where = dict(entry.get("where", {}))
        shape = entry.get("shape") or next(iter(find(entry["effect"]).shapes(robot, where, Scales())), {})
        instance = EffectInstance(entry["effect"], where, dict(shape))
        given = entry.get("parameters", {})
        for p in instance.realise(robot).parameters:
            value = given.get(p.name, {}).get("value")
            values[p.name] = p.typical if value is None else float(value)
        instances.append(instance)
    return Rival(tuple(instances), values)


def _model(robot: Robot, table: Mapping[str, Any], wish: Wish) -> StiffnessModel:
    """The model that the verdict started from, else the complete one for the class of experiment."""
    known = {p.name: p for stage in physical_stages(robot) for p in stage.parameters}
    values = {n: float(v or 0.0) for n, v in table.get("model", {}).get("values", {}).items() if n in known}
    if values:
        return StiffnessModel(robot, tuple(known[n] for n in values), wish.loads, wish.measure, (), values)
    return StiffnessModel.of(reduce(robot, wish.loads, wish.measure))


def _experiment(rivals: list[Rival], wish: Wish) -> Experiment:
    effects = [find(e.effect) for r in rivals for e in r.effects]
    absolute = all(e.seen_in == frozenset({"absolute"}) for e in effects)
    nan = float("nan")
    branches = (1.0, -1.0) if any("branch" in e.needs for e in effects) else (nan,)
    components = (0, 1, 2) if wish.markers or wish.measure == "position" else tuple(range(6))
    loads = np.zeros((1, 6)) if absolute else _loads(wish)
    return Experiment(
        "absolute" if absolute else "deflection", wish.markers or ("tcp",), components, loads, branches
    )


def _loads(wish: Wish) -> Array:
    """Load cases of every pose: down at two levels; sideways and as moments where the class allows them."""
    down = np.array([0.0, 0.0, -wish.force, 0.0, 0.0, 0.0])
    cases = [several_levels(down)]
    if wish.loads != "gravity":
        cases.append(wish.force * np.eye(6)[:2])
    if wish.loads == "wrench":
        cases.append(_LEVER * wish.force * np.eye(6)[3:])
    return np.vstack(cases)
