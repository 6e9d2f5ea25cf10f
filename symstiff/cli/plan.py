"""The command that chooses measurement poses."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symstiff.cli.output import check_targets, console, note, print_table, stages, write_json
from symstiff.cli.show import parse_fixed, warn_of, whole_number
from symstiff.errors import UserError
from symstiff.robot import load

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from symstiff.calibration.planning.choice import Plan
    from symstiff.calibration.planning.loads import Load
    from symstiff.calibration.planning.region import Region
    from symstiff.model import StiffnessModel
    from symstiff.reduction import Reduction
    from symstiff.robot import Robot
    from symstiff.robot.exact import Exact


CANDIDATES, LOADS, MEASURE = 20_000, "wrench", "pose"
"""What is taken where nobody says; for a verdict it is what its data had."""
MOST_CANDIDATES, MOST_STEPS = 1_000_000, 1000
_AT_LIMIT = 1e-3
"""Share of its range within which a joint is at its limit."""


@dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """The options of ``symstiff plan``."""

    robot: str
    poses: int
    output: Path
    loads: str | None
    measure: str | None
    criterion: str
    test_poses: Path | None
    force: float | None
    moment: float | None
    steps: int
    candidates: int | None
    sigma: float | None
    levels: str | None
    markers: tuple[str, ...]
    fixed: str | None
    keep_out: str | None
    floor: float | None
    margin: float
    separate: Path | None
    seed: int
    refine: bool
    cluster: str | None
    plot: Path | None
    json: str | None


@dataclass(frozen=True)
class _Asked:
    """What the options say of the experiment; ``sigma_mm`` is of one reading of a coordinate."""

    loads: str
    fixed: dict[int, Exact]
    levels: dict[int, int]
    measure: str
    points: tuple[str, ...]
    steps: int
    sigma_mm: float

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations [m, rad] of one reading."""
        from symstiff.calibration.planning.measurement import BASELINE

        return self.sigma_mm * 1e-3, self.sigma_mm * 1e-3 / BASELINE

    @property
    def together(self) -> tuple[float, float]:
        """Of the readings at all load steps together."""
        from symstiff.calibration.tables.poses import gain_of_steps

        gain = gain_of_steps(self.steps) ** 0.5
        return self.sigma[0] / gain, self.sigma[1] / gain


def run_plan(request: PlanRequest) -> None:
    """Choose poses, write them, say what they promise."""
    _check(request)
    if request.separate is not None:
        from symstiff.cli.separate import run_separate

        return run_separate(request, request.separate)
    robot = load(request.robot)
    asked = _asked(request, robot)
    out = console(request.json)
    with stages(out) as progress:
        reduction, model, applied, plan = _chosen(request, asked, robot, progress)
    doubts = _write_poses(request, asked, plan, model, reduction)
    if request.plot is not None:
        from symstiff.calibration.planning import geometry
        from symstiff.report.figures import draw_plan, save_figure

        save_figure(draw_plan(plan, geometry(model.robot)), request.plot)
    write_json(request.json, _record(request, asked, plan, applied, doubts))
    warn_of(out, reduction)
    _print_plan(out, plan, model.units)
    _note_limits(out, plan, robot, request.margin)
    if doubts:
        _note_doubts(out, doubts, request.criterion)
    out.print(_applied(applied))
    out.print(_measured(request, asked.measure, asked.sigma))
    out.print(f"wrote {request.output}")


def _asked(request: PlanRequest, robot: Robot) -> _Asked:
    """The options, read before any work."""
    from symstiff.calibration.planning.measurement import Measurement

    fixed, levels = parse_fixed(request.fixed), _levels(request.levels)
    loads = request.loads or LOADS
    measure, points = _read(request, robot)
    if request.moment is not None and loads != "wrench":
        raise UserError(
            f"--moment has no effect with --loads {loads}: leave it out, or plan for --loads wrench"
        )
    sigma_mm = _given(request.sigma, 1e3 * Measurement.sigma_t)
    return _Asked(loads, fixed, levels, measure, points, request.steps, sigma_mm)


def _chosen(
    request: PlanRequest, asked: _Asked, robot: Robot, progress: Callable[[str], None]
) -> tuple[Reduction, StiffnessModel, Load, Plan]:
    """The reduction for the experiment, its model, the loads as the arm bears them, and the plan."""
    from symstiff.calibration.plan import Goal, Load, Search
    from symstiff.calibration.plan import plan as choose_poses
    from symstiff.model import StiffnessModel
    from symstiff.reduction import reduce

    progress("deriving and reducing")
    reduction = reduce(robot, asked.loads, asked.measure, asked.fixed, points=asked.points)
    model = StiffnessModel.of(reduction)
    test_q, test_w = _test_poses(request, robot)
    goal = Goal(request.poses, request.criterion, None, test_q, test_w)  # type: ignore[arg-type]
    load_class: Any = asked.loads
    applied = Load(load_class, _given(request.force, Load.force), request.moment).on_arm(robot.reach)
    candidates = CANDIDATES if request.candidates is None else request.candidates
    search = Search(candidates, seed=request.seed, refine=request.refine, cluster=request.cluster)
    plan = choose_poses(
        model, goal, applied, request.markers, asked.together, region_of(request),
        {j: float(v) for j, v in asked.fixed.items()}, asked.levels, search,
        lambda label, share: progress(f"{label} {share:.0%}"),
    )  # fmt: skip
    return reduction, model, applied, plan


def _write_poses(
    request: PlanRequest, asked: _Asked, plan: Plan, model: StiffnessModel, reduction: Reduction
) -> tuple[str, ...]:
    """Write the poses as they are measured; the parameters that they may leave in doubt."""
    from symstiff.calibration.foreseen import doubtful
    from symstiff.calibration.planning import geometry, poses_table
    from symstiff.calibration.tables.poses import in_steps, with_markers
    from symstiff.calibration.tables.table import write_table

    table = poses_table(plan, geometry(model.robot))
    if request.markers:
        table = with_markers(plan.q, plan.w, request.markers, table.joint_units)
    components = 3 if request.markers or asked.measure == "position" else 6
    doubts = doubtful(reduction, table, components, asked.together)
    write_table(in_steps(table, request.steps) if request.steps > 1 else table, request.output, "deg")
    return doubts


def _record(
    request: PlanRequest, asked: _Asked, plan: Plan, applied: Load, doubts: tuple[str, ...]
) -> dict[str, Any]:
    """What ``--json`` writes."""
    measured = {
        "points": list(request.markers), "sigma_mm": round(asked.sigma_mm, 9), "measure": asked.measure,
        "steps": request.steps,
    }  # fmt: skip
    loads = {"class": applied.kind, "force": applied.force, "moment": applied.moment}
    return {**plan.to_dict(), "load": loads, "doubtful": list(doubts), "measured": measured}


def _note_limits(out: Console, plan: Plan, robot: Robot, margin: float) -> None:
    """Say how many poses stand where a controller may refuse them."""
    import numpy as np

    low, high = robot.ranges.T
    near = _AT_LIMIT * (high - low)
    count = int(np.sum(np.any((plan.q < low + near) | (plan.q > high - near), axis=1)))
    if count and not margin:
        note(
            out,
            f"{count} of {len(plan)} poses have a joint at its limit, where most is seen and a controller may refuse "
            "it: --margin 2 keeps 2 % of every range free",
        )


def _note_doubts(out: Console, doubts: tuple[str, ...], criterion: str) -> None:
    """Say which parameters the noise may drown."""
    from symstiff.display import few

    other = "" if criterion == "D" else ", or by --criterion D"
    note(
        out,
        f"identify may not determine {few(doubts)}: with the compliances that a robot of this size usually has, "
        f"their noise is half of all that these poses show, or more: plan more poses, more load{other}",
    )


def _check(request: PlanRequest) -> None:
    """Refuse what no plan can follow, before any work."""
    if request.criterion not in ("D", "A", "test"):
        raise UserError(f"--criterion {request.criterion}: use D, A or test")
    if not 1 <= request.steps <= MOST_STEPS:
        raise UserError(f"--steps {request.steps}: 1 to {MOST_STEPS}")
    if request.sigma is not None and not 0 < request.sigma < inf:
        raise UserError(f"--sigma {request.sigma:g}: a standard deviation in millimetres above 0, e.g. 0.03")
    if (request.candidates or 0) > MOST_CANDIDATES:
        raise UserError(f"--candidates {request.candidates}: up to {MOST_CANDIDATES}, which fill the memory")
    targets = {"-o": request.output, "--plot": request.plot, "--json": request.json}
    check_targets(targets, _inputs(request))
    twice = next((m for k, m in enumerate(request.markers) if m in request.markers[:k]), None)
    if twice is not None:
        raise UserError(f"--markers: {twice} is named twice")
    if request.separate is None and request.test_poses is not None and request.criterion != "test":
        raise UserError("--test-poses has no effect without --criterion test: add it, or leave the file out")


def _inputs(request: PlanRequest) -> list[str | Path]:
    """The files that the command reads."""
    given = [p for p in (request.robot, request.test_poses, request.separate) if p is not None]
    if request.separate is None:
        return given
    from symstiff.discrepancy.apart.separate import TAKEN

    return [*given, request.separate.parent / TAKEN]


def _read(request: PlanRequest, robot: Robot) -> tuple[str, tuple[str, ...]]:
    """What is measured, and at which markers where these stand neither for the pose nor for the position."""
    from symstiff.calibration.experiment.readings import read_at

    if not request.markers:
        return request.measure or MEASURE, ()
    seen, points = read_at(robot, request.markers)
    return (seen, points) if request.measure in (None, seen) else (request.measure, ())


def _given(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _applied(load: Load) -> str:
    """The loads that the poses were chosen for."""
    if load.kind == "gravity":
        return f"assumed applied: {load.force:g} N downwards"
    if load.moment is None:
        return f"assumed applied: {load.force:g} N in any direction"
    return f"assumed applied: {load.force:g} N and {load.moment:g} N·m, each in any direction"


def _measured(request: PlanRequest, measure: str, sigma: tuple[float, float]) -> str:
    """What the promised deviations take for granted."""
    position = f"σ {1e3 * sigma[0]:g} mm a coordinate"
    position += f", each of {request.steps} load steps an independent reading" if request.steps > 1 else ""
    if request.markers:
        return f"assumed measured: positions of {', '.join(request.markers)}, {position}"
    if measure == "position":
        return f"assumed measured: position of the tool centre point, {position}"
    return (
        f"assumed measured: position and rotation of the tool, {position}, {1e3 * sigma[1]:g} mrad: a device that "
        "reads points needs --markers, e.g. p1,p2,p3"
    )


def _test_poses(request: PlanRequest, robot: Robot) -> tuple[Any, Any]:
    if request.test_poses is None:
        if request.criterion == "test":
            raise UserError("--criterion test needs --test-poses FILE: joint variables and loads that matter")
        return None, None
    from symstiff.calibration.tables.checks import check_robot
    from symstiff.calibration.tables.table import read_poses

    table = read_poses(request.test_poses)
    check_robot(table, robot)
    return table.q, table.w


def _levels(text: str | None) -> dict[int, int]:
    levels: dict[int, int] = {}
    for part in (text or "").split(","):
        if part.strip():
            name, _, count = part.partition("=")
            joint, values = whole_number(name.strip().removeprefix("q")), whole_number(count.strip())
            if joint is None or values is None:
                raise UserError(f"--levels {part.strip()!r}: write a joint and a number of values, e.g. q2=5")
            if joint in levels:
                raise UserError(f"--levels: q{joint} is given twice")
            levels[joint] = values
    return levels


def region_of(request: PlanRequest) -> Region:
    """Where the options let the poses be. Raises UserError for those that cannot be read."""
    import numpy as np

    from symstiff.calibration.planning.region import Box, Region, above_floor

    boxes: tuple[Any, ...] = ()
    if request.keep_out is not None:
        try:
            x = [float(v) for v in request.keep_out.split(",")]
        except ValueError as error:
            raise UserError(f"--keep-out {request.keep_out!r}: six numbers in metres") from error
        if len(x) != 6:
            raise UserError(f"--keep-out {request.keep_out!r}: six numbers in metres, x1,y1,z1,x2,y2,z2")
        low, high = (tuple(f(a, b) for a, b in zip(x[:3], x[3:], strict=True)) for f in (min, max))
        boxes = (Box(low, high),)  # type: ignore[arg-type]
    if request.floor is not None and not np.isfinite(request.floor):
        raise UserError(f"--floor {request.floor}: a height in metres")
    if not 0 <= request.margin < 50:
        raise UserError(
            f"--margin {request.margin:g}: a part of a joint's range in per cent, from 0 to below 50"
        )
    spaces = () if request.floor is None else (above_floor(request.floor),)
    return Region(boxes, spaces, margin=request.margin / 100)


def _print_plan(out: Console, plan: Plan, units: dict[str, str]) -> None:
    from rich.table import Table

    from symstiff.display import counted

    table = Table(
        title=f"{counted(len(plan), 'pose')}, criterion {plan.criterion}: predicted standard deviations",
        title_justify="left",
    )
    for column in ("parameter", "σ", "unit"):
        table.add_column(column, justify="right" if column == "σ" else "left")
    for name, std in zip(plan.parameters, plan.std, strict=True):
        table.add_row(name, f"{std:.2e}", units[name])
    print_table(out, table)
    out.print(f"as good as {plan.over_random:.2f} times as many random poses (mean of 100 draws)")
    if plan.expected_error is not None:
        out.print(f"expected error after compensation at the test poses: {1e3 * plan.expected_error:.4f} mm")
