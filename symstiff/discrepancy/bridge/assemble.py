"""The bridge: from a model and a measurement table to the statistics' rows, columns and candidates.

Stages: view (geometry, loads) → placement of the device, where positions are absolute → current model's
columns and fitted deflections → problem → candidates of the whole catalogue at all places.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.arrays import TINY, Array, Mask, numbered
from symstiff.calibration.experiment.current import Current, settled, sigma_of
from symstiff.calibration.experiment.situation import Situation, View, loads_of, under_weights
from symstiff.calibration.tables.checks import check_measured, check_robot
from symstiff.calibration.tables.loading import load_factor
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.candidates import UNLOADED
from symstiff.discrepancy.bridge.candidates import candidates as candidates_of
from symstiff.discrepancy.bridge.groups import grouped, structural
from symstiff.discrepancy.laws.devices import DeviceLaws
from symstiff.discrepancy.noise.scales import Noise
from symstiff.discrepancy.problem import Candidate, Problem
from symstiff.effects.base import Effect
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import catalogue
from symstiff.model import StiffnessModel
from symstiff.symbolic.terms import VirtualJoint

_NONE = 0.05
"""Least load, as a factor, and least distance [m] that the noise may grow with: logarithms are taken of them."""
_SAME_LOAD = 1e-3
"""Difference of loads, against the largest, up to which they are one."""


@dataclass(frozen=True)
class Assembly:
    """A problem with the candidates for it, and what they were made from.

    ``names`` are the parameters of the problem's columns; ``fitted`` their values (the current model's
    where the data do not tell). Candidates that cannot be told from the model are ``unavailable``.
    """

    problem: Problem
    candidates: tuple[Candidate, ...]
    situation: Situation
    names: tuple[str, ...]
    fitted: dict[str, float]


def assemble(
    model: StiffnessModel, table: Measurements, effects: Sequence[Effect] | None = None,
    noise: Noise | None = None, believed: StiffnessModel | None = None,
) -> Assembly:  # fmt: skip
    """Put the problem and the candidates of the catalogue (or of ``effects``) together.

    ``noise`` is how the rows scatter, where more is known of it than what the table states.
    ``believed`` is the model with effects that it lacks, and with values: candidates' laws see the loads that those
    add, loads act on its compliances, and the arm stands as they say. Raises UserError where table and robot do not
    fit, or nothing was measured.
    """
    check_robot(table, model.robot)
    check_measured(table)
    found = catalogue().values() if effects is None else effects
    weigh = None if noise is None else noise.weigh
    fuller = None if believed is None else settled(believed, table, weigh)
    current = settled(model, table, weigh, fuller.arm if fuller else None)
    situation = _believing(current.situation, fuller.situation) if fuller else current.situation
    problem = _problem(situation, current)
    candidates = grouped(problem, tuple(candidates_of(model, situation, problem, found, noise)))
    small = [c.counted for c in candidates if c.counted is not None]
    problem = replace(problem, y=problem.y - np.sum(small, axis=0)) if small else problem
    candidates = structural(model, situation, candidates)
    fitted = {n: current.fitted[n] for n in model.parameters if n in current.fitted}
    return Assembly(problem, candidates, situation, current.names, fitted)


def added_loads(view: View, instance: EffectInstance, values: Mapping[str, float]) -> Array | float:
    """(N, V) loads that an effect adds on the virtual joints; 0 where it acts on no load."""
    loads = loads_of(view, instance.realise(view.robot).terms)
    return sum((values.get(name, 0.0) * load for name, load in loads.items()), 0.0)


def _believing(situation: Situation, fuller: Situation) -> Situation:
    """The situation with the compliances of a fuller model and, where the table has loads, those of its effects."""
    view, laws = situation.view, situation.laws
    seen = np.where(_loaded(view.tau), fuller.view.more, view.more)
    numbers = {name: fuller.laws.numbers.get(name, value) for name, value in laws.numbers.items()}
    return Situation(replace(view, more=seen), replace(laws, numbers=numbers))


def _carried(loads: Array) -> Array:
    """Loads (N, V) but the rounding on virtual joints that carry none, of which laws would make columns by chance."""
    return np.where(_loaded(loads), loads, 0.0)


def _loaded(loads: Array) -> Mask:
    """Virtual joints (V,) of which the loads (N, V) are more than rounding."""
    largest = np.max(np.abs(loads), axis=0, initial=0.0)
    return np.asarray(largest > UNLOADED * np.max(largest, initial=0.0))


def _problem(situation: Situation, current: Current) -> Problem:
    view = situation.view
    table, state = view.table, view.state
    pose, point = numbered(table.pose), numbered(table.point)
    return Problem(
        y=current.y,
        A=current.A,
        pose=pose[state],
        case=_load_cases(table, pose)[state],
        channel=point[state] * 6 + view.component,
        axis=np.array(view.component, dtype=np.intp),
        sigma=sigma_of(view),
        load=load_factor(table)[state],
        J=view.J,
        tau=_carried(view.tau + view.more)[state],
        weight=_weight(view),
        devices=DeviceLaws(situation),
        markers=tuple(table.points[k] for k in np.unique(table.point[state])),
        virtual_joints=tuple(_title(v) for v in view.joints),
        joint_of=tuple(v.body - 1 if v.kind == "joint" else -1 for v in view.joints),
        slides=tuple(i for i, j in enumerate(view.robot.joint) if j.type == "prismatic"),
        q=table.q[state],
        time=_context(table.time, state),
        temperature=_context(table.temperature, state),
        branch=_context(table.branch, state),
        turn=table.visit[state],
        file=table.file[state],
        files=table.files,
        differences=table.kind == "deflection",
        spread=_spreads(view),
    )


def _load_cases(table: Measurements, pose: np.ndarray) -> np.ndarray:
    """(N,) number of each row's load case within its pose, in the order of the table.

    A sensor reads the same load a little different each time: what agrees to a thousandth of the largest is one load.
    """
    largest = [np.abs(part).max(initial=0.0) for part in (table.w[:, :3], table.w[:, 3:])]
    loads = table.w / (_SAME_LOAD * np.repeat(np.maximum(largest, TINY), 3))
    keys = np.column_stack([loads, np.nan_to_num(table.branch), np.nan_to_num(table.load_step)])
    case = np.zeros(len(table), dtype=np.intp)
    for p in np.unique(pose):
        rows = np.flatnonzero(pose == p)
        _, first, number = np.unique(keys[rows], axis=0, return_index=True, return_inverse=True)
        known, own = list[np.ndarray](), np.zeros(len(first), dtype=np.intp)
        for k in np.argsort(first):
            key = keys[rows[first[k]]]
            own[k] = next((n for n, other in enumerate(known) if np.abs(key - other).max() < 1.0), len(known))
            known += [key] if own[k] == len(known) else []
        case[rows] = own[number.reshape(-1)]
    return case


def _weight(view: View) -> Array | None:
    """Loads (M, V) of the links' weight where the robot tells masses; in absolute data τ holds them already."""
    if view.table.kind != "deflection" or not view.robot.has_weights:
        return None
    return _carried(under_weights(view).tau - view.tau)[view.state]


def _title(v: VirtualJoint) -> str:
    return f"joint {v.body}" if v.kind == "joint" else f"link {v.body} axis {v.axis}"


def _context(values: Array, state: np.ndarray) -> Array | None:
    return np.nan_to_num(values)[state] if np.isfinite(values).any() else None


def _spreads(view: View) -> dict[str, Array]:
    found: dict[str, Array] = {}
    load = np.abs(load_factor(view.table))
    if np.ptp(load) > 0:
        found["load"] = np.maximum(load, _NONE)[view.state]
    if view.table.kind == "absolute":
        found["distance"] = np.maximum(np.linalg.norm(view.table.values[:, :3], axis=1), _NONE)[view.state]
    return found
