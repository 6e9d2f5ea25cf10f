"""What parameters, loads and functions mean, in words for headers and tables."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from symstiff.codegen.text import context_names
from symstiff.effects.registry import find
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.states import SIZES
from symstiff.symbolic.program import Program
from symstiff.symbolic.terms import WRENCH

LOADS_MEANING = {
    "wrench": "any force and moment at the tool centre point",
    "force": "any force at the tool centre point, no moment",
    "gravity": "a vertical force at the tool centre point (world z)",
}
LOADS_KNOWN = {"wrench": (1, 1, 1, 1, 1, 1), "force": (1, 1, 1, 0, 0, 0), "gravity": (0, 0, 1, 0, 0, 0)}
"""Which of fx, fy, fz, mx, my, mz a class of loads has."""
_CONTEXT = {
    "time": ("s, since the start of the measurements", 0.0),
    "temperature": ("degC, as in the measurements' column of that name", 20.0),
    "branch": (
        "+1 while the load grows, -1 while it falls, between them inside the loop, 0 while nothing is carried",
        1.0,
    ),
    "turn": (
        "a joint's load where it last turned over its present one, 1 while it grows and never less in size; one "
        "number, for loads of all joints that go up and down together",
        1.0,
    ),
}
_COARSE = 2.0**22
"""Time [s] from which single precision resolves no half second."""
SUMMARIES = {
    "deflection": "deflection of the tool centre point by recursion over the links",
    "observation": "observation matrix by columns",
    "jacobian": "Jacobian of the actuated joints",
    "compliance": "Cartesian compliance matrix by recursion",
    "columns": "columns of the virtual-joint Jacobian, three numbers a vector",
    "forward": "pose of the tool centre point",
}


@dataclass(frozen=True)
class Moment:
    """What holds at a call beside joints and load: its meaning, what it is where nobody tells, and in self-tests."""

    name: str
    meaning: str
    default: float
    tested: float
    held: tuple[float, float] | None = None
    """Between what its effects were measured; None where they do not tell."""
    size: tuple[str, float] | None = None
    """A comparison with a bound that its size must pass; None where any number will do."""


def moments(model: StiffnessModel, program: Program) -> list[Moment]:
    """What a program of a model asks of the moment: by default that at which the effects that ask for it do nothing."""
    found, held = [], measured_between(model)
    for name in context_names(program):
        told, default = _CONTEXT[name]
        default = float(model.rest.get(name, default))
        if name == "time" and default:
            told = f"s, by the clock of the measurements, which began at {default:.15g}"
        tested = default if name == "branch" else default + _since(default, held.get(name))
        found.append(Moment(name, told, default, tested, held.get(name), SIZES.get(name)))
    return found


def _since(default: float, between: tuple[float, float] | None) -> float:
    """About the middle of what was measured, from the default on: a power of two, exact in both precisions."""
    middle = 1.0 if between is None else 0.5 * (between[1] - default)
    return 2.0 ** round(math.log2(middle)) if middle > 1.0 else 1.0


def measured_between(model: StiffnessModel) -> dict[str, tuple[float, float]]:
    """Times [s] and temperatures [°C] between which all of a model's effects were measured, of those that tell.

    Where none tells, those of the rows that the model was fitted to.
    """
    found: dict[str, tuple[float, float]] = {}
    for effect, realised in zip(model.effects, model.realisations, strict=True):
        for name, span in {**effect.spans, **realised.over}.items():
            begin = realised.rest.get(name, 0.0)
            low, high = found.get(name, (begin, begin + span))
            found[name] = max(low, begin), min(high, begin + span)
    told = {n: model.seen[n] for n in ("time", "temperature") if n in model.seen} | found
    return {name: between for name, between in told.items() if between[0] < between[1]}


def seen_between(model: StiffnessModel) -> list[tuple[str, list[float]]]:
    """Bounds of joints and loads that a model's values were fitted to, by names in C; none where one is not told."""
    found = []
    for kind, names in (("Q", [f"q{j}" for j in range(1, model.robot.dof + 1)]), ("W", WRENCH)):
        if all(n in model.seen for n in names):
            found += [
                (f"{kind}_SEEN_{end}", [model.seen[n][k] for n in names])
                for k, end in enumerate(("MIN", "MAX"))
            ]
    return found


def fixed_joints(model: StiffnessModel) -> str:
    """The joints that stood still when a model was reduced, with their values; empty where none did."""
    return ", ".join(f"{name} = {value:.9g}" for name, value in model.fixed_by_name.items())


def limits(model: StiffnessModel) -> list[str]:
    """Sentences on where a reduced model holds, for files that stand alone."""
    found = []
    if fixed := fixed_joints(model):
        found.append(
            f"The parameters were reduced for joints that stand still, {fixed} (rad, m), and hold there alone."
        )
    if model.loads != "wrench":
        meant = LOADS_MEANING[model.loads]
        found.append(f'Results hold for loads of the class "{model.loads}" only: {meant}.')
    if model.measure == "position":
        found.append(
            "The parameters were reduced to what measured positions identify: translations hold. The rotation, which "
            "the compensated joint command takes too, holds only as far as these parameters tell it."
        )
    return found


def effect_meaning(model: StiffnessModel, name: str) -> str:
    """Effect, place, shape and its own part of a parameter, in ASCII."""
    for effect, realised in zip(model.effects, model.realisations, strict=True):
        for p in (p for p in realised.parameters if p.name == name):
            place = ", ".join(f"{k} {v}" for k, v in effect.where.items())
            told = "".join(f", {phrase}" for phrase in effect.shape_phrases(model.robot))
            # where masses are known, two laws of a joint may differ by this alone
            told += (
                ", links' weight left out"
                if model.robot.has_weights and effect.shape.get("weights") == 0
                else ""
            )
            own = f": {p.meaning}" if p.meaning else ""
            text = f"{find(effect.effect).title.lower()} ({place}){told}{own}"
            text = text.replace("±", "+-").replace("·", "*").replace("°C", "degC")
            return text.encode("ascii", "replace").decode().replace("*/", "* /")
    return "parameter of an effect"


def check_single(model: StiffnessModel) -> None:
    """Raise UserError for a value or a clock that single precision does not hold."""
    known = model.known
    large = [n for n in model.parameters if abs(known[n]) > float(np.finfo(np.float32).max)]
    if large:
        raise UserError(f"{large[0]} = {model.values[large[0]]:g} does not fit single precision: use double")
    start = max((r.rest.get("time", 0.0) for r in model.realisations), key=abs, default=0.0)
    if abs(start) >= _COARSE:
        raise UserError(
            f"the model's clock begins at {start:.15g} s, where single precision has no fractions of a second: use "
            "double precision, or count the time of the measurements from their start and diagnose again"
        )
