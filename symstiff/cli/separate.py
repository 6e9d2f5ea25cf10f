"""``symstiff plan --separate``: poses that decide among the explanations of a verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.cli.output import console, note, stages, write_json
from symstiff.cli.plan import PlanRequest, region_of
from symstiff.errors import UserError
from symstiff.robot import load

if TYPE_CHECKING:
    from pathlib import Path


def run_separate(request: PlanRequest, verdict: Path) -> None:
    """Write poses that decide among the explanations of an ambiguous verdict."""
    from symstiff.calibration.tables.table import write_table
    from symstiff.discrepancy.apart.separate import Wish, separate
    from symstiff.report.deciding import DECIDES, OTHERWISE, assumed, reach

    _refuse_unused(request)
    robot = load(request.robot)
    out = console(request.json)
    sigma = None if request.sigma is None else request.sigma * 1e-3
    wish = Wish(
        request.poses, request.loads, request.measure, request.force, request.markers, sigma, request.seed,
        region_of(request),
    )  # fmt: skip
    with stages(out) as progress:
        progress("deciding poses")
        table, found, names, means = separate(robot, verdict, wish, progress)
    if not found.poses:
        raise UserError(
            "no pose tells these explanations apart under such loads: try other loads (--loads), or a reading of the "
            "whole pose (--measure pose); what is one and the same to the tool, nothing tells apart"
        )
    write_table(table, request.output, "deg")
    write_json(
        request.json,
        {
            "explanations": names, "poses": table.labels, "separation": list(found.separation),
            "measured": {"points": list(means.setup.points), "sigma_mm": round(1e3 * float(means.sigma[0]), 9)},
        },
    )  # fmt: skip
    out.print(f"{len(found.poses)} poses that best tell apart: " + " | ".join(names))
    out.print(
        f"they reach {reach(found.separation[-1])}: the squared distance of the predictions, in units of the noise "
        "variance, that no fit closes"
    )
    out.print(assumed(means.setup, means.sigma))
    if found.separation[-1] < DECIDES:
        note(out, f"{OTHERWISE} tell them apart")
    out.print(f"wrote {request.output}")


def _refuse_unused(request: PlanRequest) -> None:
    """Refuse options that poses for a verdict do not follow."""
    given = {
        "--criterion": request.criterion != "D", "--test-poses": request.test_poses, "--steps": request.steps != 1,
        "--levels": request.levels, "--fixed": request.fixed, "--no-refine": not request.refine,
        "--cluster": request.cluster, "--plot": request.plot, "--candidates": request.candidates is not None,
        "--moment": request.moment is not None,
    }  # fmt: skip
    for option, used in given.items():
        if used:
            raise UserError(f"{option} has no effect with --separate: leave it out")
