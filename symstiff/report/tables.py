"""Numbers of a report in rows: the seed's Table 2 a step, residuals a state, how the compliances moved."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.residuals import Size, sizes
from symstiff.discrepancy.findings.finding import Finding


def by_state(finding: Finding, rows: Array) -> Array:
    """(N, 6) of rows (M,) of the problem, NaN where nothing was measured."""
    view = finding.assembly.situation.view
    table = np.full((len(view.table), 6), math.nan)
    table[view.state, view.component] = rows
    return table


def sizes_of(finding: Finding, residual: Array) -> dict[str, Size]:
    """MAX and RMS by axis and position, m and rad."""
    return sizes(by_state(finding, residual))


@dataclass(frozen=True)
class StepRow:
    """A line of the step table: sizes in mm and mrad by axis."""

    title: str
    parameters: str
    sizes: dict[str, tuple[float, float]]
    share: float | None
    """Share of the positional RMS of the readings that the model removes."""
    p_left: float | None


def step_rows(finding: Finding) -> list[StepRow]:
    """The readings themselves, then every step of the growth path."""
    raw = sizes_of(finding, finding.start.reading)
    title = "no compensation" if finding.table.kind == "deflection" else "placed, rigid and uncalibrated"
    out = [StepRow(title, "–", _shown(raw), None, None)]
    whole = raw.get("positional")
    for step in finding.steps:
        found = sizes_of(finding, step.residual)
        share = None
        if whole is not None and whole.rms > 0 and "positional" in found:
            share = 1.0 - found["positional"].rms / whole.rms
        p_left = step.p_left if math.isfinite(step.p_left) else None
        out.append(StepRow(step.title, str(step.parameters), _shown(found), share, p_left))
    return out


def _shown(found: dict[str, Size]) -> dict[str, tuple[float, float]]:
    return {axis: (1e3 * s.max, 1e3 * s.rms) for axis, s in found.items()}


def rotates(finding: Finding, virtual_joint: str) -> bool:
    """Whether a virtual joint turns (rad, N·m) or shifts (m, N)."""
    view = finding.assembly.situation.view
    joint = view.joints[finding.assembly.problem.virtual_joints.index(virtual_joint)]
    return joint.rotational or (joint.kind == "joint" and not view.robot.joint[joint.body - 1].prismatic)


def shift(finding: Finding, virtual_joint: str) -> str:
    """A law's left side: the way of a joint that slides; of other virtual joints Δθ, as in the model's equations."""
    slides = virtual_joint.startswith("joint") and not rotates(finding, virtual_joint)
    return "Δq" if slides else "Δθ"


def weights(finding: Finding) -> Array:
    """(M,) standard deviations of the problem's rows, by axis."""
    return np.asarray(finding.last.noise.by_component(shared=False)[finding.assembly.problem.axis])


def standardised(finding: Finding, residual: Array) -> Array:
    """(N, 6) residuals in units of the noise of their axis, a pose's shared error included."""
    return np.asarray(by_state(finding, residual) / finding.last.noise.by_component())


@dataclass(frozen=True)
class Moved:
    """A parameter before and after the growth."""

    name: str
    unit: str
    before: float | None
    before_std: float | None
    after: float | None
    after_std: float | None

    @property
    def sigmas(self) -> float | None:
        """Change in units of the standard deviation before or after, whichever is larger."""
        if None in (self.before, self.after, self.before_std, self.after_std):
            return None
        largest = max(self.before_std or 0.0, self.after_std or 0.0)
        return abs((self.after or 0.0) - (self.before or 0.0)) / largest if largest > 0 else None


def moved(finding: Finding) -> list[Moved]:
    """Every parameter of the grown model, and what it was: in the start model as told, where that was made before.

    Else in what of it these data tell.
    """
    start, after = finding.start.model, finding.grown.model
    before = start if finding.as_told is None else finding.told
    units = {**before.units, **after.units}
    # an effect whose size is known stands in the model at that size; the verdict tells what the data say of it
    told = {n: e for f in finding.named for n, e in f.parameters.items() if math.isfinite(e.std)}
    out = []
    for name in dict.fromkeys((*start.parameters, *after.parameters)):
        a = name in (before.deviations if finding.as_told is None else before.values)
        b = name in after.deviations or name in told
        value = told[name].value if name in told else after.values.get(name, 0.0)
        std = told[name].std if name in told else after.deviations.get(name, 0.0)
        out.append(
            Moved(
                name,
                "" if units[name] == "1" else units[name],
                before.values.get(name, 0.0) if a else None,
                before.deviations.get(name, 0.0) if a else None,
                value if b else None,
                std if b else None,
            )
        )
    return out
