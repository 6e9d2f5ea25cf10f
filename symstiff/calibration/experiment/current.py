"""The current model on the data: its columns, the values that fit, and what is left to explain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.experiment.anywhere import any_loads, any_poses
from symstiff.calibration.experiment.arm import Arm, drawn, standing
from symstiff.calibration.experiment.full import full_laws
from symstiff.calibration.experiment.placement import placed, placement_columns, turns_of
from symstiff.calibration.experiment.readings import experiment_of
from symstiff.calibration.experiment.rounding import without_rounding
from symstiff.calibration.experiment.situation import (
    Laws,
    Situation,
    View,
    Weigh,
    loads_of,
    look,
    under_weights,
)
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.calibration.rows import stated_sigma
from symstiff.calibration.tables.measurements import Measurements
from symstiff.effects.base import Realisation, Shape, Where
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel
from symstiff.reduction.physical import Parameter as Compliance
from symstiff.reduction.physical import physical_stages, terms_of
from symstiff.reduction.svd import svd
from symstiff.robot import Robot
from symstiff.symbolic.algebras import evaluate_numpy
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.program import Program
from symstiff.symbolic.programs import observation_program
from symstiff.symbolic.terms import Term

_POSES = 60
"""Random poses at which columns are compared."""
_ROUNDS = 3
"""Times that the device's placement and the arm's geometry are found from each other."""
_COMPLIANCE = 1e-7
"""Usual size of a compliance that the model leaves out."""
_FRAME, _LARGE = 1e-3, 10.0
"""Usual error of a link [m, rad], and how many usual sizes are too large to be believed where data hardly tell them."""


@dataclass(frozen=True, eq=False)
class Current:
    """The current model on the data: its situation, columns, what they are to explain, and fitted values.

    A (M, names + hidden + placement): ``hidden`` are compliances beside the model's that links' weights show. Their
    columns are what weights add: nothing under loads at the tool, for which the model's parameters stand for them.
    """

    situation: Situation
    names: tuple[str, ...]
    hidden: tuple[Compliance, ...]
    A: Array
    y: Array
    fitted: dict[str, float]
    arm: Arm
    """From which ``y`` starts."""


def settled(
    model: StiffnessModel, table: Measurements, weigh: Weigh | None = None, arm: Arm | None = None
) -> Current:
    """The current model on the data; with absolute positions placement and geometry settle along with it.

    Loads that effects add act on compliances that are fitted here: ``weigh`` where more is known of the noise than
    each row's sigma. A pose that was missed, or an effect that all load cases of a pose share, bends them otherwise.
    ``arm``: one that is known, as of a better model of the same table.
    """
    view, known = look(model.robot, table), dict(model.values)
    if table.kind != "absolute":
        return _current(
            model, model.terms, (), view, drawn(view, Laws(view, model.terms, known)), known, weigh
        )
    view = under_weights(view)
    hidden = _hidden(model) if model.robot.has_weights else ()
    terms = (*model.terms, *terms_of(hidden))
    first = arm or drawn(view, Laws(view, terms, known))
    current = _current(model, terms, hidden, view, first, known, weigh)
    for _ in range(_ROUNDS - 1 if arm is None else 0):
        current = _current(model, terms, hidden, view, _found(model, current), current.fitted, weigh)
    return _standing(model, current) if current.hidden else current


def _found(model: StiffnessModel, current: Current) -> Arm:
    """The arm that the data show, by constants of all links beside the model."""
    numbers, off = _as_found(model, current)
    laws = current.situation.laws
    return standing(current.situation.view, replace(laws, numbers=numbers), off)


def _as_found(model: StiffnessModel, current: Current) -> tuple[dict[str, float], Array]:
    """Values of the model, and what all links are off besides (V,), as the data show them.

    Each is as small as it can be where the data do not tell it from others, but for the parameters of effects.
    """
    view = current.situation.view
    links = [k for k, v in enumerate(view.joints) if v.kind == "link" and v.body]
    free = (*current.names, *(p.name for p in current.hidden))
    count, spread = len(free), spread_of(view)[:, None]
    placement = svd(current.A[:, count:] / spread)[0]
    effects = {p.name for p in model.effect_parameters}
    largest = [_LARGE if n not in effects else _LARGE**3 for n in free]
    usual = np.concatenate([_sizes(model, free) * largest, np.full(len(links), _LARGE * _FRAME)])
    rows = np.column_stack([current.y, np.hstack([current.A[:, :count], view.J[:, links]]) * usual]) / spread
    rows -= placement @ (placement.T @ rows)
    U, s, Vt = svd(rows[:, 1:])
    value = usual * (Vt.T @ (s / (s**2 + 1.0) * (U.T @ rows[:, 0])))
    off = np.zeros(len(view.joints))
    off[links] = value[count:]
    return {**current.situation.laws.numbers} | dict(zip(free, value[:count].tolist(), strict=True)), off


def _standing(model: StiffnessModel, current: Current) -> Current:
    """The same columns' space by the model's reduced parameters: each stands for itself and its share of the hidden.

    Otherwise the values of the model would be those of the parameters alone, which no load at the tool shows.
    """
    shares = _shares(model, current.hidden, current.situation.view.table)  # (compliances, hidden)
    hidden = tuple(p.name for p in current.hidden)
    elastic = [p.name for p in model.compliances]
    there = [k for k, n in enumerate(elastic) if n in current.names]
    own = [current.names.index(elastic[k]) for k in there]
    beside = slice(len(current.names), len(current.names) + len(hidden))
    A, fitted = current.A.copy(), dict(current.fitted)
    A[:, beside] -= A[:, own] @ shares[there]
    free = (*current.names, *hidden)
    # of a column that the model holds rounding is left: a direction of its own, and another one at every call
    A[:, : len(free)] = without_rounding(A[:, : len(free)], _sizes(model, free))
    values = np.array([fitted.get(n, 0.0) for n in hidden])
    for name, more in zip(elastic, shares @ values, strict=True):
        fitted[name] = fitted.get(name, 0.0) + float(more)
    return replace(current, A=A, fitted=fitted)


def _shares(model: StiffnessModel, hidden: Sequence[Compliance], table: Measurements) -> Array:
    """(compliances, hidden) coefficients of hidden columns in the model's, under loads of its class at the tool."""
    parameters = (*model.compliances, *hidden)
    points = tuple(experiment_of(table, model.robot).points)
    program = _program(model.robot, parameters, points)
    rng = np.random.default_rng(0)
    q = any_poses(model.robot, rng, _POSES, table.standing)
    w = any_loads(model.loads, rng, _POSES)
    A = evaluate_numpy(program, q=q, w=w)["A"]
    A = (A[:, :3] if model.measure == "position" and not points else A).reshape(-1, len(parameters))
    size = np.linalg.norm(A, axis=0)
    size[size < 1e-9 * size.max()] = np.inf
    count = len(model.compliances)
    own = A[:, :count] / size[:count]
    return np.asarray(np.linalg.lstsq(own, A[:, count:], rcond=1e-9)[0] / size[:count, None])


@lru_cache(maxsize=8)
def _program(robot: Robot, parameters: tuple[Compliance, ...], points: tuple[str, ...]) -> Program:
    """The columns of compliances; the same at every linearisation of a fit."""
    names = [p.name for p in parameters]
    return observation_program(ElasticChain(robot), terms_of(parameters), names, points)


def _hidden(model: StiffnessModel) -> tuple[Compliance, ...]:
    """Compliances that loads at the tool leave out of a complete model, and that weights bring back.

    Joints as well: a link's weight bends the link and does not turn the joint behind it, which M3 gave to it, and it
    moves the one of two parallel slides alone that stands before it.
    """
    elastic = {p.body for p in model.compliances if not p.is_joint}
    full = physical_stages(model.robot)[2].parameters
    left_out = (p for p in full if p.name not in model.parameters)
    return tuple(p for p in left_out if p.is_joint or p.body in elastic)


def _current(
    model: StiffnessModel,
    terms: tuple[Term, ...],
    hidden: tuple[Compliance, ...],
    view: View,
    arm: Arm,
    known: dict[str, float],
    weigh: Weigh | None,
) -> Current:
    """Columns of the model at ``known`` values, and values that fit the data."""
    view, y = placed(view, arm)
    nominal = {n: v for r in model.realisations for n, v in r.nominal.items()}
    named = tuple(n for n in model.parameters if n not in nominal)
    free = (*named, *(p.name for p in hidden))
    fit = dict(known)
    laws = Laws(view, terms, {**fit, **nominal})
    for _ in range(2):  # terms of loads and of the device lean on the fitted compliances
        view = under_effects(view, laws)
        situation = Situation(view, laws)
        A = situation.columns(terms, free)
        place = {n: k for k, n in enumerate(free)}
        target = y + _bent(situation)
        for effect, realised in zip(model.effects, model.realisations, strict=True):
            for name, column in _own_columns(situation, effect.effect, effect.where, effect.shape, realised):
                if name in place:
                    A[:, place[name]] += column
                else:
                    target -= nominal[name] * column
        A = without_rounding(A, _sizes(model, free))
        extra = placement_columns(view, probe=model.file_tool is not None)
        begin = [known.get(n, 0.0) for n in free]
        solution, weighed = _fitted(np.hstack([A, extra]), target, view, begin, weigh)
        fit = dict(zip(free, solution, strict=True))
        own = [k for k, n in enumerate(free) if n in {p.name for p in model.effect_parameters}]
        laws = full_laws(model, view, np.hstack([A[:, own], extra]), {**fit, **nominal}, target, weighed)
    situation = Situation(under_effects(view, laws), laws)
    keep = np.any(A != 0, axis=0)
    kept = [n for n, k in zip(free, keep, strict=True) if k]
    names, beside = tuple(n for n in named if n in kept), tuple(p for p in hidden if p.name in kept)
    return Current(situation, names, beside, np.hstack([A[:, keep], extra]), target, fit | nominal, arm)


def _sizes(model: StiffnessModel, names: Sequence[str]) -> Array:
    """Usual sizes of parameters, the hidden ones included."""
    return np.array([model.steps.get(n, _COMPLIANCE) for n in names])


def under_effects(view: View, laws: Laws) -> View:
    """The view with the loads that the model's effects add by their values."""
    loads = loads_of(view, laws.terms)
    if not loads:
        return view
    return replace(view, more=sum(laws.numbers.get(name, 0.0) * load for name, load in loads.items()))


def _bent(situation: Situation) -> Array:
    """(M,) by which columns of added loads exceed their share: laws that are not linear are seen under all loads."""
    view, more = situation.view, situation.view.more
    if not isinstance(more, np.ndarray):
        return np.zeros(len(view.state))
    bend = situation.slope(more) - situation.laws.linear(more)
    return np.asarray(np.einsum("mv,mv->m", view.J, bend[view.state]))


def _own_columns(
    situation: Situation, identifier: str, where: Where, shape: Shape, realised: Realisation
) -> Iterator[tuple[str, Array]]:
    columns = find(identifier).columns
    if columns is not None:
        block = columns(situation, where, shape)
        for k, parameter in enumerate(realised.parameters):
            yield parameter.name, block[:, k]


def _fitted(
    A: Array, y: Array, view: View, start: Sequence[float], weigh: Weigh | None
) -> tuple[list[float], Weigh]:
    """Least squares about the start values, and how it weighed the rows: sigma as stated, else what is left.

    Directions that the data do not hold stay at the start.
    """
    spread = spread_of(view)[:, None]
    plain: Weigh = weigh or (lambda rows: rows / spread)
    count = len(start)
    begin = np.concatenate([start, np.zeros(A.shape[1] - count)])
    X, r = plain(A), plain((y - A @ begin)[:, None])[:, 0]
    columns, length = unit_columns(X)
    U, s, Vt = svd(columns)
    keep = s > 1e-5 * s[0] if len(s) else s > 0
    share = U[:, keep].T @ r
    step = Vt[keep].T @ (share / s[keep]) / length
    scale = 1.0
    if weigh is not None or sigma_of(view) is None:
        left = r - U[:, keep] @ share
        scale = max(float(np.sqrt(np.mean(left**2))), 1e-6)
    return [float(x) for x in (begin + step)[:count]], lambda rows: plain(rows) / scale


def spread_of(view: View) -> Array:
    """Standard deviation of every row where stated, else one for lengths and one for angles."""
    stated = sigma_of(view)
    return np.where(view.component < 3, 1e-4, 1e-3) if stated is None else stated


def sigma_of(view: View) -> Array | None:
    """(M,) stated sigma; gaps take the median of their kind, None where a kind has none.

    A row of an attitude is a small turn of the tool: of the stated sigma of a rotation vector's components, which
    count for less the further it turns, that turn's.
    """
    known = stated_sigma(view.table, view.state, view.component)
    turned = view.component >= 3
    if known is None or view.table.kind != "absolute" or not turned.any():
        return known
    each = np.full((len(view.table), 3), np.median(known[turned]))
    each[view.state[turned], view.component[turned] - 3] = known[turned]
    gain = turns_of(np.nan_to_num(view.table.values[:, 3:]))
    found = np.sqrt(np.einsum("nij,nj->ni", gain**2, each**2))
    known[turned] = found[view.state[turned], view.component[turned] - 3]
    return known
