"""Laws without a name of joints' variables: series, waves of two neighbours, spots, what repeats along a slide."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from symstiff.arrays import Array
from symstiff.discrepancy.laws.law import Law, largest_load
from symstiff.discrepancy.problem import Problem

_SPOTS = 6
"""Widths of a spot that a joint's range holds."""
_HALF_WAVES = 32
"""Half waves over a slide's way up to which errors that repeat along it are looked for."""


def laws_of_angle(problem: Problem, v: int) -> list[Law]:
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
        yield n, *wave(angle, joint, n)


def wave(angle: Array, joint: int, n: int) -> tuple[tuple[str, str], Array]:
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
            own, of_other = wave(problem.q[:, mine], mine + 1, n), wave(problem.q[:, other], other + 1, m)
            text = tuple(f"{a}*{b}" for a in own[0] for b in of_other[0])
            values = np.einsum("ma,mb->mab", own[1], of_other[1]).reshape(problem.rows, -1)
            if not problem.differences:
                out.append(Law(text, values, own=False))
            if n == m:
                out.append(Law(tuple(f"tau*{x}" for x in text), t[:, None] * values, own=False))
    return out
