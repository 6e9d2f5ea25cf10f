"""The truth of a virtual experiment: what the robot really is, and how it is measured. TOML, ``format = 1``.

    format = 1
    robot = "kuka_kr270"                 # of the library, or a path (beside this file, or as it stands)

    [measure]
    kind = "deflection"                  # or "absolute"; default: what the poses table holds, else deflection
    components = "position"              # or "pose"; default position

    [compliance]
    start = "nominal"                    # plausible complete compliances (nominal_truth), or "zero"
    c2 = 0.3e-6                          # any joint or link term; k<i>_<row><col>, any of the 21 of a link
    k2_66 = 1.1e-7

    [[effect]]                           # as many as wanted; effects of the catalogue, and others
    effect = "backlash"
    where = {joint = 3}
    shape = "tanh"                       # optional: see describe_effects()
    gap = 2e-4                           # the shape's parameters, SI units

    [noise]                              # every key optional
    sigma_mm = 0.03                      # or [x, y, z], axes of what is read: device, or base of deflections
    sigma_mrad = 0.05                    # of measured rotations
    growth_ppm = 5.0                     # added in quadrature: ppm of the distance from the device
    approach_mm = 0.01                   # shift common to all rows of one pose (and repeat); or [x, y, z]
    approach_mrad = 0.0                  # error of every joint, common to the loaded rows of one pose
    settling_mrad = 0.0                  # error of every joint, or n numbers, new at every reading; of slides mm
    unloaded_mm = 0.0                    # of the reading without load, common to a point's deflections of a pose
    quantum_mm = 0.0                     # readings are rounded to this
    stated = 1.0                         # sigma columns: the true deviation times this; 0: none

    [device]
    xyz = [3.0, -2.0, 1.0]               # placement of the measuring device in the world
    rpy = [0.0, 0.0, 2.5]

    [environment]                        # rows without time and temperature of their own get these
    interval = 20.0                      # s between rows, from start = 0
    temperature = 20.0                   # degC at the start
    warming = 3.0                        # K in the end, by 1 - exp(-t/T)
    T = 1800.0

Weights of links act where the robot file gives masses, behind the link's own springs, so that it bends under
its own weight too; ``weights = "before"`` hangs them ahead of those springs, ``weights = false`` leaves them
out. Joints and links by number as in parameter names.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from symstiff.arguments import require, require_path
from symstiff.calibration.simulation.chain import chain_of
from symstiff.calibration.simulation.forms import number
from symstiff.calibration.simulation.nominal import nominal_truth
from symstiff.calibration.simulation.phenomena import Effect
from symstiff.calibration.simulation.rehearsal import rehearse
from symstiff.errors import UserError, printable
from symstiff.robot import Robot, library, load
from symstiff.robot.frozen import FrozenDict
from symstiff.robot.loading import toml_table

_TERM = re.compile(r"^(?:c(\d+)|k(\d+)_([1-6])([1-6]))$")
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Noise:
    """Errors of the measurement: mm and mrad as in the file."""

    sigma_mm: Triple = (0.0, 0.0, 0.0)
    sigma_mrad: Triple = (0.0, 0.0, 0.0)
    growth_ppm: float = 0.0
    approach_mm: Triple = (0.0, 0.0, 0.0)
    approach_mrad: float = 0.0
    settling_mrad: tuple[float, ...] = ()
    """(n,) a joint, or none."""
    unloaded_mm: Triple = (0.0, 0.0, 0.0)
    quantum_mm: float = 0.0
    stated: float = 1.0


@dataclass(frozen=True)
class Device:
    """Placement of the measuring device in the world: m, rad."""

    xyz: Triple = (3.0, -2.0, 1.0)
    rpy: Triple = (0.0, 0.0, 2.5)


@dataclass(frozen=True)
class Environment:
    """Clock and warmth: seconds between rows, degC at the start, K gained in the end, time constant [s]."""

    interval: float = 0.0
    start: float = 0.0
    temperature: float = 20.0
    warming: float = 0.0
    T: float = 1800.0


@dataclass(frozen=True)
class Truth:
    """What a virtual experiment is made of; ``compliance`` by parameter name, SI."""

    robot: Robot
    compliance: Mapping[str, float]
    effects: tuple[Effect, ...] = ()
    noise: Noise = field(default_factory=Noise)
    device: Device = field(default_factory=Device)
    environment: Environment | None = None
    kind: Literal["deflection", "absolute"] | None = None
    components: Literal["position", "pose"] = "position"
    weights: bool | Literal["before"] = True
    robot_file: Path | None = None
    """Where the robot was read from; None for one of the library, or none of a file."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "compliance", FrozenDict(self.compliance))

    def __repr__(self) -> str:
        made_of = "".join(f" + {e.effect}" for e in self.effects)
        return f"Truth({self.robot.name}{made_of}: noise {max(self.noise.sigma_mm):g} mm)"

    def with_effects(self, *effects: Effect) -> Truth:
        """Return the same truth with other effects."""
        return replace(self, effects=effects)


def load_truth(path: str | Path) -> Truth:
    """Read a TRUTH.toml. Raises UserError in one line: file, key, remedy."""
    require_path(path, "a truth file")
    origin = str(path)
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise UserError(f"{origin}: cannot read the truth: {error.strerror}: check the path") from error
    table = toml_table(data, origin, "truth file")
    try:
        return truth_from_table(table, Path(path).parent)
    except UserError as error:
        raise UserError(f"{origin}: {error}") from error


def truth_from_table(table: Mapping[str, Any], folder: Path | None = None) -> Truth:
    """Build a truth from nested dictionaries as in the file; ``robot`` may be a Robot. Raises UserError."""
    require(table, Mapping, "a truth as a table", "{'robot': 'ur10'} is one")
    sections = ("measure", "compliance", "effect", "noise", "device", "environment")
    _known(table, ("format", "robot", "weights", *sections), "")
    stated = table.get("format", 1)
    if type(stated) is not int or stated != 1:
        raise UserError(f"format = {printable(repr(stated), 40)}: this program reads format = 1")
    file = _robot_file(table.get("robot"), folder)
    robot = _robot(table.get("robot"), file)
    for name in sections:
        if not isinstance(
            table.get(name, [] if name == "effect" else {}), list if name == "effect" else Mapping
        ):
            raise UserError(
                f"{name}: write it as {'[[effect]]' if name == 'effect' else f'[{name}]'} with keys"
            )
    measure, environment = table.get("measure", {}), table.get("environment")
    _known(measure, ("kind", "components"), "measure.")
    truth = Truth(
        robot=robot,
        compliance=_compliance(table.get("compliance", {}), robot),
        effects=tuple(_effect(entry) for entry in table.get("effect", [])),
        noise=_section(Noise(), table.get("noise", {}), "noise", robot.dof),
        device=_section(Device(), table.get("device", {}), "device"),
        environment=None if environment is None else _section(Environment(), environment, "environment"),
        kind=_choice(measure.get("kind"), (None, "deflection", "absolute"), "measure.kind"),
        components=_choice(measure.get("components", "position"), ("position", "pose"), "measure.components"),
        weights=_choice(table.get("weights", True), (True, False, "before"), "weights"),
        robot_file=file,
    )
    for effect in truth.effects:  # every mistake shows on reading, not in the middle of an experiment
        rehearse(effect, chain_of(robot))
    return truth


def _robot_file(given: Any, folder: Path | None) -> Path | None:
    """The file that a robot's name stands for: beside the truth, or as it stands; None for one of the library."""
    if not isinstance(given, str) or given in library():
        return None
    beside = (folder or Path()) / given
    return beside if beside.exists() else Path(given)


def _robot(given: Any, file: Path | None) -> Robot:
    if isinstance(given, Robot):
        return given
    if not isinstance(given, str):
        raise UserError(f"robot: name one of the library or a path, e.g. {library()[0]!r}")
    return load(given if file is None else file)


def _compliance(table: Mapping[str, Any], robot: Robot) -> dict[str, float]:
    start = _choice(table.get("start", "nominal"), ("nominal", "zero"), "compliance.start")
    values = nominal_truth(robot) if start == "nominal" else {}
    for name, value in table.items():
        if name == "start":
            continue
        match = _TERM.match(name)
        joint, link = (int(match.group(1) or 1), int(match.group(2) or 0)) if match else (0, 0)
        if match is None or not 1 <= joint <= robot.dof or link > robot.dof:
            raise UserError(
                f"compliance.{name}: name a joint c1 … c{robot.dof} or a link's term k0_11 … k{robot.dof}_66"
            )
        if match.group(3) and match.group(3) > match.group(4):
            raise UserError(
                f"compliance.{name}: write the row first: k{link}_{match.group(4)}{match.group(3)}"
            )
        values[name] = number(value, f"compliance.{name}")
        if values[name] < 0 and match.group(3) == match.group(4):
            raise UserError(
                f"compliance.{name} = {values[name]:g}: what gives way has no negative compliance"
            )
    return values


def _effect(entry: Any) -> Effect:
    if not isinstance(entry, Mapping) or not isinstance(entry.get("effect"), str):
        raise UserError('effect: every [[effect]] has a name, e.g. effect = "backlash"')
    shape = entry.get("shape", "")
    if not isinstance(shape, str):
        raise UserError(f"effect {entry['effect']}: shape is a name, found {shape!r}")
    values = {k: v for k, v in entry.items() if k not in ("effect", "where", "shape")}
    return Effect(entry["effect"], entry.get("where"), shape, values)


def _section(defaults: Any, table: Mapping[str, Any], name: str, dof: int = 3) -> Any:
    """Fill a dataclass of numbers and triples, or one number a joint, from a table; a single number fills them."""
    known = defaults.__dataclass_fields__
    _known(table, tuple(known), f"{name}.")
    values: dict[str, Any] = {}
    for key, value in table.items():
        label = f"{name}.{key}"
        if isinstance(getattr(defaults, key), tuple):
            count = len(getattr(defaults, key)) or dof
            items = value if isinstance(value, list | tuple) else [value] * count
            if len(items) != count:
                of = "three numbers" if count == 3 else f"{count} numbers, one a joint,"
                raise UserError(f"{label}: {of} expected, found {value!r}")
            values[key] = tuple(number(item, label) for item in items)
        else:
            values[key] = number(value, label)
        smallest = values[key] if isinstance(values[key], float) else min(values[key])
        if name in ("noise", "environment") and smallest < 0 and key not in ("temperature", "warming"):
            raise UserError(f"{label}: not negative, found {value!r}")
    return replace(defaults, **values)


def _choice(value: Any, allowed: tuple[Any, ...], label: str) -> Any:
    for option in allowed:
        if value is option or (isinstance(option, str) and value == option):
            return option
    shown = ", ".join(str(option).lower() for option in allowed if option is not None)
    raise UserError(f"{label} = {value!r}: use one of {shown}")


def _known(table: Mapping[str, Any], keys: tuple[str, ...], prefix: str) -> None:
    for key in table:
        if key not in keys:
            raise UserError(f"{prefix}{key}: unknown key: known are {', '.join(keys)}")
