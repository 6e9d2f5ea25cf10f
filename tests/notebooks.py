"""The worked examples in notebooks/: executed from a clean kernel; ``python -m tests.notebooks`` refreshes them."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent.parent / "notebooks"


def notebooks() -> list[Path]:
    """All notebooks, in reading order."""
    return sorted(FOLDER.glob("*.ipynb"))


def executed(path: Path) -> Any:
    """A notebook's node after a run from a clean kernel; raises nbclient's CellExecutionError."""
    import nbformat
    from nbclient import NotebookClient

    node = nbformat.read(path, as_version=4)
    for cell in node.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    client = NotebookClient(
        node, timeout=300, kernel_name="python3", record_timing=False, coalesce_streams=True
    )
    client.execute(cwd=str(FOLDER))
    return node


def refresh(path: Path) -> None:
    """Execute and write: outputs, and no trace of the machine in the metadata."""
    import nbformat

    node = executed(path)
    node.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for number, cell in enumerate(node.cells, start=1):
        cell.id, cell.metadata = f"cell-{number:02d}", {}
        for output in cell.get("outputs", []):
            plain = output.get("data", {}).get("text/plain")
            if plain:  # the address of an object differs from run to run
                output["data"]["text/plain"] = re.sub(r" at 0x[0-9a-f]+", "", plain)
    path.write_bytes((nbformat.writes(node).rstrip("\n") + "\n").encode())


if __name__ == "__main__":
    for notebook in notebooks():
        refresh(notebook)
        sys.stdout.write(f"executed {notebook.name}\n")
