"""Laws without a name: smooth functions of load, angle, time and branch at every virtual joint.

They compete with the catalogue, so that an effect outside of it is not given the name of its nearest neighbour,
and they describe an effect that has no name by a fitted expression.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from symstiff.discrepancy.problem import Array, Candidate, Parameter, Problem, Shape

EFFECT = "unnamed_law"
_TINY = 1e-300


@dataclass(frozen=True)
class Law:
    """A few columns with their expressions."""

    text: tuple[str, ...]
    values: Array
    """(M, k) factors of the virtual joint's Jacobian column."""


def unnamed_laws(problem: Problem, limit: int = 1200) -> tuple[Candidate, ...]:
    """Candidates for what the catalogue does not hold; none where the context is missing."""
    out: list[Candidate] = []
    for place, column, law in _everywhere(problem):
        block = column[:, None] * law.values
        parameters = tuple(Parameter(t) for t in law.text)
        out.append(
            Candidate(EFFECT, {"at": place, "law": " + ".join(law.text)}, parameters, _constant(block))
        )
    return tuple(out[:limit])


def of_load(law: Candidate) -> bool:
    """Whether an unnamed law depends on the load or its branch, and not on angle or time alone."""
    return any("tau" in p.name or "branch" in p.name for p in law.parameters)


def _constant(block: Array) -> _Columns:
    return _Columns(block)


@dataclass(frozen=True, eq=False)
class _Columns:
    block: Array

    def __call__(self, shape: Shape) -> Array:
        return self.block


def _everywhere(problem: Problem) -> Iterator[tuple[str, Array, Law]]:
    if problem.J is not None and problem.tau is not None:
        joints = [v for v, j in enumerate(problem.joint_of) if j >= 0]
        for v in joints:
            for law in joint_laws(problem, v):
                yield problem.virtual_joints[v], problem.J[:, v], law
            for u in joints:
                if u != v:
                    law = Law((f"tau[{problem.virtual_joints[u]}]",), _unit(problem.tau[:, [u]]))
                    yield problem.virtual_joints[v], problem.J[:, v], law
        for v, j in enumerate(problem.joint_of):
            if j < 0:
                t = _unit(problem.tau[:, [v]])
                yield problem.virtual_joints[v], problem.J[:, v], Law(("tau*|tau|",), t * np.abs(t))
                yield problem.virtual_joints[v], problem.J[:, v], Law(("|tau|",), np.abs(t))
    for axis in np.unique(problem.axis):
        indicator = (problem.axis == axis).astype(float)
        for law in _frame_laws(problem):
            yield f"measurement axis {axis}", indicator, law


def _unit(x: Array) -> Array:
    return np.asarray(x / max(float(np.max(np.abs(x))), _TINY))


def joint_laws(problem: Problem, v: int) -> list[Law]:
    """The dictionary at one virtual joint of an actuated joint, simplest first."""
    assert problem.tau is not None
    t = _unit(problem.tau[:, v])
    out = [
        Law(("tau*|tau|",), (t * np.abs(t))[:, None]),
        Law(("tau^3",), (t**3)[:, None]),
        Law(("sign(tau)",), np.tanh(t / 0.03)[:, None]),
        Law(("|tau|",), np.abs(t)[:, None]),
        Law(("tau^2",), (t**2)[:, None]),
    ]
    if problem.q is not None:
        for j in range(problem.q.shape[1]):
            angle = problem.q[:, j]
            orders = (1, 2, 3, 5) if j == problem.joint_of[v] else (1, 2)
            for n in orders:
                wave = np.column_stack([np.sin(n * angle), np.cos(n * angle)])
                name = f"{n}*q{j + 1}" if n > 1 else f"q{j + 1}"
                out.append(Law((f"tau*sin({name})", f"tau*cos({name})"), t[:, None] * wave))
                if n <= 2:
                    out.append(Law((f"sin({name})", f"cos({name})"), wave))
    if problem.time is not None and np.ptp(problem.time) > 0:
        s = (problem.time - problem.time.min()) / np.ptp(problem.time)
        out.append(Law(("time",), s[:, None]))
        out.append(Law(("tau*time",), (t * s)[:, None]))
    if np.ptp(problem.case) > 1:
        step = (problem.case - problem.case.mean()) / np.ptp(problem.case)
        out.append(Law(("tau*load_case",), (t * step)[:, None]))
    if problem.branch is not None and np.ptp(problem.branch) > 0:
        out.append(Law(("branch",), problem.branch[:, None]))
        out.append(Law(("branch*tau",), (problem.branch * t)[:, None]))
        out.append(Law(("branch*|tau|",), (problem.branch * np.abs(t))[:, None]))
    return out


def _frame_laws(problem: Problem) -> list[Law]:
    out = []
    if problem.load is not None and np.ptp(problem.load) > 0:
        f = problem.load
        out += [Law(("load",), f[:, None]), Law(("load^2",), (f**2)[:, None])]
    if problem.time is not None and np.ptp(problem.time) > 0:
        s = (problem.time - problem.time.min()) / np.ptp(problem.time)
        out += [Law(("time",), s[:, None]), Law(("time^2",), (s**2)[:, None])]
        for n in (0.5, 1, 1.5, 2, 2.5, 3, 4, 5):
            wave = np.column_stack([np.sin(2 * np.pi * n * s), np.cos(2 * np.pi * n * s)])
            out.append(Law((f"sin({n} turns of time)", f"cos({n} turns of time)"), wave))
    if problem.temperature is not None and np.ptp(problem.temperature) > 0:
        out.append(Law(("temperature",), _unit(problem.temperature - problem.temperature.mean())[:, None]))
    if problem.branch is not None and np.ptp(problem.branch) > 0:
        out.append(Law(("branch",), problem.branch[:, None]))
    return out
