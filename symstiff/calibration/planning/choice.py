"""The choice of measurement poses: candidates, exchange, refinement, and what the plan promises.

Stages: draw candidates (``candidates``) → whitened rows in parallel (``parallel``) → check that they find
every parameter (``checks``) → approximate design (``approximate``) → exchange from several starts on a pool,
then on all candidates (``exchange``) → continuous refinement (``refine``) → few digits (``digits``) → ``Plan``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from symstiff.arguments import whole
from symstiff.calibration.planning.approximate import Approximate, approximate_design
from symstiff.calibration.planning.candidates import (
    Candidates,
    Evaluator,
    Observation,
    Space,
    draw,
    evaluate,
)
from symstiff.calibration.planning.checks import check_counts, check_rank
from symstiff.calibration.planning.criteria import Criterion, information_of
from symstiff.calibration.planning.digits import in_few_digits
from symstiff.calibration.planning.exchange import (
    Selection,
    cover_levels,
    exchange,
    greedy,
    pool_of,
    random_start,
)
from symstiff.calibration.planning.measurement import Measurement
from symstiff.calibration.planning.parallel import Progress
from symstiff.calibration.planning.refine import CasadiObservation, Problem, Refined, refine
from symstiff.errors import UserError
from symstiff.threads import one_thread

_POOL = 3000
_RIDGE = 1e-9  # of the scaled information of one pose; carries the start while it is rank-deficient
_DRAWS = 100


@dataclass(frozen=True)
class Goal:
    """What a plan is for: the number of poses and the criterion.

    ``criterion`` D (log det), A (mean variance of parameters in units of ``scale``, or of the effect that
    each has on the measurements) or test (expected positional error after compensation at the test poses
    ``test_q`` (T, n) under ``test_w`` (T, 6)).
    """

    poses: int
    criterion: Literal["D", "A", "test"] = "D"
    scale: np.ndarray | None = None
    test_q: np.ndarray | None = None
    test_w: np.ndarray | None = None

    def __post_init__(self) -> None:
        whole(self.poses, "poses", 1)


@dataclass(frozen=True)
class Search:
    """How hard to look: candidates, starts of the exchange, seed, refinement, workers or a Dask cluster."""

    candidates: int = 20_000
    starts: int = 6
    seed: int = 0
    refine: bool = True
    workers: int = 1
    cluster: str | None = None

    def __post_init__(self) -> None:
        for name, least in (("candidates", 1), ("starts", 1), ("seed", 0), ("workers", 1)):
            whole(getattr(self, name), name, least)


@dataclass(frozen=True)
class Plan:
    """Measurement poses and what they promise.

    ``q`` (N, n) and ``w`` (N, 6); ``std`` (P,) predicted standard deviations in the parameters' SI units;
    ``score``: log det of the scaled information, or minus the mean variance (A: in squared units of the
    scale; test: m²); ``history`` the score after every accepted step, exchange then refinement. Efficiencies
    say how many times fewer measurements do the same as the reference: ``over_random`` (mean of 100 draws),
    ``over_candidates`` (best choice known among the candidates), ``of_bound`` (no choice among the candidates
    exceeds 1; the refinement, which leaves them, may).
    """

    robot: str
    parameters: tuple[str, ...]
    q: np.ndarray
    w: np.ndarray
    criterion: str
    score: float
    history: tuple[float, ...]
    std: np.ndarray
    over_random: float
    over_candidates: float
    of_bound: float
    method: str
    candidates: int
    seed: int

    def __repr__(self) -> str:
        from symstiff.calibration.planning.reading import plan_line

        return f"Plan({plan_line(self)})"

    def _repr_html_(self) -> str:
        from symstiff.calibration.planning.reading import plan_html

        return plan_html(self)

    def __len__(self) -> int:
        return len(self.q)

    def to_dict(self) -> dict[str, Any]:
        """What the plan promises as plain values for JSON: criterion, efficiencies, deviations."""
        return {
            "robot": self.robot,
            "poses": len(self),
            "criterion": self.criterion,
            "score": self.score,
            "expected_error_mm": None if self.expected_error is None else 1e3 * self.expected_error,
            "efficiency": {
                # random draws that find no parameter at all make the ratio infinite, which JSON cannot say
                "over_random": self.over_random if np.isfinite(self.over_random) else None,
                "over_candidates": self.over_candidates,
                "of_bound": self.of_bound,
            },
            "method": self.method,
            "candidates": self.candidates,
            "seed": self.seed,
            "std": {name: float(s) for name, s in zip(self.parameters, self.std, strict=True)},
        }

    @property
    def expected_error(self) -> float | None:
        """Root mean square positional error after compensation at the test poses [m]; None without them."""
        return float(np.sqrt(-self.score)) if self.criterion == "test" else None


def plan_poses(
    space: Space,
    observation: Observation,
    parameters: Sequence[str],
    goal: Goal,
    measurement: Measurement | None = None,
    search: Search | None = None,
    casadi_observation: CasadiObservation | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Choose measurement poses for the parameters of an observation matrix.

    ``observation(q, w)`` maps (N, n) and (N, 6) to (N, 6, P), picklable where workers or a cluster evaluate
    it; ``casadi_observation`` is the same for one pose as a CasADi expression (6, P). Same inputs and seed,
    same plan. Raises UserError where poses are too few, the space is empty, or parameters cannot be found.
    """
    measurement, search = measurement or Measurement(), search or Search()
    check_counts(goal.poses, search.candidates, len(parameters), measurement.rows, space)
    candidates = draw(space, search.candidates, search.seed)
    evaluator = Evaluator(observation, space.robot, measurement)
    rows = evaluate(evaluator, candidates, search.workers, search.cluster, progress)
    if rows.shape[2] != len(parameters):
        raise UserError(
            f"{len(parameters)} parameter names for {rows.shape[2]} columns of the observation matrix"
        )
    scale = check_rank(rows, parameters, space.levels)
    rows *= scale
    criterion = criterion_of(goal, observation, scale)
    with one_thread():
        selection, design = _select(rows, candidates, criterion, goal.poses, search, progress)
    problem = Problem(space, evaluator, scale, criterion)
    chosen = _take(candidates, selection.chosen)
    refined = Refined(chosen.q, chosen.w, selection.score, "none")
    if search.refine:
        refined = _report(progress, "refining", refine(problem, chosen, casadi_observation))
    q, w = in_few_digits(space, refined.q, refined.w)
    refined = Refined(q, w, problem.score(q, w), refined.method)
    random = random_scores(rows, candidates, criterion, goal.poses, search.seed)
    return _plan(problem, parameters, refined, selection, design, random, search)


def criterion_of(goal: Goal, observation: Observation, scale: np.ndarray) -> Criterion:
    """Return the criterion in scaled coordinates: parameter = scale × coordinate, scale (P,)."""
    if goal.criterion == "D":
        return Criterion("D")
    if goal.criterion == "A":
        unit = np.ones(len(scale)) if goal.scale is None else scale / np.asarray(goal.scale, dtype=float)
        if unit.shape != scale.shape or not np.all(np.isfinite(unit)):
            raise UserError(f"A-optimality needs one scale a parameter: {len(scale)} positive numbers")
        return Criterion("A", np.diag(unit**2) / len(scale))
    if goal.criterion != "test":
        raise UserError(f"criterion: unknown {goal.criterion!r}: use D, A or test")
    if goal.test_q is None or goal.test_w is None or len(goal.test_q) == 0:
        raise UserError("criterion test needs test poses: give their joint variables and wrenches")
    matrix = np.asarray(
        observation(np.asarray(goal.test_q, float), np.asarray(goal.test_w, float)), dtype=float
    )
    flat = (matrix[:, :3] * scale).reshape(-1, len(scale))
    if not flat.any():
        raise UserError("the test poses carry no load that moves the tool: add fx[N] … to them")
    return Criterion("test", flat.T @ flat / len(matrix))


def random_scores(
    rows: np.ndarray, candidates: Candidates, criterion: Criterion, poses: int, seed: int
) -> np.ndarray:
    """Return the scores of 100 random draws of ``poses`` candidates, (100,), -inf where one is singular."""
    rng = np.random.default_rng([seed, 1])
    scores = []
    for _ in range(_DRAWS):
        drawn = tuple(int(i) for i in rng.choice(len(candidates), poses, replace=False))
        covered = cover_levels(drawn, candidates.labels, rng.random(len(candidates)))
        scores.append(criterion.score(information_of(rows[:, list(covered)])))
    return np.array(scores)


def _select(
    rows: np.ndarray,
    candidates: Candidates,
    criterion: Criterion,
    poses: int,
    search: Search,
    progress: Progress | None,
) -> tuple[Selection, Approximate]:
    """Search a pool of promising candidates from several starts, then all candidates from the best result."""
    labels = candidates.labels
    ridge = _RIDGE * rows.shape[0]
    design = _report(progress, "bounding", approximate_design(rows, criterion, poses, search.seed, ridge))
    pool = pool_of(design, _POOL, labels)
    small = np.ascontiguousarray(rows[:, pool])
    local = Approximate(np.searchsorted(pool, design.support), design.weights, 0.0, design.derivative[pool])
    rng = np.random.default_rng([search.seed, 0])
    starts = [greedy(small, poses, criterion, ridge)]
    starts += [random_start(poses, local, rng) for _ in range(search.starts - 1)]

    def improve(start: tuple[int, ...]) -> Selection:
        covering = cover_levels(start, labels[pool], local.derivative)
        return exchange(small, covering, criterion, ridge, labels[pool])

    best = max((improve(start) for start in starts), key=lambda found: found.score)
    _report(progress, "exchanging", None, 0.5)
    final = exchange(rows, tuple(int(pool[i]) for i in best.chosen), criterion, ridge, labels)
    score = criterion.score(information_of(rows[:, list(final.chosen)]))
    if not np.isfinite(score):
        raise UserError(f"{poses} poses do not find every parameter with this load: ask for more poses")
    history = (*best.history, *final.history[1:])
    return _report(progress, "exchanging", Selection(final.chosen, score, history)), design


def _plan(
    problem: Problem,
    parameters: Sequence[str],
    refined: Refined,
    selection: Selection,
    design: Approximate,
    random: np.ndarray,
    search: Search,
) -> Plan:
    rows = problem.evaluator(refined.q, refined.w) * problem.scale
    covariance = np.linalg.inv(information_of(rows))
    count = len(parameters)
    criterion = problem.criterion

    def relative(reference: float) -> float:
        return criterion.efficiency(refined.score, reference, count)

    return Plan(
        robot=problem.space.robot.name,
        parameters=tuple(parameters),
        q=refined.q,
        w=refined.w,
        criterion=criterion.name,
        score=refined.score,
        history=(*selection.history, refined.score) if refined.method != "none" else selection.history,
        std=np.sqrt(np.diag(covariance)) * problem.scale,
        over_random=relative(float(random.mean())),
        over_candidates=relative(selection.score),
        of_bound=relative(design.bound),
        method=refined.method,
        candidates=search.candidates,
        seed=search.seed,
    )


def _take(candidates: Candidates, chosen: tuple[int, ...]) -> Candidates:
    index = list(chosen)
    return Candidates(candidates.q[index], candidates.w[index], candidates.labels[index])


def _report(progress: Progress | None, label: str, value: Any, fraction: float = 1.0) -> Any:
    if progress is not None:
        progress(label, fraction)
    return value
