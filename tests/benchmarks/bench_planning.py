"""Plans against random poses and against the best choice known, and the time for 15 of 100 000 candidates.

Run: python tests/benchmarks/bench_planning.py [candidates] [--long] [--workers N]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

from symstiff.calibration.plan import Goal, Load, Plan, Region, Search
from symstiff.calibration.plan import plan as choose_poses
from symstiff.calibration.planning import Space, above_floor, geometry
from symstiff.calibration.planning.candidates import draw
from symstiff.model import StiffnessModel
from symstiff.reduction.reduce import reduce
from symstiff.robot import load

LOAD = Load("gravity", 2500.0)


def timed(model: StiffnessModel, goal: Goal, search: Search) -> tuple[Plan, float]:
    """Plan above the floor, and say how long it took."""
    start = time.perf_counter()
    plan = choose_poses(model, goal, LOAD, region=Region(half_spaces=(above_floor(0.1),)), search=search)
    return plan, time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("candidates", type=int, nargs="?", default=100_000)
    parser.add_argument("--long", action="store_true", help="search the best known choice from 60 starts")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    model = StiffnessModel.of(reduce(load("kuka_kr270"), loads="gravity", measure="pose"))
    tests = draw(Space(geometry(model.robot), LOAD), 30, 99)  # spread over the joint limits
    test_q, test_w = tests.q, tests.w
    print(f"{len(model.parameters)} parameters, 15 poses of {options.candidates} candidates")
    print(
        "criterion  seconds  over random  of best known  of bound  refined over candidates (seconds in all)"
    )
    for name in ("D", "A", "test"):
        goal = Goal(15, name, test_q=test_q, test_w=test_w)  # type: ignore[arg-type]
        search = Search(options.candidates, refine=False, workers=options.workers)
        plan, seconds = timed(model, goal, search)
        best = plan.score
        if options.long:
            best = max(best, timed(model, goal, replace(search, starts=60))[0].score)
        known = relative(name, plan.score, best, len(model.parameters))
        refined, in_all = timed(model, goal, replace(search, refine=True))
        print(
            f"{name:>9}  {seconds:7.1f}  {plan.over_random:11.2f}  {known:13.4f}  {plan.of_bound:8.3f}  "
            f"{refined.over_candidates:.3f} by {refined.method} ({in_all:.1f})"
        )


def relative(criterion: str, score: float, reference: float, parameters: int) -> float:
    """Efficiency of a score relative to a reference, by the definition of the criterion."""
    import math

    return math.exp((score - reference) / parameters) if criterion == "D" else reference / score


if __name__ == "__main__":
    main()
