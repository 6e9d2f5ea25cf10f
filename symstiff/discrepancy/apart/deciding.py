"""Poses and loads that would tell rival explanations apart: T-optimal choice over the joint range."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from symstiff.arrays import TINY, Array, Index
from symstiff.calibration.experiment.placement import placement_columns
from symstiff.calibration.experiment.situation import Laws, Situation, look, under_weights
from symstiff.calibration.fits.decomposition import RANK, column_space
from symstiff.calibration.tables.loading import load_factor
from symstiff.calibration.tables.measurements import Measurements, concatenate, measurements
from symstiff.discrepancy.apart.separation import Decider, Hypotheses, deciding_poses
from symstiff.discrepancy.bridge.candidates import scales_of
from symstiff.discrepancy.bridge.growth import columns_of
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.model import StiffnessModel
from symstiff.threads import one_thread

if TYPE_CHECKING:
    from symstiff.calibration.planning.region import Region

OFFERED = 300
"""Configurations over the joint limits from which the deciding ones are chosen."""
_WEAK = 0.5
"""Second load level, where the effects are to be told apart by several."""
_SMALL = 0.1
"""Level at which gaps and bends near zero load show, where levels of load are measured at all."""
_SAME_LEVEL = 1e-3
"""Difference of two levels, as a share of the largest load, up to which they are one."""
_LEVELS = 3
"""Load levels of a pose from which no more are added."""
_DIRECTIONS, _ALIKE = 3, 0.9
"""Directions of loads that are looked at in turn, and the cosine from which two are one."""
_SHAPES = 10
"""Shapes of an effect's law, besides its own, that a rival may fit with."""

_STEPS = {False: float(np.radians(0.1)), True: 1e-4}
"""Steps of the joint variables of deciding poses [rad, m], by whether the joint slides."""
_LABEL = "decide"
"""What the labels of deciding poses begin with."""


@dataclass(frozen=True)
class Rival:
    """One explanation: its effects, and its parameters' values."""

    effects: tuple[EffectInstance, ...]
    values: Mapping[str, float]


@dataclass(frozen=True)
class Setup:
    """How the next poses can be measured: markers, what is read, load cases of every pose (k, 6) [N, N·m]."""

    kind: str
    points: tuple[str, ...]
    components: tuple[int, ...]
    loads: Array
    branches: tuple[float, ...] = (float("nan"),)
    joint_units: tuple[str, ...] = ()


@dataclass(frozen=True)
class Choice:
    """How many poses: at most ``most``; from ``least`` on until D_ij reaches ``enough``; where; drawn with ``seed``."""

    most: int
    least: int = 1
    enough: float = float("inf")
    seed: int = 0
    offered: int = OFFERED
    region: Region | None = None
    used: tuple[str, ...] = ()
    """Labels of other poses, that no new one may have."""


def setups_like(table: Measurements) -> list[Setup]:
    """The setups that a table's poses came from: its markers, components, and the loads of its richest poses.

    Of poses with as many levels of load those whose loads point in unlike directions, a few, whatever their order.
    """
    share = np.round(np.abs(load_factor(table)), 6)
    poses = np.unique(table.pose)
    levels = [len(np.unique(share[table.pose == p])) for p in poses]
    cases = [
        np.unique(np.round(table.w[table.pose == p], 9), axis=0)
        for p, count in zip(poses, levels, strict=True)
        if count == max(levels)
    ]
    both = (table.branch > 0).any() and (table.branch < 0).any()
    like = Setup(
        table.kind, table.points, tuple(int(k) for k in np.flatnonzero(table.measured.any(axis=0))), cases[0],
        (1.0, -1.0) if both else (float("nan"),), table.joint_units,
    )  # fmt: skip
    return [replace(like, loads=_with_levels(loads)) for loads in _unlike(cases)]


def _unlike(cases: Sequence[Array]) -> list[Array]:
    """Load cases (k, 6) whose largest loads point in unlike directions, each the most unlike those before it."""
    ordered = sorted(cases, key=lambda loads: (-len(loads), loads.tolist()))
    largest = np.array([loads[np.argmax(np.linalg.norm(loads, axis=1))] for loads in ordered])
    size = np.linalg.norm(largest, axis=1)
    along = np.abs(largest @ largest.T) / np.maximum(np.outer(size, size), TINY)
    found = [0]
    while len(found) < _DIRECTIONS:
        alike = along[found].max(axis=0)
        if alike.min() > _ALIKE:
            break
        found.append(int(np.argmin(alike)))
    return [ordered[k] for k in found]


def _with_levels(loads: Array) -> Array:
    """Load cases (k, 6) and half of the largest where they have fewer than three levels, a tenth where none is small.

    Near small loads gaps and stiff gears differ.
    """
    largest = loads[np.argmax(np.linalg.norm(loads, axis=1))]
    if not largest.any():
        return loads
    levels = np.unique(np.round(np.abs(loads @ largest) / (largest @ largest), 6))
    added = [_WEAK] if len(levels) < _LEVELS else []
    if len(levels) > 1 and levels[levels > 0].min() > 2 * _SMALL:
        added.append(_SMALL)
    added = [level for level in added if not np.any(np.abs(levels - level) < _SAME_LEVEL)]
    return np.vstack([loads, *(level * largest[None] for level in added)])


@one_thread()
def decide_poses(
    model: StiffnessModel, rivals: Sequence[Rival], setup: Setup, sigma: Array, choice: Choice,
    taken: Measurements | None = None, tell: Callable[[str], None] = lambda stage: None,
) -> tuple[Measurements, Decider]:  # fmt: skip
    """A table of poses with their loads that tells the rivals apart, and how far it does, with the data taken.

    ``model`` has its fitted values; ``sigma`` (6,) is the noise of a component [m, rad]. Every rival may fit with
    other shapes of its laws than the one that was named.
    """
    offered = _on_offer(model, setup, choice)
    offered = offered if taken is None else _of_another_file(model, _at_the_end(offered, taken))
    table = offered if taken is None else concatenate([taken, offered])
    new = np.zeros(len(table), dtype=bool)
    new[len(table) - len(offered) :] = True
    tell("deciding poses: predictions")
    found = _hypotheses(model, rivals, table, sigma)
    state, _ = np.nonzero(table.measured)
    found = _closest(found, found if taken is None else found.rows(~new[state]))
    have = None if taken is None else found.rows(~new[state])
    best = deciding_poses(
        found.rows(new[state]), table.pose[state][new[state]], 1.0, choice.most, have, choice.least,
        choice.enough, tell,
    )  # fmt: skip
    used = choice.used if taken is None else (*choice.used, *taken.labels)
    return _chosen(table, best, used), best


def decide_by(
    setups: Sequence[Setup], model: StiffnessModel, rivals: Sequence[Rival], sigma: Array, choice: Choice,
    taken: Measurements, tell: Callable[[str], None] = lambda stage: None,
) -> tuple[Setup, Measurements, Decider]:  # fmt: skip
    """As ``decide_poses``, by the first setup that tells the rivals apart well enough, else by the best."""
    found = []
    for setup in setups:
        found.append((setup, *decide_poses(model, rivals, setup, sigma, choice, taken, tell)))
        if max(found[-1][2].separation, default=0.0) >= choice.enough:
            return found[-1]
    return max(found, key=lambda one: max(one[2].separation, default=0.0))


def _chosen(table: Measurements, best: Decider, used: Sequence[str]) -> Measurements:
    """The chosen poses with labels that the data do not have yet, without readings."""
    ends = (label.removeprefix(_LABEL) for label in used if label.startswith(_LABEL))
    first = 1 + max((int(end) for end in ends if end.isdigit()), default=0)
    rows = np.concatenate([np.flatnonzero(table.pose == p) for p in best.poses] or [np.zeros(0, np.intp)])
    chosen = table.select(rows)
    number = {p: k for k, p in enumerate(best.poses)}
    return replace(
        chosen, kind="none", values=np.full((len(rows), 6), np.nan),
        time=np.full(len(rows), np.nan), temperature=np.full(len(rows), np.nan),
        sigma=np.full((len(rows), 6), np.nan),
        labels=tuple(f"{_LABEL}{k + first}" for k in range(len(best.poses))),
        pose=np.array([number[int(p)] for p in chosen.pose], dtype=np.intp),
    )  # fmt: skip


def names_of(model: StiffnessModel, rival: Rival) -> list[str]:
    """Parameters that a rival adds to the model."""
    realised = [e.realise(model.robot) for e in rival.effects]
    names = dict.fromkeys(p.name for r in realised for p in r.parameters)
    return [n for n in names if n not in model.parameters]


def _hypotheses(
    model: StiffnessModel, rivals: Sequence[Rival], table: Measurements, sigma: Array
) -> Hypotheses:
    """The model's columns on a table's measured rows, the device's placement included, and each rival's."""
    view = look(model.robot, table)
    if table.kind == "absolute" and model.robot.has_weights:
        view = under_weights(view)
    situation = Situation(view, Laws(view, model.terms, dict(model.values)))
    A = situation.columns(model.terms, list(model.parameters))
    A = np.hstack([A, placement_columns(view, probe=model.file_tool is not None)])
    weight = (1.0 / sigma[view.component])[:, None]
    scales, known = scales_of(view), _Laws(situation, model)
    blocks = tuple(
        tuple(known.block(effects) for effects in (rival.effects, *_other_shapes(model, rival, scales)))
        for rival in rivals
    )
    laws = weight * known.columns
    values = [np.array([rival.values.get(n, 0.0) for n in names_of(model, rival)]) for rival in rivals]
    signals = [laws[:, own[0]] @ value for own, value in zip(blocks, values, strict=True)]
    return Hypotheses(weight * A, np.stack(signals, axis=1), laws, blocks)


def _other_shapes(
    model: StiffnessModel, rival: Rival, scales: Scales
) -> list[tuple[EffectInstance, ...]]:  # fmt: skip
    """The rival with one of its effects in another shape, for every effect and shape of the catalogue."""
    out = []
    for k, effect in enumerate(rival.effects):
        for shape in find(effect.effect).shapes(model.robot, effect.where, scales):
            if dict(shape) != dict(effect.shape):
                other = replace(effect, shape=dict(shape))
                out.append((*rival.effects[:k], other, *rival.effects[k + 1 :]))
    return out


@dataclass
class _Laws:
    """The columns of effects at their shapes, each computed once."""

    situation: Situation
    model: StiffnessModel
    found: list[Array] = field(default_factory=list)
    """Columns (M, k), one after the other."""
    place: dict[str, Index] = field(default_factory=dict)
    """Their numbers."""

    @property
    def columns(self) -> Array:
        """(M, L) all that were asked for."""
        return np.hstack(self.found)

    def block(self, effects: Sequence[EffectInstance]) -> Index:
        """Numbers (k,) of the columns of an explanation's own parameters."""
        parts, seen = [], set(self.model.parameters)
        for effect in effects:
            own = [p.name for p in effect.realise(self.model.robot).parameters if p.name not in seen]
            seen |= set(own)
            key = f"{effect.effect} {effect.where} {sorted(effect.shape.items())} {own}"
            if key not in self.place:
                first = sum(part.shape[1] for part in self.found)
                self.found.append(columns_of(self.situation, effect, own))
                self.place[key] = first + np.arange(len(own))
            parts.append(self.place[key])
        return np.concatenate(parts)


def _closest(columns: Hypotheses, judge: Hypotheses) -> Hypotheses:
    """Each rival in its own shape and in those that say most nearly the same on some rows: the data's, if any."""
    basis = column_space(judge.model)
    signals, laws = (x - basis @ (basis.T @ x) for x in (judge.signals, judge.laws))
    kept = []
    for k, rival in enumerate(columns.blocks):
        missed = [_missed(signals[:, k], laws[:, block]) for block in rival[1:]]
        order = sorted(range(len(missed)), key=lambda i: (missed[i], i))[:_SHAPES]
        kept.append((rival[0], *(rival[1 + i] for i in order)))
    return columns.of(tuple(kept))


def _missed(signal: Array, outside: Array) -> float:
    """Squared length of a signal outside a block."""
    fitted = outside @ np.linalg.lstsq(outside, signal, rcond=RANK)[0]
    return float(np.sum((signal - fitted) ** 2))


def _on_offer(model: StiffnessModel, setup: Setup, choice: Choice) -> Measurements:
    """Configurations over the joint limits, each under every load case, branch and marker."""
    from symstiff.calibration.planning import Load, Space, geometry
    from symstiff.calibration.planning.candidates import draw
    from symstiff.calibration.planning.region import Region

    space = Space(geometry(model.robot), Load(), choice.region or Region())
    q = _round(model, space.limits, draw(space, choice.offered, choice.seed).q)
    cases = [(w, b, p) for w in setup.loads for b in setup.branches for p in range(len(setup.points))]
    values = np.full((len(cases), 6), np.nan)
    values[:, list(setup.components)] = 0.0
    return measurements(
        np.repeat(q, len(cases), axis=0),
        np.tile(np.array([w for w, _, _ in cases]), (len(q), 1)),
        labels=[f"offered {k + 1}" for k in range(len(q))],
        pose=np.repeat(np.arange(len(q)), len(cases)),
        points=setup.points,
        point=np.tile([p for _, _, p in cases], len(q)),
        kind="absolute" if setup.kind == "absolute" else "deflection",
        values=np.tile(values, (len(q), 1)),
        branch=np.tile([b for _, b, _ in cases], len(q)),
        joint_units=setup.joint_units or None,
    )


def _at_the_end(offered: Measurements, taken: Measurements) -> Measurements:
    """What is offered at the time and warmth that the data ended with: a session that goes on."""
    known = np.flatnonzero(np.isfinite(taken.time))
    last = known[np.argmax(taken.time[known])] if len(known) else -1
    time, warmth = (np.full(len(offered), column[last]) for column in (taken.time, taken.temperature))
    return replace(offered, time=time, temperature=warmth)


def _of_another_file(model: StiffnessModel, offered: Measurements) -> Measurements:
    """What is offered as a file of its own is read: positions from a place of the device that is found anew."""
    view = look(model.robot, offered)
    seen = np.hstack([view.points, np.zeros((len(offered), 3))])
    values = np.where(offered.measured, seen if offered.kind == "absolute" else 0.0, np.nan)
    return replace(offered, values=values, files=("offered",))


def _round(model: StiffnessModel, limits: Sequence[tuple[float, float]], q: Array) -> Array:
    """Joint variables that a person can type: tenths of degrees and of millimetres, within the limits."""
    step = np.array([_STEPS[j.prismatic] for j in model.robot.joint])
    low, high = np.array(limits).T
    rounded = np.round(q / step) * step
    return np.asarray(np.where((rounded >= low) & (rounded <= high), rounded, q))


def several_levels(load: Array) -> Array:
    """A load and half of it: what tells laws that are not proportional to the load from those that are."""
    return np.stack([load, _WEAK * load])
