"""Laws without a name: smooth functions of load, angle, time and branch at every virtual joint.

They compete with the catalogue, so that an effect outside of it is not given the name of its nearest neighbour,
and they describe an effect that has no name by a fitted expression.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from symstiff.arrays import TINY, Array
from symstiff.calibration.tables.measurements import course
from symstiff.discrepancy.laws.law import Law, Load, largest_load, load_on
from symstiff.discrepancy.laws.of_angles import laws_of_angle, wave
from symstiff.discrepancy.problem import ANGLE, CLOCK, HISTORY, Candidate, Parameter, Problem
from symstiff.effects.base import Shape

EFFECT = "unnamed_law"
READING = "measurement axis"
_SLIPS = (0.2, 0.4, 0.65)
"""Shares of the largest load at which a link's law without a name begins: a foot that slips, a bolt that opens."""
_SHARP = 0.03
"""Load, as a share of the largest, over which a sign changes."""
_RUBBED = "branch*tau"
_LAGS = (0.01, 0.05, 0.25)
"""Time constants, as shares of the session, with which a joint without a name may follow its load."""
_CREEPS = (0.3, 1.0)
"""The same as shares of a pose's time, from no load at its begin on."""


def unnamed_laws(problem: Problem) -> tuple[Candidate, ...]:
    """Candidates for what the catalogue does not hold; none where the context is missing."""
    families: dict[tuple[str, str], list[tuple[Array, Law]]] = {}
    for place, column, law in _everywhere(problem):
        families.setdefault((place, law.title), []).append((column, law))
    return tuple(_candidate(*key, laws) for key, laws in families.items())


def _candidate(place: str, title: str, laws: list[tuple[Array, Law]]) -> Candidate:
    known = tuple(law.parameters for _, law in laws)
    return Candidate(
        EFFECT,
        {"at": place, "law": title},
        known[0],
        _Columns(tuple(column[:, None] * law.values for column, law in laws)),
        tuple({"variant": float(k)} for k in range(len(laws))) if len(laws) > 1 else ({},),
        parameters_of=(lambda shape: known[_variant(shape)]) if len(laws) > 1 else None,
        at=(None if place.startswith("link") else place) if laws[0][1].own else "",
        driven=lambda shape: laws[_variant(shape)][1].driven,
    )


def _variant(shape: Shape) -> int:
    return int(shape.get("variant", 0.0))


def of_load(law: Candidate) -> bool:
    """Whether an unnamed law depends on the load or its branch, and not on angle or time alone."""
    return any("tau" in p.name or "branch" in p.name for p in law.parameters)


@dataclass(frozen=True, eq=False)
class _Columns:
    blocks: tuple[Array, ...]

    def __call__(self, shape: Shape) -> Array:
        return self.blocks[_variant(shape)]


def _everywhere(problem: Problem) -> Iterator[tuple[str, Array, Law]]:
    if problem.J is not None and problem.tau is not None:
        for v in range(len(problem.joint_of)):
            for law in laws_at(problem, v):
                yield problem.virtual_joints[v], problem.J[:, v], law
    for axis in np.unique(problem.axis):
        indicator = (problem.axis == axis).astype(float)
        for law in _frame_laws(problem):
            known = tuple(Parameter(t, "m" if axis < 3 else "rad") for t in law.text)
            yield f"{READING} {axis + 1}", indicator, replace(law, known=known)
    ones = np.ones(problem.rows)
    for added in problem.devices:
        text = tuple(p.name for p in added.parameters)
        yield added.place, ones, Law(text, added.values, family=added.title, known=added.parameters)


def _unit(x: Array) -> Array:
    return np.asarray(x / max(float(np.max(np.abs(x))), TINY))


def _link_laws(problem: Problem, v: int) -> list[Law]:
    """At a link's axis: what is not proportional to the load."""
    t = load_on(problem, v)
    out = [Law(("tau*|tau|",), t.law(lambda x: x * np.abs(x))), Law(("|tau|",), t.law(np.abs))]
    for slip in _SLIPS:
        beyond = t.law(lambda x, knee=slip: x - np.clip(x, -knee, knee))  # type: ignore[misc]
        out.append(Law((f"beyond(tau,{slip})",), beyond, family="tau beyond a threshold"))
    along = _along(problem, v)
    if along is not None:
        out.append(Law(("tau*taux",), t.product(along), own=False))
        out.append(Law(("tau*|taux|",), t.product(along, np.abs), own=False))
    return out


def _along(problem: Problem, v: int) -> Load | None:
    """Load along the axis of the link that a virtual joint belongs to; none at that axis."""
    name = problem.virtual_joints[v]
    first = name[: name.rindex(" ") + 1] + "1"
    if name == first or not name.startswith("link") or first not in problem.virtual_joints:
        return None
    load = load_on(problem, problem.virtual_joints.index(first))
    return load if np.any(load.total) else None


def laws_at(problem: Problem, v: int) -> list[Law]:
    """The laws that compete at one virtual joint, simplest first: a few at a link's, all at an actuated joint's."""
    if problem.joint_of[v] >= 0:
        return every_law(problem, v)
    in_proportion = [law for law in _rubbing(problem, load_on(problem, v).total) if law.title == _RUBBED]
    return [*_link_laws(problem, v), *_by(HISTORY, in_proportion)]


def every_law(problem: Problem, v: int) -> list[Law]:
    """The whole dictionary at one virtual joint."""
    own = _link_laws(problem, v)[2:] if problem.joint_of[v] < 0 else []
    return [
        *own, *_laws_of_load(problem, v), *_by(ANGLE, laws_of_angle(problem, v)),
        *_by(CLOCK, _laws_of_clock(problem, v)), *_by(HISTORY, _laws_of_history(problem, v)),
        *(replace(law, driven=frozenset({CLOCK, HISTORY})) for law in _lagging_laws(problem, v)),
    ]  # fmt: skip


def _by(what: str, laws: list[Law]) -> list[Law]:
    return [replace(law, driven=frozenset({what})) for law in laws]


def _laws_of_load(problem: Problem, v: int) -> list[Law]:
    """Of the joint's own load, and up to second order of the other joints'."""
    t = load_on(problem, v)
    out = [
        Law(("tau*|tau|",), t.law(lambda x: x * np.abs(x))),
        Law(("tau^3",), t.law(lambda x: x**3)),
        Law(("sign(tau)",), t.law(lambda x: np.tanh(x / _SHARP))),
        Law(("|tau|",), t.law(np.abs)),
        Law(("tau^2",), t.law(lambda x: x**2)),
    ]
    for u, j in enumerate(problem.joint_of):
        if j >= 0 and u != v:
            other, name = load_on(problem, u), f"tau{j + 1}"
            out.append(Law((name,), other.law(lambda x: x), own=False))
            out.append(Law((f"{name}*|{name}|",), other.law(lambda x: x * np.abs(x)), own=False))
            out.append(Law((f"sign({name})",), other.law(lambda x: np.tanh(x / _SHARP)), own=False))
            even, family = {f"|{name}|": np.abs, f"{name}^2": np.square}, f"|{name}| or its square"
            out += [Law((text,), other.law(of), own=False, family=family) for text, of in even.items()]
            out.append(Law((f"tau*{name}",), t.product(other), own=False))
            out.append(Law((f"tau*|{name}|",), t.product(other, np.abs), own=False))
    return out


def _clock(problem: Problem) -> tuple[str, Array]:
    """The session from 0 to 1, by time where it is told, else in the order of the rows; and its name in laws."""
    if problem.time is not None and np.ptp(problem.time) > 0:
        return "time", course(problem.time)
    return "order", np.arange(problem.rows) / max(problem.rows - 1, 1)


def _lagging(clock: Array, t: Array, constant: float) -> Array:
    """A load (M,) that is followed with a time constant, as a share of the session."""
    out = np.zeros_like(t)
    z = last = 0.0
    for row in np.argsort(clock, kind="stable"):
        z = t[row] + (z - t[row]) * float(np.exp(-(clock[row] - last) / constant))
        last, out[row] = clock[row], z
    return out


def _creeping(problem: Problem, clock: Array, t: Array, share: float) -> Array:
    """A load (M,) that is followed from none at the begin of its pose, in shares of the time that a pose takes.

    The first load of a pose comes as long before its reading as the next ones.
    """
    groups = [np.flatnonzero(problem.pose == p) for p in np.unique(problem.pose)]
    constant = share * float(np.median([np.ptp(clock[rows]) for rows in groups]))
    out = np.zeros_like(t)
    if constant <= 0:
        return out
    for rows in groups:
        moments = np.unique(clock[rows])
        begin = moments[0] - (float(np.median(np.diff(moments))) if len(moments) > 1 else constant)
        out[rows] = _lagging(clock[rows] - begin, t[rows], constant)
    return out


def _laws_of_clock(problem: Problem, v: int) -> list[Law]:
    """Of time, or the order of the poses, and temperature, with the load and without."""
    assert problem.tau is not None
    t = problem.tau[:, v] / largest_load(problem, v)
    name, s = _clock(problem)
    out = [Law((name,), s[:, None]), Law((f"tau*{name}",), (t * s)[:, None])]
    grows = {name: s} if name == "time" else {}
    if problem.temperature is not None and np.ptp(problem.temperature) > 0:
        warm = _unit(problem.temperature - problem.temperature.min())
        out.append(Law(("tau*temperature",), (t * warm)[:, None]))
        grows["temperature"] = warm
    return [*out, *(law for text, share in grows.items() for law in _growing_wave(problem, v, text, share))]


def _growing_wave(problem: Problem, v: int, name: str, share: Array) -> list[Law]:
    """A joint that runs out of round as it warms up, once a turn; of absolute positions, which show such errors."""
    j = problem.joint_of[v]
    if problem.differences or problem.q is None or j < 0 or j in problem.slides:
        return []
    text, values = wave(problem.q[:, j], j + 1, 1)
    return [Law(tuple(f"{name}*{t}" for t in text), share[:, None] * values)]


def _by_load_case(problem: Problem, v: int) -> list[Law]:
    """A load by its place among those of its pose, from 0 to 1: what creeps gives way more under the later ones.

    Where the links' weight is known, also under the whole of it, as after a move of the arm.
    """
    if np.ptp(problem.case) < 2:
        return []
    t, case = load_on(problem, v), (problem.case - problem.case.min()) / np.ptp(problem.case)
    loads = {"tau": t.total - t.before} | ({"(tau + weight)": t.total} if np.any(t.before) else {})
    growing = {"load_case": case, "sqrt(load_case)": np.sqrt(case)}
    return [
        Law((f"{name}*{text}",), (load * g)[:, None], family="tau by load_case")
        for name, load in loads.items()
        for text, g in growing.items()
    ]


def _laws_of_history(problem: Problem, v: int) -> list[Law]:
    """Of the loads that were there before: their order, and the branch with the load and without."""
    assert problem.tau is not None
    t = problem.tau[:, v] / largest_load(problem, v)
    return [*_by_load_case(problem, v), *_rubbing(problem, t)]


def _lagging_laws(problem: Problem, v: int) -> list[Law]:
    """A load that is followed late, through the session or from the begin of each pose on."""
    assert problem.tau is not None
    t = problem.tau[:, v] / largest_load(problem, v)
    _, s = _clock(problem)
    late = {f"late(tau,{constant:g})": _lagging(s, t, constant) for constant in _LAGS}
    late |= {f"creep(tau,{share:g})": _creeping(problem, s, t, share) for share in _CREEPS}
    return [Law((text,), values[:, None], family="tau, late") for text, values in late.items()]


def _rubbing(problem: Problem, t: Array) -> list[Law]:
    """What the branch tells: in proportion to the load (M,), closed where it turned or not, without it, by its size."""
    if problem.branch is None or not np.ptp(problem.branch) > 0:
        return []
    with_load = {"branch*tau": t, "branch": np.ones_like(t), "branch*|tau|": np.abs(t)}
    out = [Law((text,), (problem.branch * values)[:, None]) for text, values in with_load.items()]
    if problem.load is not None:
        closed = problem.branch * t * (1.0 - np.abs(problem.load))
        out.append(Law(("branch*tau*(1-load)",), closed[:, None], family=_RUBBED))
    return out


def _frame_laws(problem: Problem) -> list[Law]:
    out = []
    if problem.load is not None and np.ptp(problem.load) > 0:
        f = problem.load
        out += [Law(("load",), f[:, None]), Law(("load^2",), (f**2)[:, None])]
    name, s = _clock(problem)
    out += [Law((name,), s[:, None]), Law((f"{name}^2",), (s**2)[:, None])]
    for n in (0.5, 1, 1.5, 2, 2.5, 3, 4, 5):
        wave = np.column_stack([np.sin(2 * np.pi * n * s), np.cos(2 * np.pi * n * s)])
        out.append(Law((f"sin({n} turns of {name})", f"cos({n} turns of {name})"), wave))
    if problem.temperature is not None and np.ptp(problem.temperature) > 0:
        out.append(Law(("temperature",), _unit(problem.temperature - problem.temperature.mean())[:, None]))
    if problem.branch is not None and np.ptp(problem.branch) > 0:
        out.append(Law(("branch",), problem.branch[:, None]))
    return out
