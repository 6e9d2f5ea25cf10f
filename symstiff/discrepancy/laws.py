"""Laws without a name: smooth functions of load, angle, time and branch at every virtual joint.

They compete with the catalogue, so that an effect outside of it is not given the name of its nearest neighbour,
and they describe an effect that has no name by a fitted expression.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from symstiff.discrepancy.problem import ANGLE, CLOCK, HISTORY, Array, Candidate, Parameter, Problem, Shape

EFFECT = "unnamed_law"
READING = "measurement axis"
_TINY = 1e-300
_SLIPS = (0.2, 0.4, 0.65)
"""Shares of the largest load at which a link's law without a name begins: a foot that slips, a bolt that opens."""
_SHARP = 0.03
"""Load, as a share of the largest, over which a sign changes."""
_LAGS = (0.01, 0.05, 0.25)
"""Time constants, as shares of the session, with which a joint without a name may follow its load."""
_SPOTS = 6
"""Widths of a spot that a joint's range holds."""
_HALF_WAVES = 32
"""Half waves over a slide's way up to which errors that repeat along it are looked for."""


@dataclass(frozen=True)
class Law:
    """A few columns with their expressions."""

    text: tuple[str, ...]
    values: Array
    """(M, k) factors of the virtual joint's Jacobian column."""
    own: bool = True
    """Whether it depends on nothing of other joints: then it is another shape of what the catalogue has there."""
    family: str = ""
    """Laws of one family at one place compete as one, by their average."""
    units: tuple[str, ...] = ()
    """Of the coefficients, where they have one."""
    driven: frozenset[str] = frozenset()
    """What it depends on beside loads."""

    @property
    def title(self) -> str:
        """The family, or the expression."""
        return self.family or " + ".join(self.text)


def unnamed_laws(problem: Problem) -> tuple[Candidate, ...]:
    """Candidates for what the catalogue does not hold; none where the context is missing."""
    families: dict[tuple[str, str], list[tuple[Array, Law]]] = {}
    for place, column, law in _everywhere(problem):
        families.setdefault((place, law.title), []).append((column, law))
    return tuple(_candidate(*key, laws) for key, laws in families.items())


def _candidate(place: str, title: str, laws: list[tuple[Array, Law]]) -> Candidate:
    known = tuple(
        tuple(Parameter(t, u) for t, u in zip(law.text, law.units or [""] * len(law.text), strict=True))
        for _, law in laws
    )
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
            units = ("m" if axis < 3 else "rad",) * len(law.text)
            yield f"{READING} {axis + 1}", indicator, replace(law, units=units)
    ones = np.ones(problem.rows)
    for added in problem.devices:
        names, units = zip(*((p.name, p.unit) for p in added.parameters), strict=True)
        yield added.place, ones, Law(names, added.values, family=added.title, units=units)


@dataclass(frozen=True)
class _Load:
    """A virtual joint's load in units of its largest: with the links' weight, and the weight alone."""

    total: Array
    before: Array

    def law(self, of: Callable[[Array], Array]) -> Array:
        """What a deflection shows of a law of the total load, (M, 1)."""
        return np.asarray(of(self.total) - of(self.before))[:, None]


def _load(problem: Problem, v: int) -> _Load:
    total, own = _with_weight(problem, v)
    largest = largest_load(problem, v)
    return _Load(total / largest, own / largest)


def _with_weight(problem: Problem, v: int) -> tuple[Array, Array]:
    assert problem.tau is not None
    own = np.zeros(problem.rows) if problem.weight is None else problem.weight[:, v]
    return problem.tau[:, v] + own, own


def largest_load(problem: Problem, v: int) -> float:
    """Size of the largest load on a virtual joint, links' weight included: the unit of tau in the laws."""
    return max(float(np.max(np.abs(_with_weight(problem, v)[0]))), _TINY)


def _unit(x: Array) -> Array:
    return np.asarray(x / max(float(np.max(np.abs(x))), _TINY))


def _link_laws(problem: Problem, v: int) -> list[Law]:
    """At a link's axis: what is not proportional to the load."""
    t = _load(problem, v)
    out = [Law(("tau*|tau|",), t.law(lambda x: x * np.abs(x))), Law(("|tau|",), t.law(np.abs))]
    for slip in _SLIPS:
        beyond = t.law(lambda x, knee=slip: x - np.clip(x, -knee, knee))  # type: ignore[misc]
        out.append(Law((f"beyond(tau,{slip})",), beyond, family="tau beyond a threshold"))
    along = _along(problem, v)
    if along is not None:
        out.append(Law(("tau*taux",), (t.total * along)[:, None], own=False))
        out.append(Law(("tau*|taux|",), (t.total * np.abs(along))[:, None], own=False))
    return out


def _along(problem: Problem, v: int) -> Array | None:
    """Load along the axis of the link that a virtual joint belongs to, in units of its largest; none at that axis."""
    name = problem.virtual_joints[v]
    first = name[: name.rindex(" ") + 1] + "1"
    if name == first or not name.startswith("link") or first not in problem.virtual_joints:
        return None
    load = _load(problem, problem.virtual_joints.index(first))
    return load.total if np.any(load.total) else None


def laws_at(problem: Problem, v: int) -> list[Law]:
    """The laws that compete at one virtual joint, simplest first: a few at a link's, all at an actuated joint's."""
    if problem.joint_of[v] >= 0:
        return every_law(problem, v)
    in_proportion = _rubbing(problem, _load(problem, v).total)[:1]
    return [*_link_laws(problem, v), *_by(HISTORY, in_proportion)]


def every_law(problem: Problem, v: int) -> list[Law]:
    """The whole dictionary at one virtual joint."""
    own = _link_laws(problem, v)[2:] if problem.joint_of[v] < 0 else []
    return [
        *own, *_laws_of_load(problem, v), *_by(ANGLE, _laws_of_angle(problem, v)),
        *_by(CLOCK, _laws_of_clock(problem, v)), *_by(HISTORY, _laws_of_history(problem, v)),
    ]  # fmt: skip


def _by(what: str, laws: list[Law]) -> list[Law]:
    return [replace(law, driven=frozenset({what})) for law in laws]


def _laws_of_load(problem: Problem, v: int) -> list[Law]:
    """Of the joint's own load, and up to second order of the other joints'."""
    t = _load(problem, v)
    out = [
        Law(("tau*|tau|",), t.law(lambda x: x * np.abs(x))),
        Law(("tau^3",), t.law(lambda x: x**3)),
        Law(("sign(tau)",), t.law(lambda x: np.tanh(x / _SHARP))),
        Law(("|tau|",), t.law(np.abs)),
        Law(("tau^2",), t.law(lambda x: x**2)),
    ]
    for u, j in enumerate(problem.joint_of):
        if j >= 0 and u != v:
            other, name = _load(problem, u), f"tau{j + 1}"
            product = t.total * other.total - t.before * other.before
            size = t.total * np.abs(other.total) - t.before * np.abs(other.before)
            out.append(Law((name,), other.law(lambda x: x), own=False))
            out.append(Law((f"{name}*|{name}|",), other.law(lambda x: x * np.abs(x)), own=False))
            out.append(Law((f"sign({name})",), other.law(lambda x: np.tanh(x / _SHARP)), own=False))
            out.append(Law((f"tau*{name}",), product[:, None], own=False))
            out.append(Law((f"tau*|{name}|",), size[:, None], own=False))
    return out


def _laws_of_angle(problem: Problem, v: int) -> list[Law]:
    """Series in the joint's own variable and in the others', with the load and without."""
    assert problem.tau is not None
    if problem.q is None:
        return []
    t = problem.tau[:, v] / largest_load(problem, v)
    out = []
    for j in range(problem.q.shape[1]):
        own = j == problem.joint_of[v]
        series = _powers if j in problem.slides else _waves
        for n, text, values in series(problem.q[:, j], j + 1, own):
            out.append(Law((f"tau*{text[0]}", f"tau*{text[1]}"), t[:, None] * values, own))
            if n <= 2:
                out.append(Law(text, values, own))
    mine = problem.joint_of[v]
    if mine < 0:
        return out
    out += [*_soft_spots(problem.q[:, mine], mine + 1, t), *_linked(problem, mine, t)]
    return (
        out
        if problem.differences
        else [*out, *_misread(problem.q[:, mine], mine + 1, mine in problem.slides)]
    )


def _misread(own: Array, joint: int, slides: bool) -> list[Law]:
    """A joint that is off near one of its angles, or by its encoder's scale; a slide by what repeats along it."""
    further = _pitch(own, joint) if slides else [Law((f"q{joint}",), own[:, None])]
    return [*_spots(own, joint), *further]


_Series = Iterator[tuple[int, tuple[str, str], Array]]
"""Order, names and values (M, 2) of pairs of functions of a joint's variable."""


def _waves(angle: Array, joint: int, own: bool) -> _Series:
    """Sine and cosine of an angle and of its multiples: more of a joint's own."""
    for n in (1, 2, 3, 5) if own else (1, 2):
        yield n, *_wave(angle, joint, n)


def _wave(angle: Array, joint: int, n: int) -> tuple[tuple[str, str], Array]:
    """Sine and cosine of a multiple of an angle: names and values (M, 2)."""
    name = f"{n}*q{joint}" if n > 1 else f"q{joint}"
    return (f"sin({name})", f"cos({name})"), np.column_stack([np.sin(n * angle), np.cos(n * angle)])


def _powers(way: Array, joint: int, own: bool) -> _Series:
    """Powers of a sliding joint's variable [m] about the middle of its range in the data, over half of it."""
    half = float(f"{np.ptp(way) / 2:.3g}")
    if half <= 0:
        return
    middle = round(float(way.max() + way.min()) / 2, 2 - math.floor(math.log10(half)))
    x = (way - middle) / half
    name = f"(q{joint} {'-' if middle > 0 else '+'} {abs(middle):g})" if middle else f"q{joint}"
    name = f"{name}/{half:g}"
    for n in (1, 2, 3) if own else (1, 2):
        odd, even = 2 * n - 1, 2 * n
        text = (name if odd == 1 else f"({name})^{odd}", f"({name})^{even}")
        yield n, text, np.column_stack([x**odd, x**even])


def _pitch(way: Array, joint: int) -> list[Law]:
    """What repeats along a slide, as a rack's or a screw's errors do: one to sixteen periods over the way travelled."""
    travel = float(np.ptp(way))
    out = []
    for half_waves in range(2, _HALF_WAVES + 1) if travel > 0 else ():
        order = float(f"{np.pi * half_waves / travel:.3g}")
        text = (f"sin({order:g}*q{joint})", f"cos({order:g}*q{joint})")
        values = np.column_stack([np.sin(order * way), np.cos(order * way)])
        out.append(Law(text, values, family=f"waves along q{joint}"))
    return out


def _soft_spots(angle: Array, joint: int, t: Array) -> list[Law]:
    """A joint that gives way more near one of its own angles."""
    return [
        replace(
            spot, text=(f"tau*{spot.text[0]}",), values=t[:, None] * spot.values, family=f"tau {spot.family}"
        )
        for spot in _spots(angle, joint)
    ]


def _spots(angle: Array, joint: int) -> list[Law]:
    """A joint that is off near one of its own angles."""
    low, high = float(angle.min()), float(angle.max())
    width = float(f"{(high - low) / _SPOTS:.3g}")
    out = []
    for center in np.linspace(low, high, _SPOTS + 1).round(3) if width > 0 else ():
        bump = np.exp(-(((angle - center) / width) ** 2))
        text = f"exp(-((q{joint} {'-' if center >= 0 else '+'} {abs(center):g})/{width:g})^2)"
        out.append(Law((text,), bump[:, None], family=f"near one q{joint}"))
    return out


def _linked(problem: Problem, mine: int, t: Array) -> list[Law]:
    """A joint that a linkage ties to its neighbour: products of waves of both angles, with the load and without."""
    assert problem.q is not None
    out = []
    for other in (mine - 1, mine + 1):
        if other not in range(problem.q.shape[1]) or {mine, other} & set(problem.slides):
            continue
        for n, m in ((1, 1), (2, 1), (1, 2)):
            own, of_other = _wave(problem.q[:, mine], mine + 1, n), _wave(problem.q[:, other], other + 1, m)
            text = tuple(f"{a}*{b}" for a in own[0] for b in of_other[0])
            values = np.einsum("ma,mb->mab", own[1], of_other[1]).reshape(problem.rows, -1)
            if not problem.differences:
                out.append(Law(text, values, own=False))
            if n == m:
                out.append(Law(tuple(f"tau*{x}" for x in text), t[:, None] * values, own=False))
    return out


def _clock(problem: Problem) -> tuple[str, Array]:
    """The session from 0 to 1, by time where it is told, else in the order of the rows; and its name in laws."""
    if problem.time is not None and np.ptp(problem.time) > 0:
        return "time", (problem.time - problem.time.min()) / np.ptp(problem.time)
    return "order", np.arange(problem.rows) / max(problem.rows - 1, 1)


def _lagging(clock: Array, t: Array, constant: float) -> Array:
    """A load (M,) that is followed with a time constant, as a share of the session."""
    out = np.zeros_like(t)
    z = last = 0.0
    for row in np.argsort(clock, kind="stable"):
        z = t[row] + (z - t[row]) * float(np.exp(-(clock[row] - last) / constant))
        last, out[row] = clock[row], z
    return out


def _laws_of_clock(problem: Problem, v: int) -> list[Law]:
    """Of time, or the order of the poses, and temperature, with the load and without."""
    assert problem.tau is not None
    t = problem.tau[:, v] / largest_load(problem, v)
    name, s = _clock(problem)
    out = [Law((name,), s[:, None]), Law((f"tau*{name}",), (t * s)[:, None])]
    if problem.temperature is not None and np.ptp(problem.temperature) > 0:
        warm = _unit(problem.temperature - problem.temperature.min())
        out.append(Law(("tau*temperature",), (t * warm)[:, None]))
    return out


def _by_load_case(problem: Problem, v: int) -> list[Law]:
    """A load by its place among those of its pose, from 0 to 1: what creeps gives way more under the later ones.

    Where the links' weight is known, also under the whole of it, as after a move of the arm.
    """
    if np.ptp(problem.case) < 2:
        return []
    t, case = _load(problem, v), (problem.case - problem.case.min()) / np.ptp(problem.case)
    loads = {"tau": t.total - t.before} | ({"(tau + weight)": t.total} if np.any(t.before) else {})
    growing = {"load_case": case, "sqrt(load_case)": np.sqrt(case)}
    return [
        Law((f"{name}*{text}",), (load * g)[:, None], family="tau by load_case")
        for name, load in loads.items()
        for text, g in growing.items()
    ]


def _laws_of_history(problem: Problem, v: int) -> list[Law]:
    """Of the loads that were there before: followed late, their order, and the branch with the load and without."""
    assert problem.tau is not None
    t = problem.tau[:, v] / largest_load(problem, v)
    _, s = _clock(problem)
    out = [
        Law((f"late(tau,{constant:g})",), _lagging(s, t, constant)[:, None], family="tau, late")
        for constant in _LAGS
    ]
    return [*out, *_by_load_case(problem, v), *_rubbing(problem, t)]


def _rubbing(problem: Problem, t: Array) -> list[Law]:
    """What the branch tells: in proportion to the load (M,), without it, and by its size."""
    if problem.branch is None or not np.ptp(problem.branch) > 0:
        return []
    with_load = {"branch*tau": t, "branch": np.ones_like(t), "branch*|tau|": np.abs(t)}
    return [Law((text,), (problem.branch * values)[:, None]) for text, values in with_load.items()]


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
