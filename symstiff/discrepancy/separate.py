"""Poses that decide among the explanations of an ambiguous verdict, from its verdict.json alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from symstiff.calibration.identify import ExperimentClass, start_model
from symstiff.calibration.measurements import Measurements
from symstiff.discrepancy.deciding import OFFERED, Choice, Experiment, Rival, decide_poses, several_levels
from symstiff.discrepancy.problem import Array
from symstiff.discrepancy.separation import Decider
from symstiff.discrepancy.speech import named
from symstiff.effects.base import EffectInstance, Scales, find
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction.physical import physical_stages
from symstiff.robot.schema import Robot

if TYPE_CHECKING:
    from symstiff.calibration.planning.region import Region

_LEVER = 0.5
"""Moment of a wrench for each newton of its force [m]."""
_TURN = 0.3
"""Distance over which the rotation of a measured body is read from its points [m]."""
TAKEN = "taken.csv"
"""File beside an ambiguous verdict.json: poses and loads of the data that it is about, without readings."""


@dataclass(frozen=True)
class Wish:
    """What the plan may use: poses, class of loads and measurement, force [N], markers, noise [m], region, seed."""

    poses: int
    loads: str = "wrench"
    measure: str = "pose"
    force: float = 1000.0
    markers: tuple[str, ...] = ()
    sigma: float = 30e-6
    seed: int = 0
    region: Region | None = None


def separate(
    robot: Robot, verdict: Path, wish: Wish, tell: Callable[[str], None] = lambda stage: None
) -> tuple[Measurements, Decider, list[str]]:
    """The deciding poses with their loads, how far they separate, and the explanations in words.

    Data that the verdict is about count, where ``taken.csv`` stands beside it. Raises UserError for a file that is
    no verdict of this robot, or that holds fewer than two explanations.
    """
    table = _read(verdict)
    if table.get("robot", robot.name) != robot.name:
        raise UserError(f"{verdict} is a verdict on {table['robot']}, not on {robot.name}")
    rivals = _rivals(robot, table, str(verdict))
    if wish.poses < 1:
        raise UserError(f"--poses {wish.poses}: 1 or more")
    tell("deciding poses: model")
    chosen, found = decide_poses(
        _model(robot, table, wish),
        rivals,
        _experiment(robot, rivals, wish),
        wish.sigma * np.array([1.0, 1.0, 1.0, 1 / _TURN, 1 / _TURN, 1 / _TURN]),
        Choice(
            wish.poses,
            seed=wish.seed,
            offered=max(OFFERED, 4 * wish.poses),
            region=wish.region,
            used=_labels(table),
        ),
        _taken(robot, table, verdict),
        tell,
    )
    return chosen, found, [" with ".join(named(e.effect, e.where) for e in r.effects) for r in rivals]


def _labels(table: Mapping[str, Any]) -> tuple[str, ...]:
    """Labels of the poses that the verdict itself proposes, which may be measured as well."""
    poses = (table.get("decide") or {}).get("poses") or []
    return tuple(str(p.get("pose", "")) for p in poses if isinstance(p, dict))


def _taken(robot: Robot, table: Mapping[str, Any], verdict: Path) -> Measurements | None:
    """Poses and loads of the data behind the verdict, marked as measured in the components that were."""
    from symstiff.calibration.table import check_robot, read_poses

    decide = table.get("decide", {})
    file = verdict.parent / TAKEN
    if "components" not in decide or not file.is_file():
        return None
    poses = read_poses(file)
    check_robot(poses, robot)
    values = np.full((len(poses), 6), np.nan)
    values[:, [int(c) for c in decide["components"]]] = 0.0
    return replace(poses, kind=decide.get("kind", "deflection"), values=values)


def _read(path: Path) -> Mapping[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: cannot read the verdict: {error.strerror}: check the path") from error
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
    """The model that the verdict started from, else the complete one, as the planned experiment needs it."""
    known = {p.name: p for stage in physical_stages(robot) for p in stage.parameters}
    values = {n: float(v or 0.0) for n, v in table.get("model", {}).get("values", {}).items() if n in known}
    start = table.get("start", "complete")
    if start in ("complete", "joints") or not values:
        experiment = ExperimentClass(wish.loads, wish.measure, {})
        model = start_model(robot, "joints" if start == "joints" else "complete", experiment)[0]
        return model.with_values({n: values.get(n, 0.0) for n in model.parameters})
    return StiffnessModel(robot, tuple(known[n] for n in values), wish.loads, wish.measure, (), values)


def _experiment(robot: Robot, rivals: list[Rival], wish: Wish) -> Experiment:
    effects = [find(e.effect) for r in rivals for e in r.effects]
    absolute = all(e.seen_in == frozenset({"absolute"}) for e in effects)
    nan = float("nan")
    branches = (1.0, -1.0) if any("branch" in e.needs for e in effects) else (nan,)
    components = (0, 1, 2) if wish.markers or wish.measure == "position" else tuple(range(6))
    loads = np.zeros((1, 6)) if absolute else _loads(wish)
    units = tuple("m" if j.prismatic else "rad" for j in robot.joint)
    kind = "absolute" if absolute else "deflection"
    return Experiment(kind, wish.markers or ("tcp",), components, loads, branches, units)


def _loads(wish: Wish) -> Array:
    """Load cases of every pose: down at two levels; sideways and as moments where the class allows them."""
    down = np.array([0.0, 0.0, -wish.force, 0.0, 0.0, 0.0])
    cases = [several_levels(down)]
    if wish.loads != "gravity":
        cases.append(wish.force * np.eye(6)[:2])
    if wish.loads == "wrench":
        cases.append(_LEVER * wish.force * np.eye(6)[3:])
    return np.vstack(cases)
