"""The command that identifies a model."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symstiff.cli.output import check_targets, console, note, print_table, stages, write_json
from symstiff.cli.show import whole_number
from symstiff.display import times
from symstiff.errors import UserError
from symstiff.robot import load

if TYPE_CHECKING:
    from rich.console import Console

    from symstiff.calibration.identify import Identification
    from symstiff.calibration.residuals import ResidualTable

_SHOWN = 5
"""Correlations, and outliers of a kind, that are printed at most."""
_CONTRADICTED = 1e-3
"""Probability of what physical bounds cost below which the data speak against them."""


@dataclass(frozen=True, kw_only=True)
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
    from symstiff.calibration.complete import reconstruct_model
    from symstiff.calibration.identify import identify
    from symstiff.calibration.tables.table import read_table

    level = _joint(request.per_level)
    _check(request)
    robot = load(request.robot)
    out = console(request.json)
    with stages(out) as progress:
        progress("reading the tables")
        table = read_table(request.data)
        if table.kind == "absolute" and request.reconstruct is not None:
            raise UserError(
                "--reconstruct needs deflections, these tables hold absolute positions: leave it out"
            )
        progress("identifying")
        result = identify(
            robot, table, request.start, loads=request.loads, measure=request.measure, robust=request.robust,
            physical=request.physical, held_out=request.held_out, per_level=level,
            seed=request.seed,
        )  # fmt: skip
        complete = None
        if request.reconstruct is not None:
            progress("reconstructing complete link matrices")
            complete = reconstruct_model(result)
    if request.plot is not None:
        from symstiff.report.figures import save_figure
        from symstiff.report.residuals import draw_residuals

        save_figure(draw_residuals(result), request.plot)
    if complete is not None:
        write_json(str(request.reconstruct), complete.to_dict(), "--reconstruct")
    result.model.save(request.output)
    write_json(request.json, result.to_dict())
    _print_identification(out, result)
    if complete is not None:
        out.print(f"complete link matrices: {complete}; wrote {request.reconstruct}")
    out.print(f"wrote {request.output}")


def _check(request: IdentifyRequest) -> None:
    """Refuse what cannot be followed before the work begins."""
    if request.reconstruct is not None and (request.start != "complete" or request.per_level is not None):
        raise UserError("--reconstruct needs --start complete and no --per-level: leave it or them out")
    targets = {"-o": request.output, "--reconstruct": request.reconstruct, "--plot": request.plot}
    check_targets({**targets, "--json": request.json}, [request.robot, *request.data, request.start])


def _joint(text: str | None) -> int | None:
    if text is None:
        return None
    joint = whole_number(text.removeprefix("q"))
    if joint is None:
        raise UserError(f"--per-level {text!r}: name a joint, e.g. q2")
    return joint


def _print_identification(out: Console, result: Identification) -> None:
    from rich.table import Table

    fit, model = result.fit, result.model
    table = Table(
        title=f"{model.robot.title or model.robot.name}: {len(fit.names)} parameters", title_justify="left"
    )
    for column in ("parameter", "value", "σ", "σ/value", "95 % ±", "unit"):
        table.add_column(column, justify="left" if column in ("parameter", "unit") else "right")
    for k, name in enumerate(fit.names):
        value, std = float(model.values.get(name, fit.values[k])), float(fit.std[k])
        if not isfinite(std):
            table.add_row(name, *["–"] * 4, fit.units[k])
            continue
        share = f"{100 * std / abs(value):.1f} %" if std < 10 * abs(value) else "–"
        half = (fit.upper[k] - fit.lower[k]) / 2
        table.add_row(name, f"{value:.4e}", f"{std:.1e}", share, f"{half:.1e}", fit.units[k])
    print_table(out, table)
    print_residuals(out, [("identified poses", result.training), ("held-out poses", result.validation)])
    out.print(str(fit.rank))
    if fit.fit_p is not None:
        out.print(
            f"unit variance {times(fit.s0_squared)} ({fit.dof} degrees of freedom), fit p {_probability(fit.fit_p)}"
        )
    for a, b, value in fit.correlated()[:_SHOWN]:
        out.print(f"strongly correlated: {a}, {b} ({value:+.3f})")
    if result.robust is not None:
        for suspect in (*result.robust.poses[:_SHOWN], *result.robust.rows[:_SHOWN]):
            out.print(f"outlier: {suspect}")
    if result.physical is not None:
        for bound in result.physical.active:
            out.print(f"physics: {bound}")
        if result.physical.active:
            p = result.physical.implausible_p
            verdict = ": the data contradict them" if p < _CONTRADICTED else ""
            out.print(
                f"noise alone makes these bounds cost as much with p {_probability(p)}{verdict}; the deviations above "
                "are those of the fit without them"
            )
    for remark in result.remarks:
        note(out, remark)


def _probability(p: float) -> str:
    """A probability as far as anybody would believe it."""
    return f"= {p:.2g}" if p >= 1e-16 else "< 1e-16"


def print_residuals(out: Console, parts: list[tuple[str, Any]]) -> None:
    """MAX and RMS by axis before and after compensation, as the seed's Table 2."""
    from rich.table import Table

    from symstiff.discrepancy.findings.numbers import milli

    for title, residuals in parts:
        if residuals is None:
            continue
        if residuals.geometry is not None:
            _print_steps(out, residuals)
            continue
        share = f": {100 * residuals.compensated:.1f} % of the deflection compensated"
        table = Table(title=title + (share if isfinite(residuals.compensated) else ""), title_justify="left")
        table.add_column("")
        for when in ("before", "after"):
            table.add_column(f"{when} MAX", justify="right")
            table.add_column(f"{when} RMS", justify="right")
        for axis, before in residuals.before.items():
            unit = "mrad" if axis.startswith("r") else "mm"
            both = (before, residuals.after[axis])
            table.add_row(f"{axis} [{unit}]", *(milli(x) for s in both for x in (s.max, s.rms)))
        print_table(out, table)


def _print_steps(out: Console, residuals: ResidualTable) -> None:
    """What is left of absolute positions: of them the geometry explains most, and the model holds none of it."""
    from rich.table import Table

    from symstiff.discrepancy.findings.numbers import milli

    steps = {
        "placed, rigid and uncalibrated": residuals.before,
        "geometry alone": residuals.geometry or {},
        "geometry and compliances": residuals.after,
    }
    table = Table(title="what is left of the positions [mm, mrad]", title_justify="left")
    table.add_column("step", no_wrap=True)
    kinds = [kind for kind in ("positional", "rotational") if kind in residuals.before]
    for kind in kinds:
        table.add_column(f"{kind[:3]}. MAX", justify="right")
        table.add_column(f"{kind[:3]}. RMS", justify="right")
    for step, sizes in steps.items():
        table.add_row(step, *(milli(x) for kind in kinds for x in (sizes[kind].max, sizes[kind].rms)))
    print_table(out, table)
