"""Measurement poses for a stiffness model: ``planning`` at array level, given a robot's own model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from symstiff.calibration.planning import (
    Geometry,
    Goal,
    Load,
    Measurement,
    Plan,
    Region,
    Search,
    Space,
    WorkspaceMap,
    geometry,
    measurement_of,
    plan_poses,
    workspace_map,
)
from symstiff.calibration.planning.parallel import Progress
from symstiff.errors import A_MODEL, require
from symstiff.model import StiffnessModel

__all__ = [
    "Goal",
    "Load",
    "Measurement",
    "Plan",
    "Region",
    "Search",
    "casadi_observation",
    "plan_for",
    "workspace_for",
]


def plan_for(
    model: StiffnessModel,
    goal: Goal,
    load: Load | None = None,
    markers: Sequence[str] = (),
    sigma: tuple[float, float] = (30e-6, 100e-6),
    region: Region | None = None,
    fixed: Mapping[int, float] | None = None,
    levels: Mapping[int, int] | None = None,
    search: Search | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Choose poses that identify the parameters of a model.

    ``load`` is of the model's class, 1 kN, where not given. ``markers`` are measured points (a position
    model without any measures the tool centre point); ``sigma`` the noise of a translation [m] and a rotation
    [rad].
    ``fixed`` and ``levels`` by joint, 1-based. Raises UserError as ``plan_poses`` does.
    """
    require(model, StiffnessModel, *A_MODEL)
    require(goal, Goal, "a goal", "Goal(15) asks for 15 poses")
    robot: Geometry = geometry(model.robot)
    points = tuple(markers) or (("tcp",) if model.measure == "position" else ())
    space = Space(
        robot,
        (load or Load(_load_class(model.loads))).on_arm(model.robot.reach),
        region or Region(),
        dict(fixed or {}),
        dict(levels or {}),
    )
    from symstiff.codegen.runtime import for_poses

    search = search or Search()
    # machines of a cluster need not have our compiler, and all blocks come from one arithmetic
    observation = model.observation if search.cluster else for_poses(model, search.candidates).observation
    return plan_poses(
        space,
        observation,
        model.parameters,
        goal,
        measurement_of(model.robot, points, *sigma),
        search,
        casadi_observation(model),
        progress,
    )


def workspace_for(
    model: StiffnessModel,
    w: np.ndarray,
    joints: tuple[int, int] = (2, 3),
    counts: tuple[int, int] = (60, 60),
    at: Mapping[int, float] | None = None,
    region: Region | None = None,
    workers: int = 1,
) -> WorkspaceMap:
    """Map a model's deflection under one wrench ``w`` (6,) over two joints, the others at ``at`` or zero."""
    from symstiff.codegen.runtime import for_poses

    deflection = for_poses(model, counts[0] * counts[1]).deflection
    return workspace_map(deflection, geometry(model.robot), w, joints, counts, at, region, workers)


def casadi_observation(model: StiffnessModel) -> Callable[[Any, Any], Any] | None:
    """Return the observation matrix of one pose as a CasADi expression of q (n) and w (6), shape (6, P).

    None for a model whose columns are not all of the stiffness program (effects): refinement is numeric then.
    """
    if model.effects:
        return None
    from symstiff.codegen.casadi import casadi_function

    function = casadi_function(model.observation_program, "observation")
    return lambda q, w: function(q, w)


def robot_of(model: StiffnessModel) -> Geometry:
    """Return the floating-point chain that tables and plots of a plan need."""
    return geometry(model.robot)


def _load_class(loads: str) -> Any:
    return loads if loads in ("gravity", "force") else "wrench"
