"""Compliances that no arm has: what is found to be of such a size is something else that was fitted along."""

from __future__ import annotations

from collections.abc import Mapping

from symstiff.model import StiffnessModel
from symstiff.reduction.physical import Parameter

SOFTEST = 1e-3
"""Deflection a newton [m/N] that no arm has, stretched out."""
_VAGUE = 0.1
"""Share of it that the arms that bend most have: where the deviation is above that, any arm's size fits."""
_CLEARLY = 2.0
"""Standard deviations below zero from which a joint's compliance is negative for sure."""


def implausible(model: StiffnessModel, found: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    """Compliances of which the data allow any size that an arm may have; where there are none, the one worst beyond.

    ``found``: value and standard deviation of those that were fitted, in the model's units.
    """
    parts = [(p, *found[p.name]) for p in model.compliances if p.name in found]
    vague = tuple(p.name for p, _, std in parts if std > _VAGUE * _largest(p, model))
    if vague:
        return vague
    beyond = {p.name: abs(v) / _largest(p, model) for p, v, std in parts if _impossible(p, v, std, model)}
    return (max(beyond, key=lambda name: beyond[name]),) if beyond else ()


def _impossible(p: Parameter, value: float, std: float, model: StiffnessModel) -> bool:
    """Beside links' compliances a joint's stands for a sum with what was eliminated; alone it is not negative."""
    alone = all(other.is_joint for other in model.compliances)
    return abs(value) > _largest(p, model) or (alone and value < -_CLEARLY * std)


def _largest(p: Parameter, model: StiffnessModel) -> float:
    """A compliance that alone moves the tool by ``SOFTEST``, at the lever of the arm's reach."""
    return float(SOFTEST / model.robot.reach ** (2 - p.length_degree))
