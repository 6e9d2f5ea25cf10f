"""Identification: the experiment is read from the data, the model reduced to it, the parameters fitted and judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from symstiff.arguments import real, require, whole
from symstiff.calibration.absolute import fit_absolute
from symstiff.calibration.counted import (
    fitted_beside,
    left_out_of,
    of_known_size,
    removed_of,
    with_known,
    without,
)
from symstiff.calibration.doubts.axes import AGAINST, against_loads
from symstiff.calibration.doubts.misread import misread
from symstiff.calibration.doubts.point import find_point, of_point
from symstiff.calibration.doubts.slips import left_by, slip
from symstiff.calibration.doubts.soundness import (
    check_beside_geometry,
    check_determined,
    check_same_robot,
    other_weights,
    outside_class,
    outside_fixed,
    unlike_file,
)
from symstiff.calibration.doubts.stations import check_stations
from symstiff.calibration.experiment.readings import ExperimentClass, experiment_of
from symstiff.calibration.fits.constrained import ConstrainedEstimate
from symstiff.calibration.fits.estimate import Estimate
from symstiff.calibration.fits.robust import RobustEstimate
from symstiff.calibration.fitting import Fitted, fit_model
from symstiff.calibration.kept import completed, of_table, on_the_clock, seen_in
from symstiff.calibration.levels import by_level
from symstiff.calibration.physical import reduction_of, values_of
from symstiff.calibration.redundant import redundant
from symstiff.calibration.remarks import (
    axis_hint,
    below_zero,
    beside_geometry,
    explained,
    fits,
    of_loads,
    of_redundant,
    of_sag,
    of_stations,
    repeated,
    unsettled,
)
from symstiff.calibration.residuals import ResidualTable, places, residual_table, split
from symstiff.calibration.rows import Equations, context_of, equations, predict
from symstiff.calibration.tables.checks import (
    check_measured,
    check_robot,
    of_units,
    without_copies,
    without_zeros,
)
from symstiff.calibration.tables.loading import as_loading
from symstiff.calibration.tables.measurements import Measurements
from symstiff.calibration.tables.sessions import by_session
from symstiff.display import counted, few
from symstiff.effects.registry import find
from symstiff.errors import UserError, printable
from symstiff.model import StiffnessModel, joints_only, load_model
from symstiff.reduction import Reduction, reduce
from symstiff.reduction.remarks import reduction_remarks
from symstiff.reduction.svd import numeric_partition
from symstiff.robot.schema import Robot
from symstiff.threads import one_thread


@dataclass(frozen=True, eq=False)
class Identification:
    """An identified model with its uncertainty, residuals before and after, and what was remarked on the way.

    ``model`` also holds what the start model told and deflections do not show; fit and residuals are without it.
    ``train`` and ``held_out`` are the readings less what effects of known size add.
    """

    model: StiffnessModel
    reduction: Reduction | None
    fit: Estimate
    equations: Equations
    training: ResidualTable
    validation: ResidualTable | None
    robust: RobustEstimate | None
    physical: ConstrainedEstimate | None
    remarks: tuple[str, ...]
    train: Measurements
    held_out: Measurements | None

    def to_dict(self) -> dict[str, Any]:
        """For JSON: parameters with uncertainty, residual tables in metres and radians, remarks."""
        record = (self.robust or self.fit).to_dict()
        record |= {
            "robot": self.model.robot.name,
            "loads": self.model.loads,
            "measure": self.model.measure,
            "residuals": self.training.to_dict(),
            "held_out": self.validation.to_dict() if self.validation else None,
            "physical": self.physical.to_dict() if self.physical else None,
            "remarks": list(self.remarks),
        }
        return record

    def __repr__(self) -> str:
        from symstiff.calibration.reading import identification_line

        return f"Identification({identification_line(self)})"

    def _repr_html_(self) -> str:
        from symstiff.calibration.reading import identification_html

        return identification_html(self)


def start_model(
    robot: Robot, start: str | Path | StiffnessModel, experiment: ExperimentClass
) -> tuple[StiffnessModel, Reduction | None]:
    """The model to fit: ``complete`` (reduced for the experiment), ``joints``, a model file, or the model itself."""
    if isinstance(start, StiffnessModel):
        check_same_robot(start, robot, "the start model")
        return start, None
    if start == "complete":
        reduction = reduce(
            robot, experiment.loads, experiment.measure, experiment.fixed, points=experiment.points
        )
        return StiffnessModel.of(reduction), reduction
    if start == "joints":
        e = experiment
        return joints_only(robot, e.loads, e.measure, e.fixed, e.points), None
    remedy = "give complete, joints, the path of a model.toml, or the model itself"
    require(start, (str, Path), "a start model", remedy)
    if not Path(start).exists():
        raise UserError(
            f"start: {printable(str(start))}: no such model file: give complete, joints, or the path of a model.toml"
        )
    model = load_model(start)
    check_same_robot(model, robot, str(start))
    return model, None


@one_thread()
def identify(
    robot: Robot,
    table: Measurements,
    start: str | Path | StiffnessModel = "complete",
    *,
    loads: str | None = None,
    measure: str | None = None,
    robust: bool = False,
    physical: bool = False,
    held_out: float = 0.0,
    per_level: int | None = None,
    seed: int = 0,
) -> Identification:
    """Fit a model to a table by weighted least squares (seed eq. 7, 8).

    ``start``: ``complete``, ``joints``, a model file or a model; ``loads`` and ``measure``: the class to reduce for,
    read from the table where not given. ``robust`` is Huber's estimator with a report of outliers, ``physical`` keeps
    every link matrix positive semidefinite. ``held_out`` is the share of poses kept for validation, which ``seed``
    draws; ``per_level`` a joint that gets one compliance for each of its distinct values (the seed's C2 and J2).
    Returns the identified model with the fit and its uncertainty, residuals and remarks. Raises UserError for data that
    cannot determine the model.
    """
    remarks = check_robot(table, robot)
    check_measured(table)
    whole(seed, "seed")
    real(held_out, "held_out", "a share of the poses")
    if not 0 <= held_out < 1:
        raise UserError(
            f"held_out: {held_out:g} is no share of the poses: give one from 0 to below 1, e.g. 0.2"
        )
    if table.kind == "absolute":
        _refuse_for_absolute({"robust": robust, "physical": physical, "held_out": held_out > 0})
    table, zeros = without_zeros(as_loading(table))
    table, copies = without_copies(table)
    table, sessions = by_session(table)
    check_stations(robot, table)
    seen = experiment_of(table, robot)
    remarks += [*zeros, *copies, *sessions, *of_loads(table, seen.loads), *repeated(table)]
    begin = _begin(robot, table, start, seen.wished(loads, measure), per_level)
    remarks += begin.remarks
    if table.kind == "absolute":
        return _from_absolute(begin, table, remarks)
    return _from_deflections(
        begin, robot, *_split(table, held_out, seed), remarks, robust=robust, physical=physical
    )


@dataclass(frozen=True, eq=False)
class _Begin:
    """The model to fit as the table shows it and as it was ``told``, what it came from, and what is remarked of it."""

    model: StiffnessModel
    told: StiffnessModel
    reduction: Reduction | None
    experiment: ExperimentClass
    full: StiffnessModel
    """With effects of known size, which are taken off deflections."""
    doubts: list[str]
    """Those of the remarks that the reduction makes."""
    remarks: list[str]


def _begin(
    robot: Robot,
    table: Measurements,
    start: str | Path | StiffnessModel,
    experiment: ExperimentClass,
    per_level: int | None,
) -> _Begin:
    """The start model, without what no equation of this table holds."""
    model, reduction = start_model(robot, start, experiment)
    remarks = []
    if experiment.fixed and start in ("complete", "joints"):
        names = ", ".join(f"q{i}" for i in experiment.fixed)
        remarks.append(f"{names} never move(s): the model is reduced for that")
    doubts = reduction_remarks(reduction) if reduction is not None else []
    remarks += [*other_weights(model, robot), *outside_class(table.w, model.loads)]
    remarks += [*outside_fixed(table.q, model), *doubts]
    if per_level is not None:
        whole(per_level, "per_level", 1)
        model = by_level(model, table, per_level)
    _refuse_rows(model)
    known, full = of_known_size(model), model
    told = model.with_effects([e for e in model.effects if e not in known])
    left_out = left_out_of(known) if table.kind == "absolute" else []
    told, elapsed = on_the_clock(told, table)
    model, unseen = seen_in(told, table.kind)
    unseen += elapsed
    context_of(model, table)  # refuses a table without the time or the branch that the model follows
    if not model.parameters:
        raise UserError("nothing to identify: " + "; ".join([*left_out_of(known), *unseen]))
    model, elsewhere = find_point(model, table, robot)
    remarks += [*left_out, *unseen, *([elsewhere] if elsewhere else [])]
    return _Begin(model, told, reduction, experiment, full, doubts, remarks)


def _from_deflections(
    begin: _Begin,
    robot: Robot,
    train: Measurements,
    validation: Measurements | None,
    remarks: list[str],
    *,
    robust: bool,
    physical: bool,
) -> Identification:
    """The fit to deflections, judged by what it leaves of them and of those that are held out."""
    model, reduction = begin.model, begin.reduction
    if known := of_known_size(begin.full):
        near = fitted_beside(known, model, train)
        train, as_read = without(known, near, train), train
        validation = None if validation is None else without(known, near, validation)
        remarks = [*remarks, *removed_of(known, robot, as_read, train)]
    found, held = _fit(model, train, robust=robust, physical=physical, reduced=reduction is not None)
    remarks = [*remarks, *([of_redundant(held, model)] if held else [])]
    fitted, e = found.estimate, found.equations
    hints = _misread(model, train, found)
    remarks += hints
    slides = [i for i, joint in enumerate(robot.joint, start=1) if joint.prismatic]
    unread = [name for k, name in enumerate(("dx", "dy", "dz")) if not train.measured[:, k].any()]
    kept = [] if validation is None else [_left_to_fit(train, validation)]
    doubts = [*of_units(train, robot), *hints, *kept, *begin.doubts]
    check_determined(fitted.rank, fitted.names, len(e.y), doubts, slides, unread)
    behind = reduction_of(model, begin.experiment) if physical and reduction is None else reduction
    values, constrained = values_of(fitted, behind, physical)
    values |= {n: model.values.get(n, 0.0) for n in held}
    model = model.with_values(values, _finite(dict(zip(fitted.names, fitted.std.tolist(), strict=True))))
    training = residual_table(train.values, predict(model, train))
    remarks += [*unsettled(found), *explained(training), *fits(fitted, e), *unlike_file(model, robot)]
    remarks += [] if physical or reduction is None or hints else below_zero(values, reduction)
    fresh = residual_table(validation.values, predict(model, validation)) if validation is not None else None
    full = with_known(completed(model, begin.told, train.kind), begin.full)
    return Identification(
        of_table(full, train), reduction, fitted, e, training, fresh,
        found.robust, constrained, tuple(remarks), train, validation,
    )  # fmt: skip


def _misread(model: StiffnessModel, table: Measurements, found: Fitted) -> list[str]:
    """What of the table looks exchanged or read in another way. Raises UserError where all of it is reversed."""
    slipped, _ = slip(model, table, left_by)
    against = against_loads(model.robot, table)
    if slipped and not against:
        return [slipped]
    hint = axis_hint(found.estimate.names, table, found.equations)
    if hint is not None and hint.reversed:
        raise UserError(str(hint))
    if against:
        raise UserError(f"{AGAINST}: look at the sign of {against}" + ("" if hint is None else f"; {hint}"))
    told, _ = misread(model, table, hint)
    return [told] if told else []


def _from_absolute(begin: _Begin, table: Measurements, remarks: list[str]) -> Identification:
    """The fit to absolute positions, with the geometry beside."""
    model = begin.model
    found = fit_absolute(model, table)
    nothing = (*found.silent, *found.held, *found.untold)
    open_ones = [n for n in model.parameters if n not in found.known and n not in nothing]
    check_beside_geometry(open_ones or ([] if any(n in found.known for n in model.parameters) else nothing))
    own = {n: found.known[n] for n in model.parameters if n in found.known}
    values = dict.fromkeys(nothing, 0.0) | {n: value for n, (value, _) in own.items()}
    model = model.with_values(values, {n: std for n, (_, std) in own.items()})
    remarks = [
        *remarks,
        *of_stations(table),
        *of_point(model, table),
        *beside_geometry(found, model),
        *unlike_file(model, model.robot),
        *of_sag(model.robot),
    ]
    return Identification(
        of_table(completed(model, begin.told, table.kind), table), begin.reduction, found.fit, found.equations,
        found.residuals, None, None, None, tuple(remarks), table, None,
    )  # fmt: skip


def _fit(
    model: StiffnessModel, table: Measurements, *, robust: bool, physical: bool, reduced: bool
) -> tuple[Fitted, tuple[str, ...]]:
    """The fit, and the parameters that keep their values: in a grown model, what nothing tells from the others."""
    found = fit_model(model, table, robust=robust)
    held = () if reduced or found.estimate.rank.full else tuple(redundant(model, table))
    if not held:
        return found, ()
    if physical:
        raise UserError(
            f"physical: no poses and loads tell {few(held)} from the start model's other parameters: start from "
            "complete, which is reduced, or leave it out"
        )
    return fit_model(model, table, robust=robust, held=held), held


def _refuse_rows(model: StiffnessModel) -> None:
    """Raise UserError for effects of single poses: they belong to a table, and no equation of a model holds them."""
    for effect in model.effects:
        if find(effect.effect).places_in is not None:
            raise UserError(
                f"the start model holds {effect.effect} at {dict(effect.where)}, which belongs to the table it was "
                "found in: leave these rows out of the table and that [[effect]] out of the model"
            )


def data_rank(model: StiffnessModel, table: Measurements) -> int:
    """Rank of the model's observation matrix at the table's configurations (numeric engine, M4–M5)."""
    e = equations(model, table)
    found, _ = numeric_partition(e.A, model.parameters, model.parameters)
    return found.rank


def _refuse_for_absolute(given: Mapping[str, bool]) -> None:
    for option, used in given.items():
        if used:
            raise UserError(
                f"{option}: is for deflections, these tables hold absolute positions: leave it out"
            )


def _split(table: Measurements, share: float, seed: int) -> tuple[Measurements, Measurements | None]:
    if share == 0:
        return table, None
    train, test = split(places(table.pose, np.hstack([table.values, table.q])), share, seed)
    return table.select(train), table.select(test)


def _left_to_fit(train: Measurements, validation: Measurements) -> str:
    left, kept = (len(set(table.pose.tolist())) for table in (train, validation))
    return f"held_out: {kept} of {counted(left + kept, 'pose')} held out, {left} left to fit"


def _finite(values: dict[str, float]) -> dict[str, float]:
    return {k: v for k, v in values.items() if np.isfinite(v)}
