"""The ladder from rigid links to the complete model, where no few links account for what the joints leave."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from symstiff.calibration.experiment.readings import ExperimentClass
from symstiff.calibration.identify import start_model
from symstiff.discrepancy.finding import Found, Task
from symstiff.discrepancy.result import Diagnosis, Estimate, Rms
from symstiff.discrepancy.verdict import INSUFFICIENT, UNEXPLAINED
from symstiff.effects.base import EffectInstance, catalogue
from symstiff.model import StiffnessModel
from symstiff.reduction.physical import physical_stages
from symstiff.robot.schema import Robot


def wider_model(
    model: StiffnessModel, found: Diagnosis, task: Task, experiment: ExperimentClass
) -> StiffnessModel | None:
    """The complete model, where links are rigid in this one and a few elastic links would not do."""
    rigid = all(p.is_joint for p in model.compliances) and not model.effects
    if not rigid or found.verdict not in (UNEXPLAINED, INSUFFICIENT) or task.max_effects < 2:
        return None
    tested = [c for c in found.candidates if c.testable]
    if not tested or not _is_compliance(task.robot, tested[0].parameters):
        return None
    return start_model(task.robot, "complete", experiment)[0]


def leaves_less(wider: Rms, narrow: Rms) -> bool:
    """Whether a model of more parameters leaves less, also on poses that were left out where there are any."""
    own, other = wider.held_out_before, narrow.held_out_before
    refuted = own is not None and other is not None and own >= other
    return wider.before < narrow.before and not refuted


def links_of(found: Diagnosis, wider: StiffnessModel) -> tuple[Found, ...]:
    """The links of the complete model, fitted, as effects of the verdict."""
    estimates = {
        n: Estimate(value, wider.deviations.get(n, np.inf), wider.units[n])
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
