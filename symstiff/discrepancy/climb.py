"""The ladder from rigid links to the complete model, where no few links account for what the joints leave."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import stats

from symstiff.arrays import Index
from symstiff.calibration.experiment.readings import ExperimentClass
from symstiff.calibration.identify import start_model
from symstiff.discrepancy.finding import Found, Task
from symstiff.discrepancy.result import Diagnosis, Quantity
from symstiff.discrepancy.verdict import AMBIGUOUS, INSUFFICIENT, NAMED, UNEXPLAINED
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import catalogue
from symstiff.model import StiffnessModel
from symstiff.reduction.physical import physical_stages
from symstiff.robot.schema import Robot

_SIGNIFICANT = 1e-3
"""Chance below which the complete model takes the place of few links that were named."""


def wider_model(
    model: StiffnessModel, found: Diagnosis, task: Task, experiment: ExperimentClass
) -> StiffnessModel | None:
    """The complete model, where links are rigid in this one and elastic links are what is missing, few or not."""
    rigid = all(p.is_joint for p in model.compliances) and not model.effects
    if not rigid or task.max_effects < 2:
        return None
    tested = [c.parameters for c in found.candidates if c.testable][:1]
    parts = {NAMED: [sizes for *_, sizes in found.leading], UNEXPLAINED: tested, INSUFFICIENT: tested}
    parts[AMBIGUOUS] = parts[NAMED]
    missing = parts.get(found.verdict, [])
    if not missing or not all(_is_compliance(task.robot, sizes) for sizes in missing):
        return None
    wider = start_model(model.robot, "complete", experiment)[
        0
    ]  # whose tool is where the measured point was found
    return replace(wider, file_tool=model.file_tool)


def leaves_less(wide: Diagnosis, narrow: Diagnosis, component: Index) -> bool:
    """Whether the complete model leaves less than the narrow one, also on poses left out where there are any.

    Of a narrow one with links that were named it has to leave significantly less: few links are the simpler account.
    component: (M,) 0 … 5 of each row.
    """
    one, other = wide.rms, narrow.rms
    own, others = one.held_out_before, other.held_out_before
    if narrow.verdict in (NAMED, AMBIGUOUS):
        others = other.held_out_after
        if not _chance(wide, narrow, component) < _SIGNIFICANT:
            return False
    elif not one.before < other.before or _told_by_a_law(wide, narrow, component):
        return False
    return own is None or others is None or own < others


def _told_by_a_law(wide: Diagnosis, narrow: Diagnosis, component: Index) -> bool:
    """Whether a law at no virtual joint, such as a device's, is the simpler account by Schwarz' criterion."""
    law = narrow.device_law
    if law is None:
        return False
    spread = wide.noise.by_component()[component]
    last, first = narrow.growth[0], wide.growth[0]
    left, less = (float(np.sum((step.residual / spread) ** 2)) for step in (last, first))
    more = int(np.isfinite(first.model_std).sum() - np.isfinite(last.model_std).sum()) - len(law.terms)
    rows = len(component)
    return bool(rows * np.log(less / (left * (1.0 - law.explained))) + more * np.log(rows) > 0)


def _chance(wide: Diagnosis, narrow: Diagnosis, component: Index) -> float:
    """p-value of what the complete model explains beyond links that were named, an F test of nested models."""
    spread = wide.noise.by_component()[component]
    last, first = narrow.growth[-1], wide.growth[0]
    left, less = (float(np.sum((step.residual / spread) ** 2)) for step in (last, first))
    known = int(np.isfinite(first.model_std).sum())
    fewer = int(np.isfinite(narrow.growth[0].model_std).sum()) + last.gained
    freedom = len(component) - known
    if known <= fewer or freedom <= 0:
        return 1.0
    return float(stats.f.sf((left - less) / (known - fewer) / (less / freedom), known - fewer, freedom))


def links_of(found: Diagnosis, wider: StiffnessModel) -> tuple[Found, ...]:
    """The links of the complete model, fitted, as effects of the verdict."""
    estimates = {
        n: Quantity(value, wider.deviations.get(n, np.inf), wider.units[n])
        for n, value in wider.values.items()
    }
    out = []
    for link in sorted({p.body for p in wider.compliances if not p.is_joint}):
        own = {n: e for n, e in estimates.items() if n.startswith(f"k{link}_")}
        effect = that_has(wider.robot, {"link": link}, own)
        if own and effect:
            out.append(Found(effect, {"link": link}, {}, own, found.p_missing, _certain(found.p_missing), ()))
    return tuple(out)


def that_has(robot: Robot, where: Mapping[str, Any], parameters: Iterable[str]) -> str:
    """The effect of the catalogue that has these parameters at a place, and the fewest beside them."""
    wanted, sizes = set(parameters), dict[str, int]()
    for identifier, effect in catalogue().items():
        if effect.columns is None and any(dict(place) == where for place in effect.places(robot)):
            held = {p.name for p in EffectInstance(identifier, where).realise(robot).parameters}
            if wanted <= held:
                sizes[identifier] = len(held)
    return min(sizes, key=lambda e: sizes[e], default="")


def _certain(p: float) -> float:
    """Confidence in a step that is a test of nested models: no rival competes for its name."""
    return float(min(max(1.0 - p, 0.0), 0.99))


def _is_compliance(robot: Robot, parameters: Mapping[str, Any]) -> bool:
    """Whether an effect's parameters are all compliances of the robot's complete model."""
    known = {p.name for stage in physical_stages(robot) for p in stage.parameters}
    return bool(parameters) and set(parameters) <= known
