"""The command that reproduces the seed's tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symstiff.cli.output import check_targets, console, print_table, stages, write_json
from symstiff.cli.show import print_stages

if TYPE_CHECKING:
    from rich.table import Table

    from symstiff.calibration.seed_tables import Row


def run_reproduce(seed: int, plot: Path | None, json: str | None) -> None:
    """Print Table 1 (exact) and Table 2 (a virtual robot) beside the seed's figures."""
    from symstiff.calibration.seed_tables import ROBOT, table2
    from symstiff.reduction import reduce
    from symstiff.robot import load

    check_targets({"--plot": plot, "--json": json})
    out = console(json)
    reduction = reduce(load(ROBOT), "gravity", "pose")
    with stages(out) as progress:
        measured, rows = table2(seed, progress)
    if plot is not None:
        from symstiff.report.figures import save_figure
        from symstiff.report.residuals import draw_models

        save_figure(draw_models(measured, {row.name: row.model for row in rows}), plot)
    write_json(json, {row.name: _record(row) for row in rows})
    print_stages(out, reduction)
    print_table(out, _beside_the_seed(rows))
    out.print(
        "comp.: share of the deflection compensated; fresh RMS: on poses that were not used for the fit"
    )
    if plot is not None:
        out.print(f"wrote {plot}")


def _record(row: Row) -> dict[str, Any]:
    """What ``--json`` tells of a model."""
    after, fresh = row.fitted.after["positional"], row.fresh.after["positional"]
    return {
        "parameters": row.parameters,
        "rank": row.rank,
        "max_mm": 1e3 * after.max,
        "rms_mm": 1e3 * after.rms,
        "compensated": row.fitted.compensated,
        "fresh_rms_mm": 1e3 * fresh.rms,
    }


def _beside_the_seed(rows: Sequence[Row]) -> Table:
    """Errors of the models, the seed's in the last columns."""
    from rich.table import Table

    from symstiff.calibration.seed_tables import SEED

    table = Table(
        title="positional errors [mm]: a virtual KR 270, and the seed's Table 2", title_justify="left"
    )
    for column in ("model", "n", "rank", "MAX", "RMS", "comp.", "fresh RMS", "seed n", "MAX", "RMS"):
        table.add_column(column, justify="left" if column == "model" else "right")
    before = rows[0].fitted.before["positional"]
    _, largest, rms = SEED["uncompensated"]
    found = (f"{1e3 * before.max:.2f}", f"{1e3 * before.rms:.2f}")
    table.add_row("none", "–", "–", *found, "–", "–", "–", f"{largest}", f"{rms}")
    for row in rows:
        told = _record(row)
        n, largest, rms = SEED[row.name]
        table.add_row(
            row.name, str(row.parameters), str(row.rank), f"{told['max_mm']:.2f}", f"{told['rms_mm']:.2f}",
            f"{100 * row.fitted.compensated:.1f} %", f"{told['fresh_rms_mm']:.2f}", str(n), f"{largest}", f"{rms}",
        )  # fmt: skip
    return table
