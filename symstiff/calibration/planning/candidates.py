"""Candidate poses: drawn over the joint limits by a Sobol sequence, kept where the region allows them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from symstiff.calibration.planning.frames import Geometry
from symstiff.calibration.planning.loads import Load, draw_loads
from symstiff.calibration.planning.measurement import Measurement, whitened_rows
from symstiff.calibration.planning.parallel import Progress, slices, stream_blocks
from symstiff.calibration.planning.region import Region, allowed
from symstiff.errors import UserError

BLOCK = 2048  # candidates a block; part of the result's definition, so never a function of the workers
_GIVE_UP = 64  # draws per wanted candidate
_SURE = 4  # batches from which a share of allowed draws so many times too small is no chance
_SAME = 0.02  # of half a turn, within which two levels of a joint count as half a turn apart
Observation = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Space:
    """Where poses may be: joint limits, fixed joints [rad, m], joints with few values, region, load.

    ``fixed`` and ``levels`` are keyed by joint, 1-based. ``levels={2: 5}`` gives a plan exactly five distinct
    values of q2.
    """

    robot: Geometry
    load: Load = field(default_factory=Load)
    region: Region = field(default_factory=Region)
    fixed: Mapping[int, float] = field(default_factory=dict)
    levels: Mapping[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, joints in (("fixed", self.fixed), ("levels", self.levels)):
            if wrong := [joint for joint in joints if not 1 <= joint <= self.robot.dof]:
                raise UserError(f"{name}: q{wrong[0]}: {self.robot.name} has joints 1 to {self.robot.dof}")
        for joint, value in self.fixed.items():
            low, high = self.robot.limits[joint - 1]
            if not low <= value <= high:
                raise UserError(f"fixed: q{joint} = {value:g} is outside its limits [{low:g}, {high:g}]")
        for joint, count in self.levels.items():
            if joint in self.fixed:
                raise UserError(f"levels: q{joint} is fixed: it cannot take {count} values")
            if count < 1:
                raise UserError(f"levels: q{joint}: {count}: use at least one value")

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Of the joints that vary, the region's margin kept from them."""
        kept = self.region.margin
        return tuple(
            (low + kept * (high - low), high - kept * (high - low)) for low, high in self.robot.limits
        )

    @property
    def free(self) -> tuple[int, ...]:
        """Joints that vary, 0-based."""
        return tuple(j for j in range(self.robot.dof) if j + 1 not in self.fixed)

    def level_values(self, joint: int) -> np.ndarray:
        """Values that joint ``joint`` (1-based) takes among the candidates: the centres of equal cells.

        Where some are half a turn apart, or whole turns, they tell the same but for signs: their steps are wider then.
        """
        low, high = self.limits[joint - 1]
        count = self.levels[joint]
        cell, width = np.arange(count), (high - low) / count
        half_turns = width * cell[1:] / np.pi
        turns = not self.robot.rows[joint - 1][0]
        wider = turns and np.any(np.abs(half_turns - np.round(half_turns)) < _SAME)
        within = 0.25 + 0.5 * (cell + 0.5) / count if wider else 0.5
        return np.asarray(low + (cell + within) * width)


@dataclass(frozen=True)
class Candidates:
    """Configurations q (N, n), wrenches w (N, 6) and, for every joint of ``levels``, which level (N, g)."""

    q: np.ndarray
    w: np.ndarray
    labels: np.ndarray

    def __len__(self) -> int:
        return len(self.q)


def draw(space: Space, count: int, seed: int) -> Candidates:
    """Draw ``count`` candidates that keep the region.

    The same seed gives the same candidates. Raises UserError where fewer than one draw in 64 is allowed.
    """
    from scipy.stats import qmc

    free, load = space.free, space.load
    dimensions = len(free) + load.coordinates
    sequence = qmc.Sobol(max(1, dimensions), scramble=True, seed=seed)
    batch = 1 << max(8, (count - 1).bit_length())
    found: list[tuple[np.ndarray, ...]] = []
    total = drawn = 0
    while total < count and drawn < _GIVE_UP * count:
        uniform = sequence.random(batch)
        q, labels = _configurations(space, uniform)
        keep = allowed(space.region, space.robot, q)
        found.append((q[keep], draw_loads(load, uniform[:, len(free) :])[keep], labels[keep]))
        total, drawn = total + int(keep.sum()), drawn + batch
        if drawn >= _SURE * batch and total * _GIVE_UP * _SURE < drawn:
            break  # no further draws would make up for that
    if total == 0:
        raise UserError(
            f"none of {drawn} configurations drawn within the joint limits keeps the region: relax "
            f"{_relax(space.region)}{'; a box that holds the base lets none pass' * bool(space.region.boxes)}"
        )
    if total < count:
        raise UserError(
            f"only {total} of {drawn} configurations drawn within the joint limits keep the region; {count} "
            f"are wanted: relax {_relax(space.region)}, or ask for fewer candidates"
        )
    q, w, labels = (np.concatenate(parts)[:count] for parts in zip(*found, strict=True))
    _check_levels(space, labels)
    return Candidates(q, w, labels)


def _relax(region: Region) -> str:
    """What a region asks for, in words."""
    asked = {"the keep-out boxes": region.boxes, "the floor": region.half_spaces, "the reach": region.reach}
    return " or ".join(what for what, given in asked.items() if given) or "the region"


def _configurations(space: Space, uniform: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    limits = np.array(space.limits)
    q = np.empty((len(uniform), space.robot.dof))
    for joint, value in space.fixed.items():
        q[:, joint - 1] = value
    for column, j in enumerate(space.free):
        q[:, j] = limits[j, 0] + uniform[:, column] * (limits[j, 1] - limits[j, 0])
    labels = np.zeros((len(uniform), len(space.levels)), dtype=np.int64)
    for g, joint in enumerate(sorted(space.levels)):
        values = space.level_values(joint)
        share = uniform[:, space.free.index(joint - 1)]
        labels[:, g] = np.minimum((share * len(values)).astype(int), len(values) - 1)
        q[:, joint - 1] = values[labels[:, g]]
    return q, labels


def _check_levels(space: Space, labels: np.ndarray) -> None:
    for g, joint in enumerate(sorted(space.levels)):
        values = space.level_values(joint)
        missing = sorted(set(range(len(values))) - set(labels[:, g].tolist()))
        if missing:
            raise UserError(
                f"no allowed configuration has q{joint} = {values[missing[0]]:.4g}: ask for fewer levels of "
                "that joint or relax the keep-out region"
            )


@dataclass(frozen=True)
class Evaluator:
    """Whitened rows of the observation matrix at candidates; picklable when ``observation`` is."""

    observation: Observation
    robot: Geometry
    measurement: Measurement

    def __call__(self, q: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Return the rows of N candidates, (m, N, P). Raises UserError on a non-finite entry."""
        matrix = np.asarray(self.observation(q, w), dtype=float)
        if matrix.ndim != 3 or matrix.shape[:2] != (len(q), 6):
            raise UserError(f"the observation matrix has shape {matrix.shape}: expected ({len(q)}, 6, P)")
        if not np.all(np.isfinite(matrix)):
            raise UserError(
                "the observation matrix has entries that are not finite: check the model's effects"
            )
        return whitened_rows(self.measurement, self.robot, q, matrix)


def evaluate(
    evaluator: Evaluator,
    candidates: Candidates,
    workers: int = 1,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> np.ndarray:
    """Return the rows of all candidates, (m, N, P), in blocks of 2048; the workers change no bit."""
    cuts = slices(len(candidates), BLOCK)
    blocks: list[tuple[Any, ...]] = [(candidates.q[cut], candidates.w[cut]) for cut in cuts]
    rows: np.ndarray | None = None
    results = stream_blocks(evaluator, blocks, workers, cluster, progress, "evaluating candidates")
    for cut, block in zip(cuts, results, strict=True):
        if rows is None:
            rows = np.empty((block.shape[0], len(candidates), block.shape[2]))
        rows[:, cut] = block
    assert rows is not None
    return rows
