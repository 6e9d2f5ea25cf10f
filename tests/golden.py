"""The committed folders in ``generated/``, written again and compared byte by byte.

``python -m tests.golden`` refreshes them; ``python -m tests.golden --check`` compares and fails on a difference.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from pathlib import Path

from symstiff.codegen.generate import generate
from symstiff.codegen.options import Options
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load

FOLDER = Path(__file__).resolve().parent.parent / "generated"
ROBOTS = {"kuka_kr270": "gravity", "ur10": "wrench"}


def write(name: str, folder: Path) -> None:
    """Generate one reference robot anew, without what differs between machines (``verified`` in the manifest)."""
    model = StiffnessModel.of(reduce(load(name), ROBOTS[name]))
    shutil.rmtree(folder, ignore_errors=True)
    generate(model, folder, Options(), compile_c=False)
    manifest = folder / "manifest.json"
    table = json.loads(manifest.read_text())
    table.pop("verified")
    manifest.write_text(json.dumps(table, indent=2) + "\n")


def differences(name: str, fresh: Path) -> list[str]:
    """Files that differ between the committed and the fresh folder."""
    committed = FOLDER / name
    names = {p.relative_to(root) for root in (committed, fresh) for p in root.rglob("*") if p.is_file()}
    return [
        f"{name}/{n}"
        for n in sorted(names)
        if not (committed / n).is_file()
        or not (fresh / n).is_file()
        or (committed / n).read_bytes() != (fresh / n).read_bytes()
    ]


def main() -> int:
    """Refresh, or check."""
    changed: list[str] = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in ROBOTS:
            if "--check" in sys.argv:
                write(name, Path(scratch) / name)
                changed += differences(name, Path(scratch) / name)
            else:
                write(name, FOLDER / name)
    for line in changed:
        print(f"differs: generated/{line}")
    if changed:
        print("refresh them with: python -m tests.golden")
    return 1 if changed else 0


if __name__ == "__main__":
    raise SystemExit(main())
