"""The command that names what is missing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symstiff.cli.output import check_targets, console, inside, note, print_table, stages, write_json
from symstiff.errors import UserError
from symstiff.files import DIAGNOSIS
from symstiff.robot import load

if TYPE_CHECKING:
    from rich.console import Console

    from symstiff.discrepancy.findings.finding import Finding


@dataclass(frozen=True, kw_only=True)
class DiagnoseRequest:
    """The options of ``symstiff diagnose``."""

    robot: str
    data: tuple[Path, ...]
    output: Path
    start: str
    loads: str | None
    measure: str | None
    max_effects: int
    max_poses: int | None
    seed: int
    json: str | None


def run_diagnose(request: DiagnoseRequest) -> None:
    """Read, diagnose, grow, write the folder, say the verdict."""
    from symstiff.calibration.tables.table import read_table
    from symstiff.discrepancy.findings.finding import Task
    from symstiff.discrepancy.workflow import diagnose
    from symstiff.report.folder import write_report

    robot = load(request.robot)
    inputs: list[str | Path] = [request.robot, *request.data, request.start]
    for source in inputs:
        if Path(source).is_file() and inside(source, request.output):
            raise UserError(
                f"{source} lies in {request.output}, which this command writes: give another folder"
            )
    check_targets({"--json": request.json}, inputs, request.output, DIAGNOSIS)
    out = console(request.json)
    with stages(out) as progress:
        progress("reading the tables")
        table = read_table(request.data)
        task = Task(
            robot, table, request.start, request.loads, request.measure, request.max_effects,
            request.max_poses, request.seed,
        )  # fmt: skip
        finding = diagnose(task, progress)
        written = write_report(finding, request.output, progress)
    write_json(request.json, written.verdict)
    _print(out, finding, written.verdict["sentence"])
    out.print(f"code: {written.code}")
    code = ", code" if written.verdict["code"]["folder"] else ""
    out.print(f"wrote {request.output}: report.html, verdict.json, model.toml{code}{_more(written.verdict)}")
    if written.verdict["code"]["fault"]:
        raise SystemExit(1)


def _more(verdict: dict[str, Any]) -> str:
    """The files of deciding poses, where they were written, with what these reach."""
    from symstiff.report.deciding import reached

    told = reached(verdict["decide"]) if "decide" in verdict else ""
    return f", decide.csv (poses that reach {told}), taken.csv (those of the data)" if told else ""


def _print(out: Console, finding: Finding, sentence: str) -> None:
    from rich.table import Table

    from symstiff.discrepancy.findings.numbers import milli, p_text
    from symstiff.effects.places import named
    from symstiff.report.naming import shape_text
    from symstiff.report.tables import step_rows
    from symstiff.report.words import headline

    out.print(headline(finding), style="bold")
    out.print(sentence)
    rows = step_rows(finding)
    whole: list[str] = [a for a in ("positional", "rotational") if a in rows[0].sizes]
    shown = whole or list(rows[0].sizes)  # axes are in the report; positions as a whole fit a terminal
    table = Table(title="residuals [mm, mrad]", title_justify="left")
    table.add_column("step")
    table.add_column("n", justify="right")
    for axis in shown:
        short = {"positional": "pos.", "rotational": "rot."}.get(axis, axis)
        table.add_column(f"{short} MAX", justify="right")
        table.add_column(f"{short} RMS", justify="right")
    table.add_column("p left", justify="right")
    for row in rows:
        cells = [milli(1e-3 * x) for a in shown for x in row.sizes.get(a, (float("nan"),) * 2)]
        table.add_row(row.title, row.parameters, *cells, "" if row.p_left is None else p_text(row.p_left))
    print_table(out, table, ["step"])
    for effect in finding.named:
        if shape := shape_text(finding, effect):
            out.print(f"law of {named(effect.effect, effect.where)}: {shape}")
    for remark in finding.remarks:
        note(out, remark)
