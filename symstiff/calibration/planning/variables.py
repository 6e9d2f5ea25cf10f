"""The unknowns of the refinement: every pose's free joints and load directions, and shared values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from symstiff.calibration.planning.candidates import Candidates, Space
from symstiff.calibration.planning.loads import wrench_of_directions

_GAP = 0.1  # of a cell: levels of one joint keep at least this distance from their cell's edges
_DIRECTION = 1.5  # bound of a direction's components; only the direction counts


@dataclass(frozen=True)
class Variables:
    """Start (V,), bounds (V,), and for every pose which variable each local coordinate is, (N, n + d), or -1.

    A pose's local coordinates are its n joint variables and the d components of its free load directions.
    ``constant`` (N, n + d) holds the values of those that are no variables; ``wrench`` (N, 6) the loads of
    poses without free directions.
    """

    start: np.ndarray
    low: np.ndarray
    high: np.ndarray
    index: np.ndarray
    constant: np.ndarray
    wrench: np.ndarray
    dof: int

    def local(self, x: np.ndarray) -> np.ndarray:
        """Return every pose's local coordinates at ``x`` (V,), (N, n + d)."""
        return np.where(self.index < 0, self.constant, x[np.maximum(self.index, 0)])

    def gather(self, gradient: np.ndarray) -> np.ndarray:
        """Sum a gradient in local coordinates (N, n + d) into one in the variables (V,)."""
        total = np.zeros(len(self.start))
        free = self.index >= 0
        np.add.at(total, self.index[free], gradient[free])
        return total


def variables_of(space: Space, chosen: Candidates) -> Variables:
    """Return the unknowns of the chosen poses: free joints, one shared value a level, load directions."""
    count, dof = chosen.q.shape
    directions = 3 * space.load.directions
    index = np.full((count, dof + directions), -1, dtype=np.int64)
    start: list[float] = []
    bounds: list[tuple[float, float]] = []
    for j in space.free:
        if j + 1 in space.levels:
            column = sorted(space.levels).index(j + 1)
            cells = _cells(space, j + 1)
            index[:, j] = len(start) + chosen.labels[:, column]
            start += list(space.level_values(j + 1))
            bounds += cells
        else:
            index[:, j] = len(start) + np.arange(count)
            start += list(chosen.q[:, j])
            bounds += [space.limits[j]] * count
    units = _units(chosen.w, space)
    for k in range(directions):
        index[:, dof + k] = len(start) + np.arange(count)
        start += list(units[:, k])
        bounds += [(-_DIRECTION, _DIRECTION)] * count
    limits = np.array(bounds).reshape(-1, 2)
    constant = np.hstack([chosen.q, units])
    return Variables(np.array(start), limits[:, 0], limits[:, 1], index, constant, chosen.w, dof)


def loads_of(space: Space, variables: Variables, local: np.ndarray) -> np.ndarray:
    """Return the wrenches (N, 6) of all poses, given their local coordinates (N, n + d)."""
    if not space.load.directions:
        return variables.wrench
    directions = list(local[:, variables.dof :].T)
    return np.stack(wrench_of_directions(space.load, directions, _length), axis=1)


def _length(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _units(w: np.ndarray, space: Space) -> np.ndarray:
    parts = [w[:, 3 * k : 3 * k + 3] / m for k, m in enumerate(space.load.magnitudes)]
    return np.hstack(parts) if parts else np.zeros((len(w), 0))


def _cells(space: Space, joint: int) -> list[tuple[float, float]]:
    low, high = space.limits[joint - 1]
    count = space.levels[joint]
    width = (high - low) / count
    inner = _GAP * width
    edges = low + width * np.arange(count + 1)
    return [
        (
            float(edges[k] + (inner if k else 0.0)),
            float(edges[k + 1] - (inner if k < count - 1 else 0.0)),
        )
        for k in range(count)
    ]
