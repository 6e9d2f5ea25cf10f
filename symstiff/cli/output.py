"""Where results go: tables to the terminal, JSON to a file or to standard output."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console


def console(json_target: str | None = None) -> Console:
    """The terminal; standard error where JSON takes standard output."""
    from rich.console import Console

    return Console(stderr=json_target == "-", highlight=False, soft_wrap=False)


def write_json(target: str | None, result: Any) -> None:
    """Write a result as JSON to a file, or to standard output for ``-``."""
    if target is None:
        return
    text = json.dumps(result, indent=2, ensure_ascii=False, default=float) + "\n"
    if target == "-":
        sys.stdout.write(text)
        return
    from symstiff.files import write_file

    write_file(target, text)


@contextmanager
def stages(out: Console) -> Iterator[Callable[[str], None]]:
    """Show which stage of a longer job runs, with the time it takes, on a terminal."""
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    with Progress(
        SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=out, transient=True
    ) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda text: bar.update(task, description=text)
