"""Continuous refinement of chosen poses: IPOPT on the symbolic model, or L-BFGS-B on the numeric one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.calibration.planning.candidates import Candidates, Evaluator, Space
from symstiff.calibration.planning.criteria import Criterion, information_of
from symstiff.calibration.planning.frames import frames
from symstiff.calibration.planning.loads import wrench_of_directions
from symstiff.calibration.planning.measurement import whitened_rows_symbolic
from symstiff.calibration.planning.region import allowed, clearance, constraint_values, planes_around
from symstiff.calibration.planning.variables import Variables, loads_of, variables_of

CasadiObservation = Callable[[Any, Any], Any]
_STEP = 1e-6  # rad or m, of central differences
_MARGIN = 1e-3  # m, at which the penalty of the unconstrained method starts
_PENALTY = 1e5  # score per m²
_ITERATIONS = 150


@dataclass(frozen=True)
class Problem:
    """What is refined: where poses may be, how rows are evaluated, their column scale (P,), the criterion."""

    space: Space
    evaluator: Evaluator
    scale: np.ndarray
    criterion: Criterion

    def score(self, q: np.ndarray, w: np.ndarray) -> float:
        """Return the criterion's score of a design, q (N, n), w (N, 6)."""
        return self.criterion.score(information_of(self.evaluator(q, w) * self.scale))


@dataclass(frozen=True)
class Refined:
    """Poses q (N, n), w (N, 6), their score; ``method`` ipopt, l-bfgs-b, or none where nothing was gained."""

    q: np.ndarray
    w: np.ndarray
    score: float
    method: str


def refine(
    problem: Problem, chosen: Candidates, casadi_observation: CasadiObservation | None = None
) -> Refined:
    """Move the poses within joint limits and region to raise the score; never worse than what was given.

    ``casadi_observation(q, w)`` returns the observation matrix (6, P) as a CasADi expression. A result that
    leaves the region or has a lower score by the numeric model is discarded.
    """
    variables = variables_of(problem.space, chosen)
    kept = Refined(chosen.q, chosen.w, problem.score(chosen.q, chosen.w), "none")
    if not len(variables.start):
        return kept
    if casadi_observation is None:
        x, method = _by_gradient(problem, variables), "l-bfgs-b"
    else:
        x, method = _by_ipopt(problem, variables, casadi_observation), "ipopt"
    x = np.clip(x, variables.low, variables.high)
    local = variables.local(x)
    q, w = local[:, : variables.dof], loads_of(problem.space, variables, local)
    if not np.all(np.isfinite(local)) or not np.all(allowed(problem.space.region, problem.space.robot, q)):
        return kept
    score = problem.score(q, w)
    return Refined(q, w, score, method) if score > kept.score else kept


def _by_ipopt(problem: Problem, variables: Variables, observation: CasadiObservation) -> np.ndarray:
    import casadi as ca

    count = len(variables.index)
    region, robot = problem.space.region, problem.space.robot
    planes = np.stack(
        [planes_around(region, robot, q).ravel() for q in variables.constant[:, : variables.dof]]
    )
    rows, margins = _pose_functions(problem, variables, observation, planes.shape[1])
    x = ca.MX.sym("x", len(variables.start))
    local = ca.MX(ca.DM(variables.constant.T))
    for i, k in zip(*np.nonzero(variables.index >= 0), strict=True):
        local[int(k), int(i)] = x[int(variables.index[i, k])]
    stacked = rows.map(count)(local, ca.DM(variables.wrench.T))
    parameters = len(problem.scale)
    blocks = ca.horzsplit(stacked, parameters)
    information = sum(ca.mtimes(b.T, b) for b in blocks)
    cost = _cost_function(problem.criterion, parameters)(information)
    constraints = ca.vec(margins.map(count)(local, ca.DM(planes.T)))
    options: dict[str, Any] = {
        "print_time": False,
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "max_iter": _ITERATIONS,
            "tol": 1e-6,
            "acceptable_tol": 1e-4,
            "hessian_approximation": "limited-memory",
            "bound_relax_factor": 0.0,
            "mu_init": 1e-3,
        },
    }
    problem_terms: dict[str, Any] = {"x": x, "f": cost, "g": constraints}
    solver = ca.nlpsol("refinement", "ipopt", problem_terms, options)
    solution = solver(x0=variables.start, lbx=variables.low, ubx=variables.high, lbg=0.0, ubg=ca.inf)
    return np.asarray(solution["x"], dtype=float).ravel()


def _pose_functions(
    problem: Problem, variables: Variables, observation: CasadiObservation, planes: int
) -> tuple[Any, Any]:
    """Return CasADi functions of one pose: scaled whitened rows (m, P), and constraints ≥ 0."""
    import casadi as ca

    robot, load, dof = problem.space.robot, problem.space.load, variables.dof
    local = ca.SX.sym("local", variables.index.shape[1])
    wrench, plane = ca.SX.sym("wrench", 6), ca.SX.sym("plane", planes)
    q = local[:dof]
    found = frames(robot, [q[j] for j in range(dof)], ca.cos, ca.sin)
    w = wrench
    if load.directions:
        directions = [local[dof + k] for k in range(3 * load.directions)]
        w = ca.vertcat(
            *wrench_of_directions(load, directions, lambda a, b, c: ca.sqrt(a * a + b * b + c * c))
        )
    rotation = ca.vertcat(*(ca.horzcat(*row) for row in found.rotations[dof]))
    matrix = whitened_rows_symbolic(problem.evaluator.measurement, rotation, observation(q, w))
    scaled = ca.mtimes(matrix, ca.diag(ca.DM(problem.scale)))
    rows = ca.Function("rows", [local, wrench], [ca.densify(scaled)])
    values = constraint_values(problem.space.region, found.origins, plane)
    return rows, ca.Function("margins", [local, plane], [ca.densify(ca.vertcat(ca.SX(0, 1), *values))])


def _cost_function(criterion: Criterion, parameters: int) -> Any:
    """Return minus the score as a CasADi function of the information matrix, by Cholesky's factor."""
    import casadi as ca

    information = ca.SX.sym("M", parameters, parameters)
    factor = ca.chol(information)  # upper triangular: factorᵀ·factor = M
    if criterion.weight is None:
        cost = -2.0 * ca.sum1(ca.log(ca.diag(factor)))
    else:
        spread, axes = np.linalg.eigh(criterion.weight)
        half = axes[:, spread > 1e-14 * spread.max()] * np.sqrt(spread[spread > 1e-14 * spread.max()])
        solved = ca.solve(factor.T, ca.SX(ca.DM(half)))
        cost = ca.log(ca.sumsqr(solved))
    return ca.Function("cost", [information], [cost])


def _by_gradient(problem: Problem, variables: Variables) -> np.ndarray:
    from scipy.optimize import minimize

    result = minimize(
        lambda x: _cost_and_gradient(problem, variables, x),
        variables.start,
        jac=True,
        method="L-BFGS-B",
        bounds=np.stack([variables.low, variables.high], axis=1),
        options={"maxiter": _ITERATIONS},
    )
    return np.asarray(result.x)


def _cost_and_gradient(problem: Problem, variables: Variables, x: np.ndarray) -> tuple[float, np.ndarray]:
    """Minus the score with a penalty for leaving the region, and the gradient.

    The derivative by the information matrix is exact; only the rows are differenced, all poses at once.
    """
    local = variables.local(x)
    rows = _rows_at(problem, variables, local)
    information = information_of(rows)
    score = problem.criterion.score(information)
    if not np.isfinite(score):
        return 1e30, np.zeros_like(x)
    towards = rows @ problem.criterion.gradient(information)
    slope = np.zeros_like(local)
    penalty, penalty_slope = _penalty(problem, variables, local)
    for k in range(local.shape[1]):
        if np.all(variables.index[:, k] < 0):
            continue
        ahead, behind = local.copy(), local.copy()
        ahead[:, k] += _STEP
        behind[:, k] -= _STEP
        difference = (_rows_at(problem, variables, ahead) - _rows_at(problem, variables, behind)) / (
            2 * _STEP
        )
        slope[:, k] = 2.0 * np.einsum("mnp,mnp->n", towards, difference)
    if problem.criterion.weight is None:
        return penalty - score, variables.gather(penalty_slope - slope)
    # the logarithm keeps a trace of any magnitude well scaled against the penalty
    return penalty + float(np.log(-score)), variables.gather(penalty_slope - slope / -score)


def _rows_at(problem: Problem, variables: Variables, local: np.ndarray) -> np.ndarray:
    w = loads_of(problem.space, variables, local)
    return np.asarray(problem.evaluator(local[:, : variables.dof], w) * problem.scale)


def _penalty(problem: Problem, variables: Variables, local: np.ndarray) -> tuple[float, np.ndarray]:
    region, robot = problem.space.region, problem.space.robot
    slope = np.zeros_like(local)
    if not (region.boxes or region.half_spaces or region.reach):
        return 0.0, slope
    q = local[:, : variables.dof]
    short = np.maximum(0.0, _MARGIN - clearance(region, robot, q))
    if not short.any():
        return 0.0, slope
    for k in range(variables.dof):
        step = np.zeros(variables.dof)
        step[k] = _STEP
        change = clearance(region, robot, q + step) - clearance(region, robot, q - step)
        slope[:, k] = -2.0 * _PENALTY * short * change / (2 * _STEP)
    return float(_PENALTY * (short**2).sum()), slope
