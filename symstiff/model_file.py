"""model.toml, written and read back: validated as robot files are, every mistake one line with file, key, remedy."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, StrictStr, ValidationError

from symstiff.arguments import require_path
from symstiff.effects.instance import EffectInstance
from symstiff.errors import UserError, printable
from symstiff.files import write_file
from symstiff.model import StiffnessModel
from symstiff.reduction.physical import physical_stages
from symstiff.robot.loading import from_table, toml_table
from symstiff.robot.mistakes import explain
from symstiff.robot.quantities import Format, Number, not_a_stiffness
from symstiff.robot.table import structure_table, to_table

_NO_STRUCTURE = ("values", "deviations", "file_tool", "seen")
"""Keys of model.toml that models of one structure may differ in."""


def _deviation(value: float) -> float:
    if value < 0:
        raise UserError(f"a standard deviation is not negative, found {value:g}")
    return value


def _place(value: Any) -> Any:
    several = value if isinstance(value, list) else [value]
    numbers = (int, float) if isinstance(value, list) else (int,)
    if not any(all(type(x) in kinds for x in several) for kinds in (numbers, (str,))):
        raise UserError(f"expected a whole number, a name, or a list of numbers or names, found {value!r}")
    return value


Deviation = Annotated[Number, AfterValidator(_deviation)]
Place = Annotated[Any, AfterValidator(_place)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class EffectEntry(_Strict):
    """An ``[[effect]]``: which, where, with which shape."""

    effect: StrictStr
    where: dict[str, Place] = {}
    shape: dict[str, Number] = {}


class ModelFile(_Strict):
    """The keys of model.toml (format 1)."""

    format: Format
    loads: Literal["wrench", "force", "gravity"]
    measure: Literal["pose", "position"]
    parameters: tuple[StrictStr, ...]
    values: dict[str, Number] = {}
    deviations: dict[str, Deviation] = {}
    effect: tuple[EffectEntry, ...] = ()
    fixed: dict[str, Number] = {}
    file_tool: tuple[Number, Number, Number] | None = None
    seen: dict[str, tuple[Number, Number]] = {}
    robot: dict[str, Any]


def write_model(model: StiffnessModel, path: str | Path) -> None:
    """Write model.toml, whole or not at all."""
    import tomli_w

    write_file(path, tomli_w.dumps(to_model_table(model)))


def to_model_table(model: StiffnessModel) -> dict[str, Any]:
    """The model as model.toml holds it."""
    table: dict[str, Any] = {
        "format": 1,
        "loads": model.loads,
        "measure": model.measure,
        "parameters": [p.name for p in model.compliances],
        "values": model.known,
        "deviations": {n: float(model.deviations[n]) for n in model.parameters if n in model.deviations},
        "effect": [
            {"effect": e.effect, "where": dict(e.where), "shape": dict(e.shape)} for e in model.effects
        ],
        "robot": to_table(model.robot),
    }
    seen = {name: list(between) for name, between in model.seen.items()}
    more = (("fixed", model.fixed_by_name), ("file_tool", model.file_tool), ("seen", seen))
    return table | {key: value for key, value in more if value}


def hash_of_structure(model: StiffnessModel) -> str:
    """SHA-256 of everything but values, known ones included."""
    whole = to_model_table(model) | {"robot": structure_table(model.robot)}
    table = {k: v for k, v in whole.items() if k not in _NO_STRUCTURE}
    return hashlib.sha256(json.dumps(table, sort_keys=True).encode()).hexdigest()


def read_model(path: str | Path) -> StiffnessModel:
    """Read model.toml. Raises UserError."""
    require_path(path, "a model file")
    origin = printable(str(path))
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise UserError(f"{origin}: cannot read the model: {error.strerror}: check the path") from error
    except ValueError as error:  # a NUL or a lone surrogate
        raise UserError(f"{origin}: is no path: {error}") from error
    return from_model_table(toml_table(data, origin, "model file"), origin)


def from_model_table(table: dict[str, Any], origin: str) -> StiffnessModel:
    """A model from its table. Raises UserError naming what is wrong."""
    if "joint" in table and "robot" not in table:
        raise UserError(f"{origin}: this is a robot file: a model is what symstiff identify writes")
    try:
        file = ModelFile.model_validate(table)
    except ValidationError as error:
        raise UserError(f"{origin}: {explain(error)}") from error
    robot = from_table(file.robot, f"{origin}: robot")
    known = {p.name: p for stage in physical_stages(robot)[1:] for p in stage.parameters}
    for k, name in enumerate(file.parameters):
        if name not in known:
            raise UserError(f"{origin}: parameters: {robot.name} has no compliance {printable(name, 40)!r}")
        if name in file.parameters[:k]:
            raise UserError(f"{origin}: parameters: {name!r} stands there twice: remove one")
        try:
            not_a_stiffness(file.values.get(name, 0.0))
        except UserError as error:
            raise UserError(f"{origin}: values: {name}: {error}") from None
    try:
        effects = tuple(EffectInstance(e.effect, e.where, e.shape) for e in file.effect)
    except UserError as error:
        raise UserError(f"{origin}: effect: {error}") from error
    compliances = tuple(known[n] for n in file.parameters)
    joints = {f"q{j}": j for j in range(1, robot.dof + 1)}
    if strange := sorted(set(file.fixed) - set(joints)):
        raise UserError(
            f"{origin}: fixed: {robot.name} has no joint {printable(strange[0], 40)!r}: remove it"
        )
    fixed = {joints[name]: float(value) for name, value in file.fixed.items()}
    model = _modelled(
        origin,
        robot,
        compliances,
        file.loads,
        file.measure,
        effects,
        file.values,
        file.deviations,
        fixed,
        file.file_tool,
        file.seen,
    )
    _complete(model, origin)
    return model


def _modelled(origin: str, *parts: Any) -> StiffnessModel:
    try:
        return StiffnessModel(*parts)
    except UserError as error:
        raise UserError(f"{origin}: {error}") from error


def _complete(model: StiffnessModel, origin: str) -> None:
    """Realise the effects, and look for values that belong to nothing and for parameters without one."""
    try:
        parameters = set(model.parameters)
    except UserError as error:
        raise UserError(f"{origin}: effect: {error}") from error
    for key, numbers in (("values", model.values), ("deviations", model.deviations)):
        unknown = sorted(set(numbers) - parameters)
        if unknown:
            raise UserError(
                f"{origin}: {key}: the model has no parameter {printable(unknown[0], 40)!r}: remove it"
            )
    missing = [n for n in model.parameters if n not in model.values]
    if model.values and missing:  # without any it is a start for identify
        raise UserError(
            f"{origin}: values: {printable(missing[0], 40)} has none, and other parameters have: add it, 0 where it is "
            "none"
        )
    if not parameters:
        raise UserError(f"{origin}: parameters: a model has at least one parameter or effect")
