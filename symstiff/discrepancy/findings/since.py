"""What became of a start model since it was made: what it leaves as it is, which effects changed or are gone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from symstiff.arrays import Index, Mask
from symstiff.calibration.experiment.placement import best_placed
from symstiff.discrepancy.bridge.growth import JointFit
from symstiff.discrepancy.findings.numbers import milli, quantity
from symstiff.discrepancy.findings.result import Quantity
from symstiff.effects.places import named as named_at
from symstiff.model import StiffnessModel

_CHANGED, _SHARE = 5.0, 0.2
"""Standard deviations, and share of its size, by which a parameter has to differ from what the start model says."""
_GONE = 3.0
"""Standard deviations within which what is left of an effect is none."""

_WORSE = 1.2
"""What a start model leaves as it is, over what it leaves fitted anew, from which that is remarked."""

_Pair = tuple[str, Quantity, Quantity]


def as_told(start: StiffnessModel, fitted: JointFit) -> float:
    """What a start model's own values leave of the table that it was ``fitted`` to, rms per coordinate [m].

    Of rotations [rad] where nothing else was measured. The device is placed as it fits best.
    """
    problem, names = fitted.assembly.problem, fitted.assembly.names
    values = np.array([start.values.get(name, 0.0) for name in names])
    left = best_placed(fitted.assembly.situation.view, problem.y - problem.A[:, : len(names)] @ values)
    return float(np.sqrt(np.mean(left[_rows(problem.axis)] ** 2)))


def worse(left: float | None, anew: float) -> bool:
    """Whether a start model's own values leave clearly more than it does fitted anew; None: it was told none."""
    return left is not None and left > _WORSE * anew


def of_values(left: float, fitted: JointFit) -> list[str]:
    """A remark on what a start model's own values leave, where that is clearly more than it does fitted anew."""
    axis = fitted.assembly.problem.axis
    anew = float(np.sqrt(np.mean(fitted.residual[_rows(axis)] ** 2)))
    if not worse(left, anew):
        return []
    unit = "mm" if (axis < 3).any() else "mrad"
    return [
        f"with its own values the start model, and code that was made from it, leaves {milli(left)} {unit} rms per "
        f"coordinate of these data; fitted anew to them it leaves {milli(anew)} {unit}"
    ]


def _rows(axis: Index) -> Mask:
    """Rows (M,) of translations where there are any, else all."""
    return np.asarray(axis < 3) if (axis < 3).any() else np.ones(len(axis), bool)


def since(start: StiffnessModel, fitted: StiffnessModel) -> list[str]:
    """Remarks on effects of a start model whose sizes in it do not hold any more, by the deviations of both."""
    found = []
    for effect, realised in zip(start.effects, start.realisations, strict=True):
        if effect not in fitted.effects or realised.nominal:
            continue
        pairs = list(_pairs([p.name for p in realised.parameters], start, fitted))
        changed = [pair for pair in pairs if _differs(*pair[1:])]
        if not changed:
            continue
        gone = all(abs(now.value) < _GONE * now.std for _, _, now in pairs)
        told = "; ".join(f"{name} {quantity(then)}, now {quantity(now)}" for name, then, now in changed)
        # a compliance of a reduced model bears its part of those that were eliminated
        whose = "size, or that of compliances that it stands for," if _stands(start, changed) else "size"
        meant = (
            "nothing is left of it: was the part mended or replaced?"
            if gone
            else f"its {whose} has changed since the start model was made"
        )
        found.append(f"{named_at(effect.effect, effect.where)}: {meant} ({told})")
    return found


def _stands(start: StiffnessModel, changed: list[_Pair]) -> bool:
    return any(name in start.stiffness_parameters for name, *_ in changed)


def _pairs(names: list[str], start: StiffnessModel, fitted: StiffnessModel) -> Iterator[_Pair]:
    """Parameters of which both models tell how sure they are, with what they say."""
    for name in names:
        if name in start.values and name in start.deviations and name in fitted.deviations:
            then, now = (
                Quantity(float(m.values[name]), float(m.deviations[name]), m.units[name])
                for m in (start, fitted)
            )
            yield name, then, now


def _differs(then: Quantity, now: Quantity) -> bool:
    by = abs(now.value - then.value)
    return bool(by > _CHANGED * np.hypot(then.std, now.std) and by > _SHARE * abs(then.value))
