"""Poses that decide among the explanations of an ambiguous verdict, from its verdict.json alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.experiment.readings import ExperimentClass, read_at
from symstiff.calibration.identify import start_model
from symstiff.calibration.planning.loads import Load
from symstiff.calibration.planning.measurement import BASELINE, Measurement
from symstiff.calibration.tables.checks import check_robot
from symstiff.calibration.tables.measurements import Measurements
from symstiff.calibration.tables.writing import LOADS
from symstiff.discrepancy.apart.deciding import OFFERED, Choice, Rival, Setup, decide_poses, several_levels
from symstiff.discrepancy.apart.separation import Decider
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.places import named
from symstiff.effects.registry import find
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.reduction.physical import physical_stages
from symstiff.robot.schema import Robot

if TYPE_CHECKING:
    from symstiff.calibration.planning.region import Region

TAKEN = "taken.csv"
"""File beside an ambiguous verdict.json: poses and loads of the data that it is about, without readings."""


@dataclass(frozen=True)
class Wish:
    """What the plan may use: poses, class of loads and measurement, force [N], markers, noise [m], seed, region.

    What is None, and markers that are none, are those of the data that the verdict is about. Raises UserError for a
    number of poses, a load or a noise that none is.
    """

    poses: int
    loads: str | None = None
    measure: str | None = None
    force: float | None = None
    markers: tuple[str, ...] = ()
    sigma: float | None = None
    seed: int = 0
    region: Region | None = None

    def __post_init__(self) -> None:
        if self.poses < 1:
            raise UserError(f"poses: expected 1 or more, found {self.poses}")
        self.load()
        Measurement(sigma_t=Measurement.sigma_t if self.sigma is None else self.sigma)

    def load(self, loads: str = "wrench") -> Load:
        """The load that is wished, of a class where none is."""
        force = Load.force if self.force is None else self.force
        return Load(self.loads or loads, force)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Means:
    """What the next measurement is taken to be: classes of the model's reduction, setup, noise (6,) [m, rad]."""

    loads: str
    measure: str
    setup: Setup
    sigma: Array


def separate(
    robot: Robot, verdict: Path, wish: Wish, tell: Callable[[str], None] = lambda stage: None
) -> tuple[Measurements, Decider, list[str], Means]:
    """The deciding poses with their loads, how far they separate, the explanations in words, what was assumed.

    Data that the verdict is about count, where ``taken.csv`` stands beside it. Raises UserError for a file that is
    no verdict of this robot, or that holds fewer than two explanations.
    """
    table = _read(verdict)
    if table.get("robot", robot.name) != robot.name:
        raise UserError(f"{verdict} is a verdict on {table['robot']}, not on {robot.name}")
    try:
        rivals, values, effects = _rivals(robot, table, str(verdict)), _values(table), _effects(table)
        names = [" with ".join(named(e.effect, e.where) for e in r.effects) for r in rivals]
    except UserError:
        raise
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise UserError(
            f"{verdict}: not a verdict.json: its effects or its model are not as symstiff diagnose writes them"
        ) from error
    means = _means(robot, rivals, table, wish, str(verdict))
    tell("deciding poses: model")
    chosen, found = decide_poses(
        _model(robot, str(table.get("start", "complete")), values, effects, means),
        rivals,
        means.setup,
        means.sigma,
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
    return chosen, found, names, means


def _labels(table: Mapping[str, Any]) -> tuple[str, ...]:
    """Labels of the poses that the verdict itself proposes, which may be measured as well."""
    poses = table["decide"].get("poses")
    found = poses if isinstance(poses, list) else []
    return tuple(str(p.get("pose", "")) for p in found if isinstance(p, dict))


def _taken(robot: Robot, table: Mapping[str, Any], verdict: Path) -> Measurements | None:
    """Poses and loads of the data behind the verdict, marked as measured in the components that were."""
    from symstiff.calibration.tables.table import read_poses

    decide = table["decide"]
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
        raise UserError(f"{path}: not a verdict.json: no JSON: give the one that diagnose wrote") from error
    if not isinstance(table, dict) or not isinstance(table.get("effects"), list):
        raise UserError(f"{path}: not a verdict.json: it has no list of effects")
    parts = {name: table.get(name) or {} for name in ("decide", "model", "noise")}
    for name, part in parts.items():
        if not isinstance(part, dict):
            raise UserError(f"{path}: not a verdict.json: {name} is no table")
    _check_told(parts["decide"], path)
    return table | parts


def _check_told(decide: Mapping[str, Any], path: Path) -> None:
    """Raise UserError for parts of an experiment that none are, where it is told."""
    for name in ("components", "points", "loads"):
        if name in decide and not (isinstance(decide[name], list) and decide[name]):
            raise UserError(f"{path}: not a verdict.json: decide.{name} is no list of any")
    if not all(c in range(6) for c in decide.get("components", ())):
        raise UserError(f"{path}: not a verdict.json: decide.components are 0 to 5 each")
    if decide.get("kind", "deflection") not in ("deflection", "absolute"):
        raise UserError(f"{path}: not a verdict.json: decide.kind is deflection or absolute")


def _rivals(robot: Robot, table: Mapping[str, Any], origin: str) -> list[Rival]:
    """One explanation a set; entries without a set are one each."""
    sets: dict[Any, list[Mapping[str, Any]]] = {}
    for k, entry in enumerate(table["effects"]):
        if not isinstance(entry, dict) or not isinstance(entry.get("effect"), str):
            raise UserError(f"{origin}: effects: entry {k + 1} has no effect")
        sets.setdefault(entry.get("set", ("alone", k)), []).append(entry)
    if len(sets) < 2:
        verdict = table.get("verdict")
        told = f"the verdict is {verdict}" if isinstance(verdict, str) else f"it holds {len(sets)} of two"
        raise UserError(
            f"{origin}: nothing to decide between: {told}, and poses decide between two explanations"
        )
    try:
        return [_rival(robot, entries) for entries in sets.values()]
    except UserError as error:
        raise UserError(f"{origin}: {error}") from error


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


def _values(table: Mapping[str, Any]) -> dict[str, float]:
    """Values of the model that the verdict started from, by parameter name."""
    return {n: float(v or 0.0) for n, v in table["model"].get("values", {}).items()}


def _effects(table: Mapping[str, Any]) -> tuple[EffectInstance, ...]:
    """Effects of the model that the verdict started from."""
    entries = table["model"].get("effects", [])
    return tuple(EffectInstance(e["effect"], e["where"], e.get("shape", {})) for e in entries)


def _model(
    robot: Robot, start: str, told: Mapping[str, float], effects: tuple[EffectInstance, ...], means: Means
) -> StiffnessModel:
    """The model that the verdict started from, else the complete one, as the planned experiment needs it."""
    if start in ("complete", "joints") or not told:
        seen, points = read_at(robot, means.setup.points)
        points = points if seen == means.measure and max(means.setup.components) < 3 else ()
        experiment = ExperimentClass(means.loads, means.measure, {}, points)
        model = start_model(robot, "joints" if start == "joints" else "complete", experiment)[0]
    else:
        known = {p.name: p for stage in physical_stages(robot) for p in stage.parameters}
        elastic = tuple(known[n] for n in told if n in known)
        model = StiffnessModel(robot, elastic, means.loads, means.measure, effects)
    return model.with_values({n: told.get(n, 0.0) for n in model.parameters})


def _means(robot: Robot, rivals: list[Rival], table: Mapping[str, Any], wish: Wish, origin: str) -> Means:
    """As wished, else as in the data of the verdict, else poses under wrenches of 1 kN, read to 0.03 mm."""
    told, model = table["decide"], table["model"]
    loads = wish.loads or str(model.get("loads", "wrench"))
    measure = wish.measure or str(model.get("measure", "pose"))
    usual = _setup(robot, rivals, wish.load(loads), measure, wish.markers)
    try:
        setup = usual if "components" not in told else _as_told(usual, told, wish)
        sigma = _noise(table) if wish.sigma is None else wish.sigma
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{origin}: not a verdict.json: decide and noise do not tell an experiment"
        ) from error
    rotation = sigma if wish.sigma is None and min(setup.components) >= 3 else sigma / BASELINE
    return Means(loads, measure, setup, np.repeat([sigma, rotation], 3))


def _as_told(usual: Setup, told: Mapping[str, Any], wish: Wish) -> Setup:
    """The setup with what the verdict tells of its data, where nothing else was wished."""
    found = replace(usual, kind=str(told["kind"]))
    if not wish.markers:
        found = replace(found, points=tuple(str(p) for p in told["points"]))
    if not wish.markers and wish.measure is None:
        found = replace(found, components=tuple(int(c) for c in told["components"]))
    if wish.loads is None and wish.force is None:
        found = replace(found, loads=np.array([[float(w[h]) for h in LOADS] for w in told["loads"]]))
    if told["branches"]:
        found = replace(found, branches=tuple(1.0 if b == "up" else -1.0 for b in told["branches"]))
    return found


def _noise(table: Mapping[str, Any]) -> float:
    """Standard deviation of a reading as the diagnosis found it, with what a pose's rows share [m]."""
    noise = table["noise"]
    found = 1e-3 * float(np.hypot(noise.get("sigma_mm") or 0.0, noise.get("approach_mm") or 0.0))
    if not np.isfinite(found):
        raise ValueError("a noise that is no number")
    return found or Measurement.sigma_t


def _setup(robot: Robot, rivals: list[Rival], load: Load, measure: str, markers: tuple[str, ...]) -> Setup:
    effects = [find(e.effect) for r in rivals for e in r.effects]
    absolute = all(e.seen_in == frozenset({"absolute"}) for e in effects)
    nan = float("nan")
    branches = (1.0, -1.0) if any("branch" in e.needs for e in effects) else (nan,)
    components = (0, 1, 2) if markers or measure == "position" else tuple(range(6))
    loads = np.zeros((1, 6)) if absolute else _cases(load.on_arm(robot.reach))
    units = tuple("m" if j.prismatic else "rad" for j in robot.joint)
    kind = "absolute" if absolute else "deflection"
    return Setup(kind, markers or ("tcp",), components, loads, branches, units)


def _cases(load: Load) -> Array:
    """Load cases of every pose: down at two levels; sideways and as moments where the class allows them."""
    down = np.array([0.0, 0.0, -load.force, 0.0, 0.0, 0.0])
    cases = [several_levels(down)]
    if load.kind != "gravity":
        cases.append(load.force * np.eye(6)[:2])
    if load.moment is not None:
        cases.append(load.moment * np.eye(6)[3:])
    return np.vstack(cases)
