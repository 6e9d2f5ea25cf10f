"""Where results go: tables to the terminal, JSON to a file or standard output; places are checked before the work."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from symstiff.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console
    from rich.table import Table

_ENDLESS = 10_000
"""Columns of a terminal that is wide enough for any table."""
_PICTURES = (".png", ".svg")


def console(json_target: str | None = None) -> Console:
    """The terminal; standard error where JSON takes standard output. Text stays as it is: no markup, no emoji."""
    from rich.console import Console

    return Console(stderr=json_target == "-", highlight=False, soft_wrap=False, markup=False, emoji=False)


def note(out: Console, text: str, head: str = "note") -> None:
    """Print a remark with its head in colour."""
    from rich.text import Text

    out.print(Text.assemble((head, "yellow"), f": {text}"))


def print_table(out: Console, table: Table, text: Collection[str] = ()) -> None:
    """Print a table: ``text`` names the columns that may take several lines, all others stay whole.

    A table that a terminal is too narrow for runs over its edge: a number without its exponent is another number.
    """
    from rich.cells import cell_len
    from rich.measure import Measurement

    for column in table.columns:
        column.overflow = "fold"
        if str(column.header) not in text:
            column.min_width = max(cell_len(str(cell)) for cell in (column.header, *column.cells))
    least = Measurement.get(out, out.options.update(max_width=_ENDLESS), table).minimum
    if least > out.width:
        table.width = least
    out.print(table, crop=False)


def check_targets(
    targets: Mapping[str, str | Path | None],
    inputs: Iterable[str | Path] = (),
    folder: str | Path | None = None,
    mark: str | None = None,
) -> None:
    """Refuse places before the work begins: files by option, and a folder that the command writes as a whole.

    mark: a file that every folder of the command's kind holds (`symstiff.files`). Raises UserError where a file cannot
    be written, is read by the command, is named twice, or lies in the folder; where a picture has an ending that is
    not written.
    """
    from symstiff.files import check_file, check_folder

    inputs = tuple(inputs)
    if folder is not None:
        check_folder(folder, mark)
    seen: dict[str, str] = {}
    for option, place in targets.items():
        if place is None or (option == "--json" and place == "-"):
            continue
        if str(place) == "-":
            raise UserError(f"{option} -: only --json writes to the screen: name a file")
        if option == "--plot" and Path(place).suffix.lower() not in _PICTURES:
            raise UserError(f"{option} {place}: a plot is written as .png or .svg")
        check_file(place, option, inputs)
        if folder is not None and inside(place, folder):
            raise UserError(
                f"{option} {place} lies in {folder}, which this command writes: choose another place"
            )
        if Path(place).exists() and not Path(place).is_file():
            continue  # a device may take several
        other = seen.setdefault(os.path.realpath(place), option)
        if other != option:
            raise UserError(f"{option} and {other} name the same file {place}: give each its own")


def inside(place: str | Path, folder: str | Path) -> bool:
    """Whether a place lies in a folder."""
    return Path(os.path.realpath(place)).is_relative_to(os.path.realpath(folder))


def write_json(target: str | None, result: Any, option: str = "--json") -> None:
    """Write a result as JSON to the file that an option names, or to standard output for ``-``."""
    if target is None:
        return
    if target == "-" and sys.stdout is None:  # closed by the shell: as what is printed, it goes nowhere
        return
    ascii_only = target == "-" and not (sys.stdout.encoding or "").lower().startswith("utf")
    text = json.dumps(_finite(result), indent=2, ensure_ascii=ascii_only, default=float) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    from symstiff.files import write_file

    write_file(target, text, option)


def _finite(value: Any) -> Any:
    """JSON knows no NaN and no infinity: they become null."""
    match value:
        case dict():
            return {k: _finite(v) for k, v in value.items()}
        case list() | tuple():
            return [_finite(v) for v in value]
        case float() if not math.isfinite(value):
            return None
    return value


@contextmanager
def stages(out: Console) -> Iterator[Callable[[str], None]]:
    """Show which stage of a longer job runs, with the time it takes, on a terminal; a file or a pipe gets nothing."""
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    if not out.is_interactive:  # a transient bar would leave an empty line there
        yield lambda stage: None
        return
    text = TextColumn("{task.description}", markup=False)
    with Progress(SpinnerColumn(), text, TimeElapsedColumn(), console=out, transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda stage: bar.update(task, description=stage)
