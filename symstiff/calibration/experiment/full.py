"""All compliances of the robot, plausible where the data do not tell: how it answers to loads it never carried.

An error of the force sensor acts in directions in which the experiment may have had no load, and the second-order
term needs every spring's share. So the full set after M3 is estimated with a prior: a joint's compliance and the
turn of the link before it count one, other turns a fifth, shifts a fifth times a link's length squared, and all of
them more near the tool: gears and links are as stiff as the moment that they are made for, which goes with the lever
of the load (a KR 270's wrist turns ten times as much per moment as its second joint). The unit is fitted to the
data; the spread is the size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from symstiff.arrays import TINY, Array
from symstiff.calibration.experiment.situation import Laws, View, Weigh, linear_columns
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.model import StiffnessModel
from symstiff.reduction.physical import Parameter, original, physical_stages, terms_of
from symstiff.symbolic.terms import Term, actuated_joint

_OTHER_TURNS = 0.2
"""A link's turn that is no joint's, against a joint."""
_SOFTEST = 5.0
"""How much softer the shortest lever makes a gear: robots have one to ten."""


def full_laws(
    model: StiffnessModel, view: View, further: Array, values: dict[str, float], y: Array,
    weigh: Weigh,
) -> Laws:  # fmt: skip
    """Laws of the full set that fit the data; the model's effects keep their fitted ``values``.

    ``further`` (M, k) are columns that are fitted along without a prior: effects, the device's placement. ``weigh``
    gives rows (M, k) in units of the noise.
    """
    apart = view.table.kind == "absolute" and model.robot.has_weights
    parameters = everything(model, apart)
    names = [p.name for p in parameters]
    terms = terms_of(parameters)
    A = weigh(linear_columns(view, terms, names))
    target = weigh(y[:, None])[:, 0]
    size = _sizes(model, parameters, _slender(view), apart)
    guess = A @ np.where([p.is_coupling for p in parameters], 0.0, size)
    scale = max(float(guess @ target) / max(float(guess @ guess), TINY), 0.0) or 1e-7
    size = size * scale
    mean = np.where([p.is_coupling for p in parameters], 0.0, size)
    rows = np.hstack([A * size, weigh(further)])
    rows[:, len(names) :] = unit_columns(rows[:, len(names) :])[0]
    prior = np.eye(rows.shape[1])[: len(names)]
    step = np.linalg.lstsq(
        np.vstack([rows, prior]), np.concatenate([target - A @ mean, np.zeros(len(names))]), rcond=1e-12
    )[0]
    found = dict(zip(names, (mean + size * step[: len(names)]).tolist(), strict=True))
    own: tuple[Term, ...] = tuple(t for r in model.realisations for t in r.terms if t.parameter not in found)
    return Laws(view, (*terms, *own), {**values, **found})


def everything(model: StiffnessModel, apart: bool = False) -> tuple[Parameter, ...]:
    """The compliances of every part that the model takes for elastic, before any was eliminated.

    ``apart``: joints beside their links, as weights tell them: a link's own does not turn the joint behind it.
    """
    elastic = {p.body for p in model.compliances if not p.is_joint}
    stage = physical_stages(model.robot)[2 if apart else -1]
    full = {
        p.name: p
        for p in stage.parameters
        if (p.body in elastic and not p.is_joint) or (apart and p.is_joint and p.body - 1 in elastic)
    }
    joints = {
        p.name: p
        for p in original(model.robot).parameters
        if p.is_joint and (p.body - 1 not in elastic or p in model.compliances)
    }
    replaced = {n for r in model.realisations for n in r.replaces}
    own = {p.name: p for p in model.compliances}
    return tuple(p for n, p in (full | joints | own).items() if n not in replaced)


def _slender(view: View) -> Array:
    """(n + 1,) by which joint i + 1, and link i before it, are softer than those with the longest lever.

    The last link is like the joint before it.
    """
    J = view.found.J_theta
    at = [view.index[actuated_joint(i + 1)] for i in range(view.robot.dof)]
    lever = np.sqrt(np.mean(np.sum(J[:, :3, at] ** 2, axis=1), axis=0))
    slides = np.array([j.prismatic for j in view.robot.joint])
    longest = float(np.max(lever[~slides], initial=0.0)) or 1.0
    ratio = np.where(slides, 1.0, longest / np.maximum(lever, longest / _SOFTEST))
    return np.append(ratio, ratio[-1])


def _sizes(model: StiffnessModel, parameters: Sequence[Parameter], slender: Array, apart: bool) -> Array:
    """Relative sizes (P,) of compliances: the joint with the longest lever counts one.

    So does the turn of the link before it about its axis, where they are one parameter, not ``apart``.
    """
    length = model.robot.reach / max(model.robot.dof, 1)

    def size(p: Parameter) -> float:
        if p.is_joint:
            return length**2 if p.prismatic else float(slender[p.body - 1])
        # the joint's own compliance is part of what turns with it
        joint_like = not apart and not p.is_coupling and p.row in model.chain.turns_with_joint(p.body)
        return float(slender[p.body]) * (1.0 if joint_like else _OTHER_TURNS) * length**p.length_degree

    return np.array([size(p) for p in parameters])
