"""Maps over a slice of the workspace: two joints swept, the others held; deflection and stiffness there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.calibration.planning.frames import Geometry, origins
from symstiff.calibration.planning.parallel import map_blocks, slices
from symstiff.calibration.planning.region import Region, allowed
from symstiff.errors import UserError

_BLOCK = 2048  # grid points a block, whatever the number of workers
Deflection = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class WorkspaceMap:
    """Values on a grid (rows, columns) of two joints.

    ``q`` (rows, columns, n); ``tip`` (rows, columns, 3), tool centre point [m]; ``deflection``
    (rows, columns, 6), [m, rad]; ``magnitude`` (rows, columns), length of the translation [m]; ``stiffness``
    (rows, columns), force over the displacement along it [N/m], NaN without a force. Off the region:
    NaN.
    """

    joints: tuple[int, int]
    q: np.ndarray
    tip: np.ndarray
    deflection: np.ndarray
    magnitude: np.ndarray
    stiffness: np.ndarray


def joint_slice(
    robot: Geometry, joints: tuple[int, int], counts: tuple[int, int], at: Mapping[int, float]
) -> np.ndarray:
    """Return a grid of configurations (rows, columns, n): two joints (1-based) swept, the others at ``at``.

    Joints that ``at`` does not name stand at zero, or at their nearest limit.
    """
    first, second = joints
    if first == second or not all(1 <= j <= robot.dof for j in (*joints, *at)):
        raise UserError(
            f"slice over joints {joints} at {dict(at)}: name two different joints of 1 to {robot.dof}"
        )
    if min(counts) < 2:
        raise UserError(f"a grid of {counts[0]} × {counts[1]}: use at least 2 × 2")
    q = np.empty((*counts, robot.dof))
    for j, (low, high) in enumerate(robot.limits):
        q[..., j] = at.get(j + 1, min(max(0.0, low), high))
    q[..., first - 1] = np.linspace(*robot.limits[first - 1], counts[0])[:, None]
    q[..., second - 1] = np.linspace(*robot.limits[second - 1], counts[1])[None, :]
    return q


def workspace_map(
    deflection: Deflection,
    robot: Geometry,
    w: np.ndarray,
    joints: tuple[int, int] = (2, 3),
    counts: tuple[int, int] = (60, 60),
    at: Mapping[int, float] | None = None,
    region: Region | None = None,
    workers: int = 1,
    cluster: str | None = None,
) -> WorkspaceMap:
    """Evaluate ``deflection(q, w)`` (N, n), (N, 6) → (N, 6) over a slice, under one wrench ``w`` (6,).

    Evaluated in fixed blocks on the machine's cores or a Dask cluster: the same map bit for bit.
    """
    load = np.asarray(w, dtype=float)
    if load.shape != (6,) or not np.all(np.isfinite(load)):
        raise UserError("a workspace map is for one wrench: six finite numbers (N, N·m)")
    q = joint_slice(robot, joints, counts, at or {})
    flat = q.reshape(-1, robot.dof)
    blocks: list[tuple[Any, ...]] = [
        (flat[cut], np.tile(load, (cut.stop - cut.start, 1))) for cut in slices(len(flat), _BLOCK)
    ]
    parts = map_blocks(deflection, blocks, workers, cluster, None, "mapping the workspace")
    moved = np.concatenate([np.asarray(part, dtype=float) for part in parts])
    moved[~allowed(region or Region(), robot, flat)] = np.nan
    return _map(joints, q, origins(robot, flat)[:, -1], moved, load)


def _map(
    joints: tuple[int, int], q: np.ndarray, tip: np.ndarray, moved: np.ndarray, load: np.ndarray
) -> WorkspaceMap:
    shape = q.shape[:2]
    force = float(np.linalg.norm(load[:3]))
    along = moved[:, :3] @ load[:3] / force if force else np.full(len(moved), np.nan)
    with np.errstate(divide="ignore"):
        stiffness = force / along
    return WorkspaceMap(
        joints,
        q,
        tip.reshape(*shape, 3),
        moved.reshape(*shape, 6),
        np.linalg.norm(moved[:, :3], axis=1).reshape(shape),
        stiffness.reshape(shape),
    )
