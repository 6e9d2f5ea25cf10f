"""The peers' geometry: one recursion over the frames and the columns J_i, for any engine's scalars.

Written with +, −, * and the engine's sine and cosine alone. What is known to be 0, 1 or −1 is never multiplied, and
nothing is computed twice, so that an engine has to find no more than it can.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.benchmarks.case import Case

Vec = list[Any]
Function = Callable[[Any], Any]


@dataclass(frozen=True)
class Style:
    """Ways to write the same sums; an engine is given the one that serves it best.

    merged: consecutive parallel axes share an angle; shared_moment: the moment on a link is formed once, instead of
    J_vᵀ·W column by column; twists: a link's deflections are added up before the lever acts, instead of J_v·Δθ_v.
    """

    merged: bool = True
    shared_moment: bool = False
    twists: bool = False


STYLES = tuple(Style(m, s, t) for m in (True, False) for s in (False, True) for t in (False, True))


def combined(coefficients: Sequence[float] | np.ndarray, vectors: Sequence[Vec]) -> Vec:
    """Σ c·v for known numbers c."""
    return [
        _total([_times(float(c), v[r]) for c, v in zip(coefficients, vectors, strict=True) if c])
        for r in range(3)
    ]


def _times(c: float, x: Any) -> Any:
    if c == 1:
        return x
    return -x if c == -1 else c * x


def _total(terms: Sequence[Any]) -> Any:
    if not terms:
        return 0
    total = terms[0]
    for x in terms[1:]:
        total = total + x
    return total


def cross(a: Vec, b: Vec) -> Vec:
    """Vector product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a: Vec, b: Vec) -> Any:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def plus(a: Vec, b: Vec) -> Vec:
    """Sum."""
    return [x + y for x, y in zip(a, b, strict=True)]


@dataclass(frozen=True)
class Frames:
    """Axes [x, y, z] of the frames 0…n up to sign, their signs, and levers from the origins to the tool centre point.

    A right angle between two axes makes one the other's opposite: the sign is kept apart, since J_v·J_vᵀ has none.
    """

    axes: list[list[Vec]]
    signs: list[list[int]]
    levers: list[Vec]


def frames(case: Case, q: Sequence[Any], cos: Function, sin: Function, merged: bool) -> Frames:
    """Orientations from the base to the tip, levers from the tip to the base; world axes."""
    axes = [[[_whole(x) for x in column] for column in case.base[0].T]]
    signs = [[1, 1, 1]]
    (x, y, z), (sx, sy, sz), angle = axes[0], signs[0], None
    start = x, y
    for row, variable in zip(case.rows, q, strict=True):
        if row.theta:
            both = sx * sy
            start = _turned(*start, _whole(np.cos(row.theta)), _whole(np.sin(row.theta)), both)
        if not row.prismatic:
            angle = variable if angle is None else angle + variable
        x, y = start if angle is None else _turned(*start, cos(angle), sin(angle), sx * sy)
        if row.cos_alpha == 0:
            y, z, sy, sz = z, y, int(row.sin_alpha) * sz, -int(row.sin_alpha) * sy
        elif row.sin_alpha:
            y, z = (
                combined([row.cos_alpha * sy, row.sin_alpha * sz], [y, z]),
                combined([row.cos_alpha * sz, -row.sin_alpha * sy], [z, y]),
            )
            sy = sz = 1
        elif row.cos_alpha == -1:
            sy, sz = -sy, -sz
        axes.append([x, y, z])
        signs.append([sx, sy, sz])
        if row.sin_alpha or row.cos_alpha != 1 or not merged:
            start, angle = (x, y), None
    return Frames(axes, signs, _levers(case, q, axes, signs))


def _levers(case: Case, q: Sequence[Any], axes: list[list[Vec]], signs: list[list[int]]) -> list[Vec]:
    lever = combined(case.tool[1] * signs[-1], axes[-1])
    levers = [lever]
    for i in range(case.dof, 0, -1):
        row = case.rows[i - 1]
        if row.a:
            lever = _moved(lever, row.a * signs[i][0], axes[i][0])
        if row.d or row.prismatic:
            lever = _moved(lever, row.d * signs[i - 1][2], axes[i - 1][2])
        if row.prismatic:
            lever = _moved(lever, signs[i - 1][2] * q[i - 1], axes[i - 1][2])
        levers.append(lever)
    return levers[::-1]


def _moved(lever: Vec, length: Any, axis: Vec) -> Vec:
    return [x + length * e for x, e in zip(lever, axis, strict=True)]


def _whole(x: float) -> Any:
    return round(x) if abs(x - round(x)) < 1e-15 else float(x)


def _turned(x: Vec, y: Vec, c: Any, s: Any, sign: int) -> tuple[Vec, Vec]:
    """c·x + s·y and c·y − s·x; ``sign`` −1 where exactly one of x and y is known by its opposite."""
    if sign > 0:
        return [c * u + s * v for u, v in zip(x, y, strict=True)], [
            c * v - s * u for u, v in zip(x, y, strict=True)
        ]
    return [c * u - s * v for u, v in zip(x, y, strict=True)], [
        c * v + s * u for u, v in zip(x, y, strict=True)
    ]


class Columns:
    """Columns J_v and loads τ_v = J_vᵀ·W of the virtual joints that the parameters speak of, up to a common sign."""

    def __init__(self, case: Case, f: Frames, w: Sequence[Any], style: Style) -> None:
        self.case, self.f, self.style = case, f, style
        self.force, self.couple = list(w[:3]), list(w[3:])
        self._directions: dict[tuple[int, int], tuple[int, Vec]] = {}
        self._columns: dict[tuple[int, int], tuple[Vec, Vec]] = {}
        self._loads: dict[tuple[int, int], Any] = {}
        self._moments: dict[int, Vec] = {}

    def direction(self, body: int, axis: int) -> Vec:
        """Elastic axis 1…3 (and again 4…6) of a link, or a joint's axis (0), in world axes, up to sign."""
        return self._direction(body, axis)[1]

    def sign(self, body: int, axis: int) -> int:
        """The sign that was left out."""
        return self._direction(body, axis)[0]

    def _direction(self, body: int, axis: int) -> tuple[int, Vec]:
        if axis == 0:
            return self.f.signs[body - 1][2], self.f.axes[body - 1][2]
        key = (body, (axis - 1) % 3)
        if key not in self._directions:
            e = self.case.elastic_axes(body)[:, key[1]] * self.f.signs[body]
            single = int(np.argmax(np.abs(e)))
            if abs(e[single]) == 1:
                self._directions[key] = int(e[single]), self.f.axes[body][single]
            else:
                self._directions[key] = 1, combined(e, self.f.axes[body])
        return self._directions[key]

    def is_translation(self, body: int, axis: int) -> bool:
        """Whether a virtual joint translates."""
        return 1 <= axis <= 3 or (axis == 0 and self.case.rows[body - 1].prismatic)

    def lever(self, body: int, axis: int) -> Vec:
        """From a virtual joint to the tool centre point."""
        return self.f.levers[body - 1 if axis == 0 else body]

    def column(self, body: int, axis: int) -> tuple[Vec, Vec]:
        """J_v: translation and rotation of the tool centre point."""
        key = (body, axis)
        if key not in self._columns:
            e = self.direction(body, axis)
            translation = self.is_translation(body, axis)
            self._columns[key] = (e, [0, 0, 0]) if translation else (cross(e, self.lever(body, axis)), e)
        return self._columns[key]

    def load(self, body: int, axis: int) -> Any:
        """τ_v."""
        key = (body, axis)
        if key not in self._loads:
            self._loads[key] = self._load(body, axis)
        return self._loads[key]

    def _load(self, body: int, axis: int) -> Any:
        if self.is_translation(body, axis):
            return dot(self.direction(body, axis), self.force)
        if self.style.shared_moment:
            place = body - 1 if axis == 0 else body
            if place not in self._moments:
                self._moments[place] = plus(self.couple, cross(self.f.levers[place], self.force))
            return dot(self.direction(body, axis), self._moments[place])
        linear, angular = self.column(body, axis)
        return dot(linear, self.force) + dot(angular, self.couple)


def observation(case: Case, columns: Columns) -> list[list[Any]]:
    """A, 6 rows of one entry a parameter: J_a·τ_b, and J_b·τ_a for a coupling (seed eq. 5, 12)."""
    matrix: list[list[Any]] = [[] for _ in range(6)]
    for e in case.entries:
        a, b = (e.body, e.row), (e.body, e.column)
        if a == b:
            total = [x * columns.load(*a) for x in _six(columns.column(*a))]
        else:
            total = _coupling(
                _six(columns.column(*a)), columns.load(*b), _six(columns.column(*b)), columns.load(*a)
            )
            if columns.sign(*a) * columns.sign(*b) < 0:
                opposite = -columns.load(*a)
                pairs = zip(_six(columns.column(*a)), _six(columns.column(*b)), strict=True)
                total = [y * opposite - x * columns.load(*b) for x, y in pairs]
        for row, x in zip(matrix, total, strict=True):
            row.append(x)
    return matrix


def _six(column: tuple[Vec, Vec]) -> Vec:
    return [*column[0], *column[1]]


def _coupling(first: Vec, by_first: Any, second: Vec, by_second: Any) -> Vec:
    return [x * by_first + y * by_second for x, y in zip(first, second, strict=True)]


def deflection(case: Case, columns: Columns, k: Sequence[Any]) -> list[Any]:
    """ΣJ_v·Δθ_v with Δθ = k·τ (seed eq. 2): no observation matrix is formed."""
    amounts: dict[tuple[int, int], Any] = {}
    for e, value in zip(case.entries, k, strict=True):
        a, b = (e.body, e.row), (e.body, e.column)
        for at, by in sorted({(a, b), (b, a)}):
            term = value * columns.load(*by)
            if columns.sign(*at) * columns.sign(*by) < 0:
                amounts[at] = amounts[at] - term if at in amounts else -term
            else:
                amounts[at] = amounts[at] + term if at in amounts else term
    if columns.style.twists:
        return _by_twists(columns, amounts)
    total: list[Any] = [0] * 6
    for joint, amount in amounts.items():
        total = plus(total, [x * amount for x in _six(columns.column(*joint))])
    return total


def _by_twists(columns: Columns, amounts: dict[tuple[int, int], Any]) -> list[Any]:
    linear: Vec = [0, 0, 0]
    angular: Vec = [0, 0, 0]
    turns: dict[int, Vec] = {}
    for (body, axis), amount in amounts.items():
        motion = [x * amount for x in columns.direction(body, axis)]
        if columns.is_translation(body, axis):
            linear = plus(linear, motion)
        else:
            place = body - 1 if axis == 0 else body
            turns[place] = plus(turns[place], motion) if place in turns else motion
    for place, turn in turns.items():
        linear = plus(linear, cross(turn, columns.f.levers[place]))
        angular = plus(angular, turn)
    return [*linear, *angular]
