"""Candidates: every effect of the catalogue at all its places, with its shapes sized to the experiment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.experiment.current import spread_of
from symstiff.calibration.experiment.situation import (
    Situation,
    View,
    under_weights,
)
from symstiff.calibration.fits.decomposition import column_space
from symstiff.calibration.levels import levels_of
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.ranges import Extent, at_size, extent_of
from symstiff.discrepancy.noise.scales import Noise
from symstiff.discrepancy.problem import ANGLE, CLOCK, HISTORY, Candidate, Parameter, Problem, key_of
from symstiff.effects.base import Effect, Move, Realisation, Scales, Shape, Where
from symstiff.effects.lawful import check_laws
from symstiff.effects.places import site
from symstiff.effects.registry import is_brought
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.robot.schema import Robot
from symstiff.symbolic.terms import BRANCH, TEMPERATURE, TIME, TURN, VirtualJoint, q, up

_LEFT = 1e-9
"""Share of a column's squared length below which nothing of it is outside the model."""
_VISIBLE = 12.0
"""Noncentrality below which a shape of known size is not looked for: no test would see it. Where none is, the effect is
counted as it is."""
_AT_ONCE = 0.1
"""Share of a session up to which the first reading's time is taken for the time since its start."""
UNLOADED = 1e-9
"""Load on a virtual joint, against the largest, that is rounding."""
_KEPT = 4096
"""Shapes of effects at their places whose laws are kept."""


def candidates(
    model: StiffnessModel, situation: Situation, problem: Problem, effects: Iterable[Effect],
    noise: Noise | None = None,
) -> Iterator[Candidate]:  # fmt: skip
    """Every effect at every place, those that the data cannot show with the reason why.

    ``noise`` is how the rows scatter, where more is known of it than what the table states.
    """
    table = situation.view.table
    scales, extent = scales_of(situation.view), extent_of(situation.view)
    taken = frozenset(model.parameters)
    rigid = all(p.is_joint for p in model.compliances)
    there = {key_of(e.effect, e.where) for e in model.effects}
    basis = column_space(problem.A / spread_of(situation.view)[:, None])
    for effect in effects:
        why = _missing(effect, table)
        places = effect.places(model.robot) if effect.places_in is None else effect.places_in(situation)
        for where in places:
            reason = why or ("the model has it" if key_of(effect.identifier, where) in there else "")
            grown = any(dict(e.where) == dict(where) for e in model.effects)
            reason = reason or ("" if grown else effect.unlikely(model.robot, where, rigid))
            shapes = () if reason else effect.shapes(model.robot, where, scales)
            if not shapes:
                reason = reason or "the table does not hold what it depends on"
                yield _unavailable(effect, where, reason)
                continue
            columns = _Columns(situation, effect, where, taken, extent)
            yield _candidate(model, columns, shapes, problem, basis, noise)


def _candidate(
    model: StiffnessModel, columns: _Columns, shapes: Sequence[Shape], problem: Problem, basis: Array,
    noise: Noise | None,
) -> Candidate:  # fmt: skip
    """An effect at a place with the shapes that these data can tell of, or the reason why they show it in none."""
    effect, where = columns.effect, columns.where
    every = _members(columns, shapes)
    members = _sound(columns, every)
    first = (members or every)[0].parameters
    unseen = (
        _unseen(columns, members, basis, columns.situation.view)
        if members
        else "its law gives no finite number in these data"
    )
    if unseen:
        return _unavailable(effect, where, unseen, first)
    small, members = _below_noise(columns, members, problem, noise)
    if not members:
        reason = "its known size is below the noise: it is counted as it is"
        return replace(_unavailable(effect, where, reason, first), counted=small)
    kept = tuple(m.shape for m in members)
    return Candidate(
        effect.identifier, where, first, columns, kept, _weights(effect, model.robot, kept),
        parameters_of=None if all(m.parameters == first for m in members) else columns.parameters,
        driven=columns.driven, assumed=frozenset(effect.assumed), moves=columns.moves,
        expected=bool(members[0].realised.nominal),
        kin=any(e.effect == effect.identifier and site(e.where) == site(where) for e in model.effects),
    )  # fmt: skip


def _weights(effect: Effect, robot: Robot, shapes: Sequence[Shape]) -> tuple[float, ...]:
    """Prior weights of shapes: ways to assume what is not known share the weight of one, the robot file tells odds."""
    shared = 1.0 / max(len(effect.assumed), 1)
    return tuple(
        effect.odds(robot, shape) * (shared if effect.assumed.keys() & shape.keys() else 1.0)
        for shape in shapes
    )


@dataclass(frozen=True, eq=False)
class _Member:
    """One shape of an effect at a place, with the parameters that the model does not have yet."""

    shape: Shape
    realised: Realisation
    parameters: tuple[Parameter, ...]


def _member(
    effect: Effect, robot: Robot, where: Where, shape: Shape, taken: frozenset[str], extent: Extent
) -> _Member:
    place = tuple((key, tuple(v) if isinstance(v, list) else v) for key, v in where.items())
    realised = _realised(effect.realise, robot, place, tuple(shape.items()))
    own = tuple(
        Parameter(p.name, p.unit, p.low, p.high, p.typical)
        for p in at_size(realised.parameters, extent)
        if p.name not in taken
    )
    return _Member(shape, realised, own)


@lru_cache(maxsize=_KEPT)
def _realised(
    realise: Callable[[Robot, Where, Shape], Realisation], robot: Robot, place: tuple[tuple[str, Any], ...],
    shape: tuple[tuple[str, float], ...],
) -> Realisation:  # fmt: skip
    """What a second look, the held-out poses and the benchmark ask for again; it takes SymPy some milliseconds."""
    where = {key: list(value) if isinstance(value, tuple) else value for key, value in place}
    return realise(robot, where, dict(shape))


def _unavailable(
    effect: Effect, where: Where, reason: str, parameters: tuple[Parameter, ...] = ()
) -> Candidate:
    return Candidate(effect.identifier, where, parameters, lambda shape: np.zeros((0, 0)), unavailable=reason)


@dataclass(frozen=True, eq=False)
class _Columns:
    """The columns of one effect at one place, by shape; each shape is computed once."""

    situation: Situation
    effect: Effect
    where: Where
    taken: frozenset[str]
    """Parameters that the model has already."""
    extent: Extent
    """Of the experiment, for the parameters' ranges."""
    _made: dict[tuple[tuple[str, float], ...], _Member] = field(default_factory=dict)
    _seen: dict[tuple[tuple[str, float], ...], Array] = field(default_factory=dict)

    def __call__(self, shape: Shape) -> Array:
        key = tuple(shape.items())
        if key not in self._seen:
            self._seen[key] = self._computed(self.member(shape))
        return self._seen[key]

    def member(self, shape: Shape) -> _Member:
        """The effect with a shape."""
        key = tuple(shape.items())
        if key not in self._made:
            self._made[key] = _member(self.effect, self._robot, self.where, shape, self.taken, self.extent)
        return self._made[key]

    def parameters(self, shape: Shape) -> tuple[Parameter, ...]:
        """The parameters of a shape's columns."""
        return self.member(shape).parameters

    def moves(self, shape: Shape) -> Mapping[str, Move]:
        """How a shape's values are moved."""
        return self.effect.moves(self._robot, shape)

    def driven(self, shape: Shape) -> frozenset[str] | None:
        """What a shape's law depends on beside loads; unknown for what is no law."""
        if self.effect.columns is not None:
            return None
        terms = self.member(shape).realised.terms
        symbols = {symbol for term in terms for symbol in term.factor.free_symbols}
        bodies = range(self._robot.dof + 1)
        angles = {q(k) for k in bodies} | {up(k, axis) for k in bodies for axis in (1, 2, 3)}
        found = {ANGLE: angles, CLOCK: {TIME, TEMPERATURE}, HISTORY: {BRANCH, TURN}}
        return frozenset(name for name, some in found.items() if symbols & some)

    @property
    def _robot(self) -> Robot:
        return self.situation.view.robot

    def _computed(self, member: _Member) -> Array:
        names = tuple(p.name for p in member.parameters)
        if self.effect.columns is None:
            return self.situation.columns(member.realised.terms, names)
        block = self.effect.columns(self.situation, self.where, member.shape)
        chosen = [k for k, p in enumerate(member.realised.parameters) if p.name in names]
        return np.asarray(block[:, chosen], dtype=float)


def _members(columns: _Columns, shapes: Sequence[Shape]) -> list[_Member]:
    """An effect with each of its shapes; the laws of a plugin's other shapes are checked as it gives them."""
    try:
        members = [columns.member(shape) for shape in shapes]
        check_laws(members[0].realised.terms, columns.situation.view.robot)
    except UserError as error:
        raise UserError(f"{columns.effect.identifier} at {dict(columns.where)}: {error}") from error
    return members


def _sound(columns: _Columns, members: Sequence[_Member]) -> list[_Member]:
    """The shapes whose columns are numbers, as the catalogue's all are."""
    if not is_brought(columns.effect):
        return list(members)
    with np.errstate(all="ignore"):
        return [m for m in members if not m.parameters or np.isfinite(columns(m.shape)).all()]


def _unseen(columns: _Columns, members: Sequence[_Member], basis: Array, view: View) -> str:
    """Why these data cannot show what the model does not have of an effect; empty if they can."""
    if not members[0].parameters:
        return "the model has all of its parameters"
    if not any(columns(m.shape).any() for m in members):
        return "nothing in these data moves it"
    return "its columns are combinations of the model's" if _inside(columns, members, basis, view) else ""


def _inside(columns: _Columns, members: Sequence[_Member], basis: Array, view: View) -> bool:
    """Whether the current model's columns contain all of the candidate's."""
    weight = 1.0 / spread_of(view)
    for member in members:
        block = columns(member.shape) * weight[:, None]
        left = block - basis @ (basis.T @ block)
        if np.any(np.einsum("mk,mk->k", left, left) > _LEFT * np.einsum("mk,mk->k", block, block)):
            return False
    return True


def _below_noise(
    columns: _Columns, members: Sequence[_Member], problem: Problem, noise: Noise | None
) -> tuple[Array | None, list[_Member]]:
    """What an effect of known size adds (M,) in its plainest form, and the shapes of which enough is outside the model
    to be seen: all where a size is not known.
    """
    if not all(m.realised.nominal for m in members):
        return None, list(members)
    signals = [
        columns(m.shape) @ [m.realised.nominal.get(p.name, 0.0) for p in m.parameters] for m in members
    ]
    shown = (_noncentrality(signal, problem, noise) >= _VISIBLE for signal in signals)
    return np.asarray(signals[0]), [m for m, one in zip(members, shown, strict=True) if one]


def _noncentrality(signal: Array, problem: Problem, noise: Noise | None) -> float:
    """How much of a signal (M,) is outside the model, squared, in units of the noise.

    That is what is left, and no more than was stated: something may be missing.
    """
    rows = np.column_stack([signal, problem.y, problem.A])
    if problem.sigma is not None:
        weighed = rows / problem.sigma[:, None]
    elif noise is not None:
        weighed = noise.weigh(rows)
    else:
        return np.inf
    basis = column_space(weighed[:, 2:])
    left = weighed[:, :2] - basis @ (basis.T @ weighed[:, :2])
    size, rest = np.sum(left**2, axis=0).tolist()
    found = rest / max(problem.rows - basis.shape[1], 1)
    scale = found if problem.sigma is None else min(found, 1.0)
    return float(size / scale) if scale > 0 else np.inf


def scales_of(view: View) -> Scales:
    """The experiment's sizes, over which shapes are profiled."""
    table = view.table
    load, total = _largest(view, view.tau), {}
    if table.kind == "deflection" and view.robot.has_weights:
        both = _largest(view, under_weights(view).tau)
        total = {v: size for v, size in both.items() if load[v]}
    angles = []
    poses = len(np.unique(table.pose))
    for j in range(table.dof):
        levels = levels_of(table.q[:, j])
        angles.append(tuple(levels.tolist()) if 2 * len(levels) <= poses else ())
    context, lowest = {}, {}
    for name, values in (("time", table.time), ("temperature", table.temperature)):
        if np.isfinite(values).any():
            low, high = float(np.nanmin(values)), float(np.nanmax(values))
            # a clock that starts at the session's own begin counts from 0; another one from where it stands then
            lowest[name] = 0.0 if name == "time" and 0.0 <= low <= _AT_ONCE * (high - low) else low
            if high > low:
                context[name] = high - lowest[name]
    unloaded = float(np.mean(~table.w.any(axis=1)))
    return Scales(table.kind, load, tuple(angles), context, lowest, total, unloaded)


def _largest(view: View, tau: Array) -> dict[VirtualJoint, float]:
    """Largest loads on the joints, 0 for those that hardly bear any."""
    largest = np.max(np.abs(tau), axis=0)
    largest[largest < UNLOADED * np.max(largest)] = 0.0
    return {v: float(largest[k]) for k, v in enumerate(view.joints) if v.kind == "joint"}


def _missing(effect: Effect, table: Measurements) -> str:
    """Why this table cannot show the effect; empty if it can."""
    if table.kind not in effect.seen_in:
        return f"cannot be seen in {table.kind} data"
    available = {
        "time": _varies(table.time),
        "temperature": _varies(table.temperature),
        "branch": bool((table.branch > 0).any() and (table.branch < 0).any()),
    }
    for need in sorted(effect.needs):
        if not any(available.get(name, False) for name in need.split(" or ")):
            return f"needs {need.replace('_', ' ')}, which the table does not hold"
    return ""


def _varies(values: Array) -> bool:
    """Whether a column (N,) is told, and not the same in all rows."""
    return bool(np.isfinite(values).any() and np.nanmax(values) > np.nanmin(values))
