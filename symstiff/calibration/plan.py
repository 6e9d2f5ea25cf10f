"""Measurement poses for a stiffness model: ``planning`` at array level, given a robot's own model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from symstiff.arguments import A_MODEL, listener, number, require, whole, words
from symstiff.calibration.doubts.soundness import outside_class, outside_fixed
from symstiff.calibration.planning import (
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
from symstiff.errors import UserError
from symstiff.model import StiffnessModel
from symstiff.states import Context

__all__ = [
    "Goal",
    "Load",
    "Measurement",
    "Plan",
    "Region",
    "Search",
    "casadi_observation",
    "plan",
    "workspace_for",
]

_CLASSES = ("gravity", "force", "wrench")
"""Classes of loads, each within the next."""


def plan(
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
    context: Context | None = None,
) -> Plan:
    """Choose poses that identify the parameters of a model.

    ``load`` is of the model's class, 1 kN, where not given. ``markers`` are measured points (a position
    model without any measures the tool centre point); ``sigma`` the noise of a translation [m] and a rotation
    [rad].
    ``fixed`` and ``levels`` by joint, 1-based. ``context`` are the numbers that laws need while the poses are measured,
    as ``{"time": 600.0}`` [s] for a drift or ``{"branch": 1}`` for a hysteresis. Raises UserError as ``plan_poses``
    does, for loads, test loads and test poses that the model was not reduced for, and without a number that laws need.
    """
    from symstiff.codegen.runtime import for_poses

    require(model, StiffnessModel, *A_MODEL)
    require(goal, Goal, "a goal", "Goal(15) asks for 15 poses")
    given = words(markers, "markers", "['p1', 'p2', 'p3']")
    points = given or (("tcp",) if model.measure == "position" else ())
    load, region, search = load or Load(_load_class(model.loads)), region or Region(), search or Search()
    _check_kinds(load, region, progress, search)
    _check_class(model, load)
    _check_tests(model, goal)
    deviations = _two(sigma)
    space = Space(
        geometry(model.robot),
        load.on_arm(model.robot.reach),
        region,
        _by_joint(fixed, "fixed"),
        _by_joint(levels, "levels"),
    )
    # machines of a cluster need not have our compiler, and all blocks come from one arithmetic
    observation = model.observation if search.cluster else for_poses(model, search.candidates).observation
    if context:
        observation = partial(observation, context=context)
    return plan_poses(
        space,
        observation,
        model.parameters,
        goal,
        measurement_of(model.robot, points, *deviations),
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
    context: Context | None = None,
) -> WorkspaceMap:
    """Map a model's deflection under one wrench ``w`` (6,) over two joints, the others at ``at`` or zero.

    ``w`` [N, N·m] at the tool centre point in base axes, ``at`` [rad, m] by joint, 1-based; ``context`` numbers that
    laws need, as ``{"time": 600.0}`` [s]. Raises UserError for other joints or loads, and without such a number.
    """
    from symstiff.codegen.runtime import for_poses

    deflection = partial(for_poses(model, counts[0] * counts[1]).deflection, context=context)
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


def _check_kinds(load: Load, region: Region, progress: Progress | None, search: Search) -> None:
    """Refuse arguments of another kind."""
    require(load, Load, "a load", "Load('gravity', 1000.0) is one, in newtons")
    require(region, Region, "a region", "Region(half_spaces=(above_floor(0.3),)) is one")
    listener(progress)
    require(search, Search, "a search", "Search(candidates=5000) is one")


def _check_class(model: StiffnessModel, load: Load) -> None:
    """Refuse loads that a model was not reduced for: what they do to the robot is not in it."""
    cases = np.asarray(load.cases)
    used = (2 if cases[:, 3:].any() else int(cases[:, :2].any())) if len(cases) else _CLASSES.index(load.kind)
    if model.loads in _CLASSES and used > _CLASSES.index(model.loads):
        wider = _CLASSES[used]
        raise UserError(
            f"the model is reduced for {model.loads} loads and these are of class {wider}: plan with "
            f"Load({model.loads!r}), or reduce the robot with loads={wider!r}"
        )


def _check_tests(model: StiffnessModel, goal: Goal) -> None:
    """Refuse test poses and loads that a model was not reduced for: no plan foretells their errors."""
    q, w = goal.test_q, goal.test_w
    if q is None or w is None or (np.shape(q)[1:], np.shape(w)[1:]) != ((model.robot.dof,), (6,)):
        return  # what evaluates them refuses other shapes
    if remarks := [*outside_class(w, model.loads), *outside_fixed(q, model)]:
        raise UserError(f"test poses: {remarks[0]}")


def _two(sigma: Any) -> tuple[float, float]:
    """Standard deviations of a translation [m] and a rotation [rad]. Raises UserError."""
    what = "sigma: expected two standard deviations, (30e-6, 100e-6) for metres and radians"
    if not isinstance(sigma, Sequence | np.ndarray) or isinstance(sigma, str) or len(sigma) != 2:
        raise UserError(f"{what}, found {sigma!r:.40}")
    return number(sigma[0], "sigma", "metres above zero", 0.0), number(
        sigma[1], "sigma", "radians above zero", 0.0
    )


def _by_joint(values: Any, name: str) -> dict[int, Any]:
    """Values of joints by their numbers: positions of ``fixed``, numbers of ``levels``. Raises UserError."""
    require(values or {}, Mapping, f"{name} by joint", f"write {name}={{2: 3}} for q2")
    if name == "levels":
        return {whole(j, name, 1): whole(v, f"levels: q{j}", 1) for j, v in (values or {}).items()}
    return {whole(j, name, 1): number(v, f"fixed: q{j}") for j, v in (values or {}).items()}


def _load_class(loads: str) -> Any:
    return loads if loads in ("gravity", "force") else "wrench"
