"""Growth: effects join the model, all parameters are identified jointly, and what cannot be told apart is zero."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.absolute import untold
from symstiff.calibration.experiment.placement import best_placed
from symstiff.calibration.experiment.rounding import without_rounding
from symstiff.calibration.experiment.situation import Situation
from symstiff.calibration.fits.decomposition import own_columns
from symstiff.calibration.plausible import implausible
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.assemble import Assembly, assemble
from symstiff.discrepancy.noise.scales import Noise
from symstiff.discrepancy.problem import Problem, key_of
from symstiff.discrepancy.statistics.bank import build
from symstiff.discrepancy.statistics.prepare import at_first, prepare
from symstiff.discrepancy.statistics.scan import Scan, coefficients, one_sharing, open_scan
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel

_ROUNDS, _SETTLED = 8, 1e-3
"""Most linearisations of a fit, and the change of what is left, as a share of it, at which it has settled."""
_ASTRAY = 10.0
"""Growth of what the parameters are fitted to, by a round, from which that has gone astray: it does not count."""
_INSIDE = 1e-5
"""Share of a column's length outside the columns before it below which it says nothing of its own."""


@dataclass(frozen=True, eq=False)
class JointFit:
    """A model with jointly identified values.

    ``absorbed`` are parameters whose columns are combinations of the others': zero, without a deviation.
    ``residual`` (M,) of the problem's rows, in m and rad; ``reading`` (M,) what the rows read before the model.
    """

    model: StiffnessModel
    absorbed: tuple[str, ...]
    residual: Array
    reading: Array
    assembly: Assembly
    noise: Noise
    """As the fit weighed the rows: with one shared error, the likeliest."""
    leaning: tuple[str, ...] = ()
    """Compliances that absolute positions tell if the geometry is right: errors of all frames would hide them."""


def grow(model: StiffnessModel, instances: Iterable[EffectInstance]) -> StiffnessModel:
    """The model with effects added; those that it has already are left as they are."""
    there = {key_of(e.effect, e.where) for e in model.effects}
    for instance in instances:
        if key_of(instance.effect, instance.where) not in there:
            model = model.with_effect(instance)
    return model


def fit(
    model: StiffnessModel, table: Measurements, noise: Noise | None = None, without: Collection[str] = ()
) -> JointFit:
    """Identify all parameters of a model jointly but those ``without``, with the noise as the data show it.

    The device's placement in absolute data is estimated along. Loads and readings that lean on the
    compliances (a wrong load, a turned frame), and laws under such loads, are linearised anew until what is left
    settles; the noise is learned from what is left then. ``noise``: one that is known, as of a better model of the same
    table. Raises UserError for data that do not fit the robot.
    """
    if noise is not None:
        return _linearised(model, model, table, without, noise)
    near = model if _linear(model, table) else _linearised(model, model, table, without).model
    problem = _columns(model, assemble(near, table, effects=()), without)[0]
    return _linearised(model, near, table, without, one_sharing(prepare(problem, ()).scan))


def _linear(model: StiffnessModel, table: Measurements) -> bool:
    """Whether one linearisation is exact."""
    return model.is_linear and table.kind != "absolute"


def _linearised(
    model: StiffnessModel, near: StiffnessModel, table: Measurements, without: Collection[str],
    noise: Noise | None = None,
) -> JointFit:  # fmt: skip
    """The fit of linearisations from the values of ``near`` on, by a noise or as the model alone shows it."""
    known, weights, found = near, noise, None
    for _ in range(1 if _linear(model, table) else _ROUNDS):
        assembly = assemble(known, table, effects=(), noise=weights)
        if found is not None and _length(assembly.problem.y) > _ASTRAY * _length(found.assembly.problem.y):
            break
        problem, own = _columns(model, assembly, without)
        weights = at_first(problem) if noise is None else noise
        value, std, fitted = coefficients(_weighed(problem, weights), problem.A, problem.y, ())
        values = dict.fromkeys(model.parameters, 0.0) | _nominal(model)
        values |= dict(zip(own, value[: len(own)].tolist(), strict=True))
        deviations = {n: float(s) for n, s in zip(own, std[: len(own)], strict=True) if np.isfinite(s)}
        known = model.with_values(values, deviations)
        left, before = problem.y - fitted, found.residual if found is not None else None
        absorbed = tuple(n for n in model.parameters if n not in own and n not in _nominal(model))
        found = JointFit(
            known, absorbed, left, best_placed(assembly.situation.view, problem.y), assembly, weights
        )
        if before is not None and _length(left - before) < _SETTLED * _length(left):
            break
    assert found is not None
    return found


def _columns(
    model: StiffnessModel, assembly: Assembly, without: Collection[str]
) -> tuple[Problem, list[str]]:
    """The problem with the columns that say something of their own, and the parameters of those that come first."""
    problem, names = assembly.problem, assembly.names
    kept = with_meaning(problem, [0.0 if n in without else model.steps[n] for n in names])
    return replace(problem, A=problem.A[:, kept]), [names[k] for k in kept if k < len(names)]


def _length(rows: Array) -> float:
    return float(np.linalg.norm(rows))


def fit_told(
    model: StiffnessModel, table: Measurements, noise: Noise | None = None, like: JointFit | None = None,
    trusted: bool = False,
) -> JointFit:  # fmt: skip
    """``fit``, where the table holds absolute positions without the compliances that these do not tell.

    An error of the geometry looks like compliances in them, of sizes that no arm has: those are zero, not values.
    ``trusted``: the geometry is right, or its error is in the model, and hides none; ``like``: a fit of the model with
    effects besides, whose zeros hold here too.
    """
    if table.kind != "absolute":
        return fit(model, table, noise)
    own = {p.name for p in model.compliances} & set(model.stiffness_parameters)
    if like is not None and own <= set(like.model.stiffness_parameters):
        return fit(model, table, noise, own & set(like.absorbed))
    hidden = own & set(untold(model, table))
    without = set() if trusted else set(hidden)
    found = fit(model, table, noise, without)
    while more := implausible(model, _sized(found.model, own)):
        without |= (hidden & set(more)) or set(more)
        found = fit(model, table, noise, without)
    determined = hidden - set(found.absorbed)
    return replace(found, leaning=tuple(n for n in model.parameters if n in determined))


def _sized(model: StiffnessModel, names: Iterable[str]) -> dict[str, tuple[float, float]]:
    """Values and deviations of what a fit determined."""
    return {n: (model.values[n], model.deviations[n]) for n in names if n in model.deviations}


def _weighed(problem: Problem, noise: Noise) -> Scan:
    """The scan of a model without candidates under a noise that is known."""
    return open_scan(build(problem, (), ()), noise, problem.y, problem.A)


def with_meaning(problem: Problem, sizes: Sequence[float]) -> list[int]:
    """Columns that say something of their own: the device's placement first, then the model's in order.

    ``sizes`` are usual ones of the model's parameters, whose columns come first; 0 leaves one out.
    """
    named = len(sizes)
    sigma = np.ones(problem.rows) if problem.sigma is None else problem.sigma
    A = problem.A / sigma[:, None]
    A[:, :named] = without_rounding(A[:, :named], np.array(sizes))
    order = np.roll(np.arange(A.shape[1]), -named)
    return sorted(int(order[k]) for k in own_columns(A[:, order], _INSIDE))


def contribution(assembly: Assembly, instance: EffectInstance, values: dict[str, float]) -> Array:
    """(M,) what an effect adds to the data with the given parameter values."""
    robot, situation = assembly.situation.view.robot, assembly.situation
    realised = instance.realise(robot)
    names = [p.name for p in realised.parameters]
    block = columns_of(situation, instance, names)
    return np.asarray(block @ np.array([values.get(n, 0.0) for n in names]))


def columns_of(situation: Situation, instance: EffectInstance, names: Sequence[str]) -> Array:
    """(M, len(names)) columns of an effect's parameters in a situation."""
    realised = instance.realise(situation.view.robot)
    special = find(instance.effect).columns
    if special is None:
        return situation.columns(realised.terms, list(names))
    block = special(situation, instance.where, instance.shape)
    place = {p.name: k for k, p in enumerate(realised.parameters)}
    return np.asarray(block[:, [place[n] for n in names]], dtype=float)


def _nominal(model: StiffnessModel) -> dict[str, float]:
    return {n: float(v) for r in model.realisations for n, v in r.nominal.items()}
