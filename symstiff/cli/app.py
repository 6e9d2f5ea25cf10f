"""The commands and their options; what they do stands in the modules that they import."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from symstiff.errors import UserError


class _Commands(TyperGroup):
    """The commands: what the library says of its arguments they say of their options."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command. Raises UserError with ``--max-effects`` where the library has ``max_effects``."""
        try:
            return super().invoke(ctx)
        except UserError as error:
            command = self.get_command(ctx, ctx.invoked_subcommand or "")
            names = {} if command is None else {str(p.name): p.opts[-1] for p in command.params}
            raise error.with_options({n: o for n, o in names.items() if o.startswith("--")}) from error


app = typer.Typer(
    name="symstiff",
    cls=_Commands,
    help="Complete stiffness models of serial robots: derived, reduced, identified, emitted as C and CasADi.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _folder(path: str) -> Path:
    """The folder that an option names; without a name it would be the one where the command runs."""
    if not path:
        raise typer.BadParameter("expected a folder, found no name")
    return Path(path)


Robot = Annotated[str, typer.Argument(help="A robot of the library (see: symstiff robots) or a robot file.")]
Json = Annotated[str | None, typer.Option("--json", metavar="FILE|-", help="Write the result as JSON.")]
Loads = Annotated[str, typer.Option(help="Class of loads: wrench, force or gravity (vertical force).")]
Measure = Annotated[str, typer.Option(help="What is measured: pose or position.")]
Fixed = Annotated[str | None, typer.Option(help="Joints that stand still, e.g. q1=0,q4=pi/2 (rad, m).")]


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.", is_eager=True)] = False,
) -> None:
    if version:
        from symstiff import __version__

        print(__version__)
        raise typer.Exit


@app.command(epilog="Example: symstiff robots")
def robots(json: Json = None) -> None:
    """List the library of robots with degrees of freedom and reach; with --json their sources."""
    from symstiff.cli.show import show_robots

    show_robots(json)


@app.command(epilog="Example: symstiff inspect kuka_kr270 --loads gravity --measure pose")
def inspect(
    robot: Robot,
    loads: Loads = "wrench",
    measure: Measure = "pose",
    fixed: Fixed = None,
    prefer: Annotated[str | None, typer.Option(help="Parameters to keep first, e.g. k2_66,k3_44.")] = None,
    avoid: Annotated[str | None, typer.Option(help="Parameters to eliminate first.")] = None,
    json: Json = None,
) -> None:
    """Reduce the complete stiffness model stage by stage (M1 to M5): groups, couplings in closed form."""
    from symstiff.cli.show import show_reduction

    show_reduction(robot, loads, measure, fixed, _list(prefer), _list(avoid), json)


@app.command(epilog="Example: symstiff effects kuka_kr270 --loads gravity --measure position")
def effects(
    robot: Robot,
    loads: Loads = "wrench",
    measure: Measure = "pose",
    data: Annotated[
        str, typer.Option(help="deflection (loaded minus unloaded) or absolute positions.")
    ] = "deflection",
    json: Json = None,
) -> None:
    """List the effects that a diagnosis can name on a robot, and what such data could tell of each: exact, no data."""
    from symstiff.cli.show import show_effects

    show_effects(robot, loads, measure, data, json)


@app.command(epilog="Example: symstiff generate kuka_kr270 -o kr270 --loads gravity")
def generate(
    robot: Robot,
    output: Annotated[
        Path, typer.Option("-o", "--output", parser=_folder, metavar="<path>", help="Folder to write.")
    ],
    loads: Annotated[str | None, typer.Option(help="Class of loads: wrench, force or gravity.")] = None,
    measure: Annotated[str | None, typer.Option(help="What is measured: pose or position.")] = None,
    fixed: Fixed = None,
    model: Annotated[
        Path | None, typer.Option(help="An identified model (model.toml) instead of a fresh one.")
    ] = None,
    precision: Annotated[str, typer.Option(help="Real type of the C code: double or float.")] = "double",
    layout: Annotated[
        str,
        typer.Option(help="C code: unrolled, or compact (40 % smaller, matrices take 40 to 80 % longer)."),
    ] = "unrolled",
    targets: Annotated[
        str, typer.Option(help="What to emit, comma-separated (symstiff targets lists them).")
    ] = "c,casadi",
    compile: Annotated[
        bool, typer.Option(help="Compile and run the self-test where a compiler is found.")
    ] = True,
    json: Json = None,
) -> None:
    """Derive, reduce, emit, compile and verify: C and CasADi code for a controller, in a folder that stands alone."""
    from symstiff.cli.produce import run_generate

    run_generate(
        robot, output, loads, measure, fixed, model, precision, layout, _list(targets), compile, json
    )


@app.command(epilog="Example: symstiff targets")
def targets(json: Json = None) -> None:
    """List what `generate --targets` can emit."""
    from symstiff.cli.show import show_targets

    show_targets(json)


@app.command(
    epilog="Example: symstiff plan kuka_kr270 --poses 15 --loads gravity --markers p1,p2,p3 -o poses.csv"
)
def plan(
    robot: Robot,
    poses: Annotated[int, typer.Option(help="Number of poses.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Table of poses (CSV) to write.")],
    loads: Annotated[
        str | None,
        typer.Option(help="Class of loads: wrench, force or gravity (default: wrench, or the verdict's)."),
    ] = None,
    measure: Annotated[
        str | None,
        typer.Option(help="What is measured: pose or position (default: pose, or the verdict's)."),
    ] = None,
    criterion: Annotated[
        str, typer.Option(help="D, A or test (error after compensation at --test-poses).")
    ] = "D",
    test_poses: Annotated[
        Path | None, typer.Option(help="Poses at which accuracy matters, for criterion test.")
    ] = None,
    force: Annotated[float | None, typer.Option(help="Magnitude of the load \\[N] (1000).")] = None,
    moment: Annotated[
        float | None,
        typer.Option(
            help="Magnitude of a wrench's moment \\[N·m] (0.5 m times the force, 2/3 of the reach at most)."
        ),
    ] = None,
    steps: Annotated[
        int, typer.Option(help="Steps in which every load comes; several show what is not linear in it.")
    ] = 1,
    candidates: Annotated[int | None, typer.Option(help="Size of the candidate set (20000).")] = None,
    sigma: Annotated[
        float | None, typer.Option(help="Measurement noise of a coordinate \\[mm] (0.03).")
    ] = None,
    levels: Annotated[str | None, typer.Option(help="Distinct values of a joint, e.g. q2=5.")] = None,
    markers: Annotated[
        str | None, typer.Option(help="Measured points, e.g. p1,p2,p3; the pose itself where none.")
    ] = None,
    fixed: Fixed = None,
    keep_out: Annotated[
        str | None,
        typer.Option(help="Box \\[m], world axes, that no line between frames enters: x1,y1,z1,x2,y2,z2."),
    ] = None,
    floor: Annotated[float | None, typer.Option(help="Nothing of the robot below this height \\[m].")] = None,
    margin: Annotated[
        float, typer.Option(help="Part of its range \\[%] that every joint keeps from either limit.")
    ] = 0.0,
    separate: Annotated[
        Path | None,
        typer.Option(
            help="A verdict.json: choose poses that decide among its effects, measured as its data were."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the candidate set.")] = 1,
    refine: Annotated[bool, typer.Option(help="Refine the chosen poses continuously.")] = True,
    cluster: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler, e.g. tcp://host:8786.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture of the poses (PNG or SVG).")] = None,
    json: Json = None,
) -> None:
    """Choose measurement poses by optimal experiment design."""
    from symstiff.cli.plan import PlanRequest, run_plan

    run_plan(
        PlanRequest(
            robot=robot, poses=poses, output=output, loads=loads, measure=measure, criterion=criterion,
            test_poses=test_poses, force=force, moment=moment, steps=steps, candidates=candidates, sigma=sigma,
            levels=levels, markers=_list(markers), fixed=fixed, keep_out=keep_out, floor=floor, margin=margin,
            separate=separate, seed=seed, refine=refine, cluster=cluster, plot=plot, json=json,
        )
    )  # fmt: skip


@app.command(
    epilog="Example: symstiff simulate truth.toml --poses poses.csv --noise 0.03 --seed 1 -o data.csv"
)
def simulate(
    truth: Annotated[Path, typer.Argument(help="What is true (TOML): compliances, effects, noise.")],
    poses: Annotated[Path, typer.Option(help="Poses and loads (CSV).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Measurement table to write.")],
    noise: Annotated[float | None, typer.Option(help="Standard deviation of a coordinate \\[mm].")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise.")] = 0,
    json: Json = None,
) -> None:
    """Run a virtual experiment: the nonlinear equilibrium of the elastic robot, measured with noise."""
    from symstiff.cli.calibrate import run_simulate

    run_simulate(truth, poses, output, noise, seed, json)


@app.command(epilog="Example: symstiff identify kuka_kr270 data.csv -o model.toml")
def identify(
    robot: Robot,
    data: Annotated[list[Path], typer.Argument(help="Measurement tables (CSV).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Model file to write.")],
    start: Annotated[str, typer.Option(help="complete, joints, or a model file.")] = "complete",
    loads: Annotated[
        str | None, typer.Option(help="Class of loads; read from the data where not given.")
    ] = None,
    measure: Annotated[
        str | None, typer.Option(help="pose or position; read from the data where not given.")
    ] = None,
    robust: Annotated[
        bool, typer.Option("--robust", help="Huber's estimator, and a report of outliers.")
    ] = False,
    physical: Annotated[
        bool, typer.Option("--physical", help="Keep every link matrix positive semidefinite.")
    ] = False,
    held_out: Annotated[float, typer.Option(help="Share of the poses kept for validation.")] = 0.0,
    per_level: Annotated[
        str | None,
        typer.Option(help="Joint of a gravity compensator, e.g. q2: one compliance for each of its values."),
    ] = None,
    reconstruct: Annotated[
        Path | None, typer.Option(help="Write complete link matrices (JSON) with bounds.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture of the residuals (PNG or SVG).")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the held-out choice.")] = 0,
    json: Json = None,
) -> None:
    """Identify the parameters from measured deflections, with uncertainty."""
    from symstiff.cli.identify import IdentifyRequest, run_identify

    run_identify(
        IdentifyRequest(
            robot=robot, data=tuple(data), output=output, start=start, loads=loads, measure=measure, robust=robust,
            physical=physical, held_out=held_out, per_level=per_level, reconstruct=reconstruct, plot=plot, seed=seed,
            json=json,
        )
    )  # fmt: skip


@app.command(epilog="Example: symstiff diagnose kuka_kr270 data.csv --start joints -o report")
def diagnose(
    robot: Robot,
    data: Annotated[list[Path], typer.Argument(help="Measurement tables (CSV).")],
    output: Annotated[
        Path, typer.Option("-o", "--output", parser=_folder, metavar="<path>", help="Folder of the report.")
    ],
    start: Annotated[str, typer.Option(help="complete, joints, or a model file.")] = "complete",
    loads: Annotated[
        str | None, typer.Option(help="Class of loads; read from the data where not given.")
    ] = None,
    measure: Annotated[
        str | None, typer.Option(help="pose or position; read from the data where not given.")
    ] = None,
    max_effects: Annotated[
        int,
        typer.Option(
            help="At most so many effects are added; with 1 no model of all links or frames is tried."
        ),
    ] = 3,
    max_poses: Annotated[
        int | None,
        typer.Option(
            help="Use so many poses, evenly spread; where not given 200, fewer where a pose has many readings."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the bootstrap.")] = 0,
    json: Json = None,
) -> None:
    """Find where model and data disagree, name the missing effect, add it, prove it on held-out poses."""
    from symstiff.cli.diagnose import DiagnoseRequest, run_diagnose

    run_diagnose(
        DiagnoseRequest(
            robot=robot, data=tuple(data), output=output, start=start, loads=loads, measure=measure,
            max_effects=max_effects, max_poses=max_poses, seed=seed, json=json,
        )
    )  # fmt: skip


@app.command(epilog="Example: symstiff compensate model.toml trajectory.csv -o corrected.csv")
def compensate(
    model: Annotated[Path, typer.Argument(help="An identified model (model.toml).")],
    trajectory: Annotated[Path, typer.Argument(help="Joint variables and loads (CSV).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Corrected trajectory to write.")],
    json: Json = None,
) -> None:
    """Correct a trajectory off-line for the deflections that a model predicts."""
    from symstiff.cli.calibrate import run_compensate

    run_compensate(model, trajectory, output, json)


@app.command(epilog="Example: symstiff footprint kuka_kr270 --loads gravity")
def footprint(robot: Robot, loads: Loads = "wrench", measure: Measure = "pose", json: Json = None) -> None:
    """Measure code, stack and instructions of the generated C on this machine and on emulated Cortex-M boards."""
    from symstiff.cli.produce import run_footprint

    run_footprint(robot, loads, measure, json)


@app.command(epilog="Example: symstiff reproduce")
def reproduce(
    seed: Annotated[int, typer.Option(min=0, help="Seed of the virtual experiment.")] = 1,
    plot: Annotated[Path | None, typer.Option(help="Picture of the errors (PNG or SVG).")] = None,
    json: Json = None,
) -> None:
    """Reproduce the two tables of Klimchik et al., ICINCO 2014: reduction, and compensation by four models."""
    from symstiff.cli.reproduce import run_reproduce

    run_reproduce(seed, plot, json)


def _list(text: str | None) -> tuple[str, ...]:
    return tuple(t.strip() for t in text.split(",") if t.strip()) if text else ()
