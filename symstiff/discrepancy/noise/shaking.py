"""What the rows of one reading share beside its pose: a load that swings, a joint that stops elsewhere each time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.arrays import TINY, Array, Index, numbered
from symstiff.discrepancy.noise.blocks import Roots, blocks
from symstiff.discrepancy.problem import Problem

_SURE, _PAIRS, _SHAKES = 4.0, 60, 0.25
"""Standard deviations, pairs of rows and variance from which the markers of one reading are taken to share an error."""
_LEAST_OWN = 0.02
"""Share of the noise's variance that each marker has alone, at least."""
_SETTLES, _NOTABLE, _FEWEST = 6.0, 1.6, 20
"""Standard deviations above one, and times the variance of other directions, from which a joint is taken to settle
anew at every reading; degrees of freedom along it and beside it that it takes."""
_SLIPS = 0.05
"""Share of the poses that does not count for that."""
_STEPS = 100
_ROUNDING = 1e-6
"""Part of a pattern's length in a reading that is none, beside those that were taken out."""


@dataclass(frozen=True)
class Shaken:
    """Variances over the noise's of what the rows of one reading share."""

    axes: float = 0.0
    """Of an error of every axis that all markers have."""
    joints: tuple[tuple[int, float], ...] = ()
    """Of errors of joints [rad² or m²], by their 0-based number."""

    def __bool__(self) -> bool:
        return self.axes > 0.0 or bool(self.joints)

    def change(self, other: Shaken) -> float:
        """How much another one differs: by the axes' variance, or beyond all bounds by which joints have one."""
        same = {j for j, _ in self.joints} == {j for j, _ in other.joints}
        return abs(self.axes - other.axes) if same else np.inf


STILL = Shaken()
"""Nothing shook."""


def shared_by_readings(problem: Problem, spread: Array, shaken: Shaken) -> Roots:
    """The blocks of what the rows of each reading share, in units of the noise; none where that is nothing."""
    if not shaken:
        return ()
    axes = np.sqrt(shaken.axes) * common_size(problem, spread) / spread
    if not shaken.joints:
        return blocks(readings(problem), axes[:, None])
    of_axis = [axes * (problem.axis == a) for a in np.unique(problem.axis)] if shaken.axes > 0.0 else []
    of_joint = [np.sqrt(v) * _moved(problem, j) / spread for j, v in shaken.joints]
    return blocks(_at_once(problem), np.column_stack([*of_joint, *of_axis]))


def readings(problem: Problem) -> Index:
    """(M,) a number for pose, load case, repeat and axis together: the markers that are read at a time."""
    return numbered(_at_once(problem), problem.axis)


def repeats(problem: Problem) -> Index:
    """(M,) a number for pose, repeat and axis together; for pose and axis where there are no repeats."""
    return problem.lines if problem.turn is None else numbered(problem.lines, problem.turn)


def common_size(problem: Problem, spread: Array) -> Array:
    """(M,) one size for the metres and one for the radians: a shared error has those units."""
    common = np.ones(problem.rows)
    for kind in (problem.axis < 3, problem.axis >= 3):
        common[kind] = np.sqrt(np.mean(spread[kind] ** 2)) if np.any(kind) else 1.0
    return common


def shaken(problem: Problem, z: Array, spread: Array, approach: Index) -> Shaken:
    """What readings share, as far as it is beyond doubt, by the residual z (M,) in units of ``spread`` (M,).

    Rows of one ``approach`` (M,) share an error that is no reading's own.
    """
    joints, (common, *apart) = _of_joints(problem, z, spread, approach)
    if not joints:
        return Shaken(of_axes(problem, z))
    if not apart:
        return Shaken(0.0, tuple((j, v / common.variance) for j, v in joints))
    own, markers = max(apart[0].variance, TINY), len(z) / len(common.z)
    axes = common.variance / own - 1.0 / markers
    sure = _SURE * np.sqrt(2.0 / common.beside + 2.0 / apart[0].beside) / markers
    return Shaken(axes if axes > max(sure, _SHAKES) else 0.0, tuple((j, v / own) for j, v in joints))


def _at_once(problem: Problem) -> Index:
    """(M,) a number for pose, load case and repeat together."""
    turn = () if problem.turn is None else (problem.turn,)
    return numbered(problem.pose, problem.case, *turn)


def _moved(problem: Problem, joint: int) -> Array:
    """(M,) what one of the joints moves."""
    assert problem.J is not None
    return np.asarray(problem.J[:, problem.joint_of.index(joint)])


def of_axes(problem: Problem, z: Array) -> float:
    """Variance of an error that the markers of one reading share over that of each alone, 0 where it may be none.

    By moments of the residual (M,): products of rows of one reading, less those of other readings of the pose and,
    since the robot may have come to it anew, of its repeat.
    """
    together, pairs = products(z, readings(problem))
    of_repeat, all_pairs = products(z, repeats(problem))
    if pairs < _PAIRS or all_pairs - pairs < _PAIRS:
        return 0.0
    shared = together / pairs - (of_repeat - together) / (all_pairs - pairs)
    square = float(np.mean(z**2))
    # pairs are counted twice
    if shared < _SURE * square / np.sqrt(0.5 * pairs):
        return 0.0
    own = square - together / pairs
    found = shared / max(own, _LEAST_OWN * square)
    return float(found) if found > _SHAKES else 0.0


def products(z: Array, label: Index) -> tuple[float, float]:
    """Sum of products of different rows of the same label, and how many there are."""
    number = numbered(label)
    total, square = np.bincount(number, z), np.bincount(number, z**2)
    count = np.bincount(number).astype(float)
    return float(np.sum(total**2 - square)), float(np.sum(count * (count - 1)))


def _of_joints(
    problem: Problem, z: Array, spread: Array, approach: Index
) -> tuple[list[tuple[int, float]], list[_Scatter]]:
    """Joints along whose motion readings of one approach scatter beyond doubt, with the variances of their errors; and
    what is left beside them of each scatter.

    One after the other, the largest first, and what the markers of a reading have in common, which a load that swings
    moves, apart from how they differ.
    """
    whole = left = _scatters(problem, z, approach)
    joints = [] if problem.J is None else [j for j in problem.joint_of if j >= 0]
    moved = {j: _moved(problem, j) / spread for j in joints}
    found: list[int] = []
    while len(found) < len(joints) and left[0].room:
        told = {j: max(s.along(moved[j]) for s in left) for j in joints if j not in found}
        best = max(told, key=lambda j: told[j])
        if told[best][0] < _SETTLES or told[best][1] < _NOTABLE:
            break
        found.append(best)
        left = [s.without(moved[best]) for s in left]
    variances = _variances(whole, left, [moved[j] for j in found]) if found else []
    return list(zip(found, variances, strict=True)), left


@dataclass(frozen=True)
class _Scatter:
    """Readings about the means of their approaches: what the markers have in common, or how they differ."""

    z: Array
    """(C,) by reading and axis, or (M,) of rows."""
    cell: Index
    """(M,) number of each row's reading and axis."""
    reading: Index
    """(C,) or (M,)"""
    pose: Index
    """(R,) of each reading."""
    differ: bool
    freedom: float
    """Degrees of freedom of one direction in each reading."""
    beside: float
    """Degrees of freedom of all directions that are left."""
    taken: tuple[Array, ...] = ()
    """Unit directions in each reading that were taken out."""

    @property
    def variance(self) -> float:
        """Of the directions that are left."""
        return float(self.z @ self.z) / max(self.beside, 1.0)

    @property
    def room(self) -> bool:
        """Whether enough is left beside one direction more."""
        return min(self.freedom, self.beside - self.freedom) >= _FEWEST

    def seen(self, x: Array) -> Array:
        """A pattern's (M,) part in it."""
        mean = _mean(x, self.cell)
        return np.asarray(x - mean[self.cell] if self.differ else mean)

    def sums(self, x: Array) -> Array:
        """(R,) sums by reading."""
        return np.asarray(np.bincount(self.reading, x), dtype=float)

    def unit(self, x: Array) -> tuple[Array, Array]:
        """Unit directions in each reading along a pattern (M,), beside what was taken out; their lengths (R,)."""
        whole = x = self.seen(x)
        for taken in self.taken:
            x = x - taken * self.sums(taken * x)[self.reading]
        length = np.sqrt(self.sums(x**2))
        length = np.where(length > _ROUNDING * np.sqrt(self.sums(whole**2)), length, 0.0)
        own = length[self.reading]
        return np.where(own > 0.0, x, 0.0) / np.where(own > 0.0, own, 1.0), length

    def along(self, x: Array) -> tuple[float, float]:
        """By how many standard deviations the scatter along a pattern (M,) exceeds that beside it, and how many times.

        Readings count as the pattern is long in them; those of the poses that bring most do not: a slip is no habit.
        """
        unit, length = self.unit(x)
        rest = self.beside - self.freedom
        if not self.room or not np.any(length):
            return 0.0, 1.0
        square = self.sums(unit * self.z) ** 2
        other = max(float(self.z @ self.z) - float(np.sum(square)), TINY) / rest
        weight = length**2 / float(np.sum(length**2))
        count = len(weight) / self.freedom  # the means of the poses took the rest
        by_pose = np.sort(np.bincount(self.pose, weight * square))
        kept = by_pose[: len(by_pose) - math.ceil(_SLIPS * len(by_pose))]
        ratio = count * float(np.sum(kept)) / other
        deviation = np.sqrt(2.0 * count * float(np.sum(weight**2)) + 2.0 / rest)
        return (ratio - 1.0) / deviation, ratio

    def without(self, x: Array) -> _Scatter:
        """What is left beside a pattern (M,)."""
        unit, length = self.unit(x)
        z = self.z - unit * self.sums(unit * self.z)[self.reading]
        beside = self.beside - self.freedom * float(np.mean(length > 0.0))
        return replace(self, z=z, taken=(*self.taken, unit), beside=beside)


def _scatters(problem: Problem, z: Array, approach: Index) -> list[_Scatter]:
    """The scatter of a residual (M,): what the markers of a reading have in common, and of several how they differ."""
    cell, row = readings(problem), _at_once(problem)
    _, first = np.unique(cell, return_index=True)
    reading, line = row[first], numbered(approach[first], problem.axis[first])
    pose = problem.pose[np.unique(row, return_index=True)[1]]
    freedom = float(len(pose) - len(np.unique(approach)))
    lines, cells = int(line.max()) + 1, len(first)
    common = _mean(z, cell)
    common = common - _mean(common, line)[line]
    out = [_Scatter(common, cell, reading, pose, False, freedom, float(cells - lines))]
    if len(z) > cells:
        series = numbered(approach, problem.channel)
        differ = z - _mean(z, cell)[cell]
        differ = differ - _mean(differ, series)[series]
        beside = float(len(z) - cells - series.max() - 1 + lines)
        out.append(_Scatter(differ, cell, row, pose, True, freedom, beside))
    return out


def _mean(x: Array, label: Index) -> Array:
    """Means of values (M,) by label."""
    return np.asarray(np.bincount(label, x) / np.bincount(label))


def _variances(whole: Sequence[_Scatter], left: Sequence[_Scatter], patterns: Sequence[Array]) -> list[float]:
    """Of errors with patterns (M,) in the whole scatter, by expectation-maximisation beside the noise that is left."""
    seen, gram = np.zeros(()), np.zeros(())
    for scatter, noise in zip(whole, left, strict=True):
        deviation = np.sqrt(max(noise.variance, TINY))
        # the means of the poses took a part of the scatter
        z = scatter.z / deviation * np.sqrt(len(scatter.sums(scatter.z)) / scatter.freedom)
        F = [scatter.seen(x) / deviation for x in patterns]
        seen = seen + np.stack([scatter.sums(f * z) for f in F], axis=1)
        gram = gram + np.stack([np.stack([scatter.sums(f * g) for f in F], axis=1) for g in F], axis=1)
    size = np.einsum("rii->ri", gram)
    w = np.maximum(np.sum(seen**2 - size, axis=0) / np.maximum(np.sum(size**2, axis=0), TINY), TINY)
    for _ in range(_STEPS):
        # (gram + 1/w)⁻¹ without dividing by a variance that is nothing
        S = np.linalg.solve(np.eye(len(w)) + w[:, None] * gram, np.broadcast_to(np.diag(w), gram.shape))
        mean = np.einsum("rij,rj->ri", S, seen)
        w = np.mean(mean**2 + np.einsum("rii->ri", S), axis=0)
    return [float(v) for v in w]
