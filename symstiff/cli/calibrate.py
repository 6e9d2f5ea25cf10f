"""Commands of calibration: plan, simulate, identify, compensate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symstiff.cli.output import console, stages, write_json
from symstiff.cli.show import parse_fixed
from symstiff.errors import UserError
from symstiff.robot import load

if TYPE_CHECKING:
    from rich.console import Console

    from symstiff.calibration.identify import Identification
    from symstiff.calibration.planning.plan import Plan
    from symstiff.calibration.planning.region import Region


@dataclass(frozen=True)
class PlanRequest:
    """The options of ``symstiff plan``."""

    robot: str
    poses: int
    output: Path
    loads: str
    measure: str
    criterion: str
    test_poses: Path | None
    force: float
    steps: int
    candidates: int
    sigma: float
    levels: str | None
    markers: tuple[str, ...]
    fixed: str | None
    keep_out: str | None
    floor: float | None
    separate: Path | None
    seed: int
    refine: bool
    cluster: str | None
    plot: Path | None
    json: str | None


def run_plan(request: PlanRequest) -> None:
    """Choose poses, write them, say what they promise."""
    from symstiff.calibration.plan import Goal, Load, Search, plan_for, robot_of
    from symstiff.calibration.planning.poses import draw_plan, poses_table, save_figure, summary
    from symstiff.calibration.poses import in_steps, with_markers
    from symstiff.calibration.table import write_table
    from symstiff.model import StiffnessModel
    from symstiff.reduction import reduce

    if request.criterion not in ("D", "A", "test"):
        raise UserError(f"--criterion {request.criterion}: use D, A or test")
    if request.separate is not None:
        return _separate(request)
    if request.steps < 1:
        raise UserError(f"--steps {request.steps}: 1 or more")
    robot = load(request.robot)
    fixed = parse_fixed(request.fixed)
    out = console(request.json)
    with stages(out) as progress:
        progress("deriving and reducing")
        model = StiffnessModel.of(reduce(robot, request.loads, request.measure, fixed))
        test_q, test_w = _test_poses(request)
        goal = Goal(request.poses, request.criterion, None, test_q, test_w)  # type: ignore[arg-type]
        load_class: Any = request.loads
        search = Search(request.candidates, seed=request.seed, refine=request.refine, cluster=request.cluster)
        sigma = (request.sigma * 1e-3, request.sigma * 1e-3 / 0.3)
        plan = plan_for(
            model, goal, Load(load_class, request.force), request.markers, sigma, _region(request),
            {j: float(v) for j, v in fixed.items()}, _levels(request.levels), search,
            lambda label, share: progress(f"{label} {share:.0%}"),
        )  # fmt: skip
    geometry = robot_of(model)
    table = poses_table(plan, geometry)
    if request.markers:
        table = with_markers(plan.q, plan.w, request.markers, table.joint_units)
    write_table(in_steps(table, request.steps) if request.steps > 1 else table, request.output, "deg")
    if request.plot is not None:
        save_figure(draw_plan(plan, geometry), request.plot)
    _print_plan(out, plan, model.units)
    out.print(f"wrote {request.output}")
    write_json(request.json, summary(plan))


def _separate(request: PlanRequest) -> None:
    """Poses that decide among the explanations of an ambiguous verdict."""
    from symstiff.calibration.table import write_table
    from symstiff.discrepancy.separate import Wish, separate

    assert request.separate is not None
    robot = load(request.robot)
    out = console(request.json)
    wish = Wish(
        request.poses, request.loads, request.measure, request.force, request.markers, request.sigma * 1e-3,
        request.seed, _region(request),
    )  # fmt: skip
    with stages(out) as progress:
        progress("deciding poses")
        table, found, names = separate(robot, request.separate, wish, progress)
    if not found.poses:
        raise UserError(
            "no pose tells these explanations apart under such loads: other loads (--loads), or a reading of "
            "the whole pose (--measure pose)"
        )
    write_table(table, request.output, "deg")
    out.print(f"{len(found.poses)} poses that decide between: " + " | ".join(names))
    out.print(
        f"separation {found.separation[-1]:.3g} (squared distance of the predictions in units of the noise "
        "variance that no fit closes; 20 is ample)"
    )
    if found.separation[-1] < 1.0:
        out.print("[yellow]note[/yellow]: these loads do not tell them apart: other loads, or more force")
    out.print(f"wrote {request.output}")
    write_json(
        request.json, {"explanations": names, "poses": table.labels, "separation": list(found.separation)}
    )


def _test_poses(request: PlanRequest) -> tuple[Any, Any]:
    if request.test_poses is None:
        if request.criterion == "test":
            raise UserError("--criterion test needs --test-poses FILE: joint variables and loads that matter")
        return None, None
    from symstiff.calibration.table import read_poses

    table = read_poses(request.test_poses)
    return table.q, table.w


def _levels(text: str | None) -> dict[int, int]:
    levels: dict[int, int] = {}
    for part in (text or "").split(","):
        if part.strip():
            name, _, count = part.partition("=")
            joint = name.strip().removeprefix("q")
            if not joint.isdigit() or not count.strip().isdigit():
                raise UserError(f"--levels {part.strip()!r}: write a joint and a number of values, e.g. q2=5")
            levels[int(joint)] = int(count)
    return levels


def _region(request: PlanRequest) -> Region | None:
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
    spaces = () if request.floor is None else (above_floor(request.floor),)
    return Region(boxes, spaces) if boxes or spaces else None


def _print_plan(out: Console, plan: Plan, units: dict[str, str]) -> None:
    from rich.table import Table

    table = Table(
        title=f"{len(plan)} poses, criterion {plan.criterion}: predicted standard deviations",
        title_justify="left",
    )
    for column in ("parameter", "σ", "unit"):
        table.add_column(column, justify="right" if column == "σ" else "left")
    for name, std in zip(plan.parameters, plan.std, strict=True):
        table.add_row(name, f"{std:.2e}", units[name])
    out.print(table)
    out.print(f"as good as {plan.over_random:.2f} times as many random poses (mean of 100 draws)")
    if plan.expected_error is not None:
        out.print(f"expected error after compensation at the test poses: {1e3 * plan.expected_error:.4f} mm")


def run_simulate(truth: Path, poses: Path, output: Path, noise: float | None, seed: int) -> None:
    """Run a virtual experiment."""
    from symstiff.calibration.simulation import run_simulation

    if noise is not None and not 0 <= noise < 100:
        raise UserError(f"--noise {noise:g}: a standard deviation in millimetres, 0 or more")
    out = console()
    with stages(out) as progress:
        progress("finding equilibria")
        run_simulation(truth, poses, noise, seed, output)
    out.print(f"wrote {output}")


@dataclass(frozen=True)
class IdentifyRequest:
    """The options of ``symstiff identify``."""

    robot: str
    data: tuple[Path, ...]
    output: Path
    start: str
    loads: str | None
    measure: str | None
    robust: bool
    physical: bool
    held_out: float
    per_level: str | None
    reconstruct: Path | None
    plot: Path | None
    seed: int
    json: str | None


def run_identify(request: IdentifyRequest) -> None:
    """Fit, report, save."""
    from symstiff.calibration.identify import identify
    from symstiff.calibration.table import read_measurements

    robot = load(request.robot)
    out = console(request.json)
    with stages(out) as progress:
        progress("reading the tables")
        table = read_measurements(request.data)
        progress("identifying")
        result = identify(
            robot, table, request.start, loads=request.loads, measure=request.measure, robust=request.robust,
            physical=request.physical, held_out=request.held_out, per_level=_joint(request.per_level),
            seed=request.seed,
        )  # fmt: skip
        complete = None
        if request.reconstruct is not None:
            progress("reconstructing complete link matrices")
            complete = _reconstruct(result, request.reconstruct)
    result.model.save(request.output)
    if request.plot is not None:
        from symstiff.calibration.planning.poses import save_figure
        from symstiff.report.residuals import draw_residuals

        save_figure(draw_residuals(result), request.plot)
    _print_identification(out, result)
    if complete is not None:
        out.print(f"complete link matrices: {complete}; wrote {request.reconstruct}")
    out.print(f"wrote {request.output}")
    write_json(request.json, result.as_dict())


def _joint(text: str | None) -> int | None:
    if text is None:
        return None
    if not text.removeprefix("q").isdigit():
        raise UserError(f"--per-level {text!r}: name a joint, e.g. q2")
    return int(text.removeprefix("q"))


def _reconstruct(result: Identification, path: Path) -> Any:
    from symstiff.calibration.complete import reconstruct_model

    found = reconstruct_model(result)
    write_json(str(path), found.to_dict())
    return found


def _print_identification(out: Console, result: Identification) -> None:
    from rich.table import Table

    fit, model = result.fit, result.model
    table = Table(
        title=f"{model.robot.title or model.robot.name}: {len(fit.names)} parameters", title_justify="left"
    )
    for column in ("parameter", "value", "σ", "σ/value", "95 % ±", "unit"):
        table.add_column(column, justify="left" if column in ("parameter", "unit") else "right")
    for k, name in enumerate(fit.names):
        value, std = (
            float(fit.values[k] if name not in model.values else model.values[name]),
            float(fit.std[k]),
        )
        share = f"{100 * std / abs(value):.1f} %" if value else "–"
        table.add_row(
            name,
            f"{value:.4e}",
            f"{std:.1e}",
            share,
            f"{(fit.upper[k] - fit.lower[k]) / 2:.1e}",
            fit.units[k],
        )
    out.print(table)
    print_residuals(out, [("identified poses", result.training), ("held-out poses", result.validation)])
    out.print(str(fit.rank))
    if fit.fit_p is not None:
        out.print(
            f"unit variance {fit.s0_squared:.2f} ({fit.dof} degrees of freedom), fit p = {fit.fit_p:.2g}"
        )
    for a, b, value in fit.correlated()[:5]:
        out.print(f"strongly correlated: {a}, {b} ({value:+.3f})")
    if result.robust is not None:
        for suspect in (*result.robust.poses[:5], *result.robust.rows[:5]):
            out.print(f"outlier: {suspect}")
    if result.physical is not None:
        for bound in result.physical.active:
            out.print(f"physics: {bound}")
    for remark in result.remarks:
        out.print(f"[yellow]note[/yellow]: {remark}")


def print_residuals(out: Console, parts: list[tuple[str, Any]]) -> None:
    """MAX and RMS by axis before and after compensation, as the seed's Table 2."""
    from rich.table import Table

    for title, residuals in parts:
        if residuals is None:
            continue
        share = f": {100 * residuals.compensated:.1f} % of the deflection compensated"
        table = Table(title=title + share, title_justify="left")
        table.add_column("mm, mrad")
        for axis in residuals.before:
            short = {"positional": "pos.", "rotational": "rot."}.get(axis, axis)
            table.add_column(f"{short} MAX", justify="right")
            table.add_column(f"{short} RMS", justify="right")
        for label, sizes in (("before", residuals.before), ("after", residuals.after)):
            cells = [f"{1e3 * x:.3f}" for s in sizes.values() for x in (s.max, s.rms)]
            table.add_row(label, *cells)
        out.print(table)


def run_compensate(model_file: Path, trajectory: Path, output: Path, json: str | None) -> None:
    """Correct a trajectory."""
    from dataclasses import replace

    import numpy as np

    from symstiff.calibration.rows import context_of
    from symstiff.calibration.table import check_robot, read_poses, write_table
    from symstiff.compensation import compensate
    from symstiff.model import load_model

    model = load_model(model_file)
    table = read_poses(trajectory)
    out = console(json)
    for warning in check_robot(table, model.robot):
        out.print(f"[yellow]note[/yellow]: {warning}")
    with stages(out) as progress:
        progress("compensating")
        found = compensate(model, table.q, table.w, context_of(table))
    rms = [float(np.sqrt((e[:, :3] ** 2).sum(axis=1).mean())) for e in (found.before, found.after)]
    labels = tuple(str(k + 1) for k in range(len(table)))
    write_table(
        replace(table, q=found.q_cmd, labels=labels, pose=np.arange(len(table)))
        if _moves(table)
        else replace(table, q=found.q_cmd),
        output,
    )
    out.print(
        f"{len(table)} poses: predicted error {1e3 * rms[0]:.3f} mm rms, after compensation {1e3 * rms[1]:.2g} mm"
    )
    singular = int((~found.solved).sum())
    if singular:
        out.print(f"[yellow]note[/yellow]: {singular} singular poses keep their command")
    out.print(f"wrote {output}")
    write_json(
        json,
        {
            "poses": len(table),
            "rms_mm": {"before": 1e3 * rms[0], "after": 1e3 * rms[1]},
            "singular": singular,
        },
    )


def _moves(table: Any) -> bool:
    """One label may carry several loads, and so several corrected configurations."""
    return len(table.labels) < len(table)
