"""The house: data flows left to right, and nothing imports what is to its right, not even inside a function."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import symstiff

PACKAGE = Path(symstiff.__file__).parent
ORDER = [
    {"errors", "arguments", "arrays", "files", "display", "threads"}, {"robot"}, {"symbolic"}, {"reduction"},
    {"effects"}, {"model", "model_file", "model_reading", "slopes", "states"}, {"codegen"},
    {"calibration", "compensation"}, {"discrepancy"}, {"report"}, {"cli"},
]  # fmt: skip
INSIDE = {
    "calibration": [
        {"plausible"}, {"tables"}, {"fits"}, {"residuals", "rows"}, {"experiment"}, {"doubts"},
        {"simulation"}, {"planning"},
        {"absolute", "complete", "counted", "fitting", "foreseen", "identify", "kept", "levels", "physical", "plan",
         "reading", "redundant", "remarks", "seed_tables"},
    ],
    "discrepancy": [
        {"problem", "reasons"}, {"noise"}, {"laws"}, {"statistics"}, {"search", "bridge"}, {"apart"}, {"findings"},
        {"climb", "conclusion", "examine", "outgrown", "workflow"},
    ],
}  # fmt: skip
"""The order within a room that has rooms of its own."""
LEVEL = {room: k for k, rooms in enumerate(ORDER) for room in rooms} | {"__version__": 0}
DOORS = {("model", "codegen.runtime")}
"""A model evaluates itself by its own compiled code."""


def _imports(path: Path) -> set[str]:
    """What a module imports of the package, without the package's name."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(a.name for a in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module == "symstiff":
            found.update(f"symstiff.{a.name}" for a in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module)
    return {m.removeprefix("symstiff.") for m in found if m.startswith("symstiff.")}


def test_nothing_imports_what_is_to_its_right() -> None:
    for path in PACKAGE.rglob("*.py"):
        place = path.relative_to(PACKAGE).with_suffix("").parts
        if place[0].startswith("__"):  # the front door shows names of all rooms
            continue
        for module in _imports(path):
            allowed = LEVEL[module.split(".")[0]] <= LEVEL[place[0]] or (".".join(place), module) in DOORS
            assert allowed, f"{'/'.join(place)} imports {module}"


@pytest.mark.parametrize("room", INSIDE)
def test_nothing_inside_a_room_imports_what_is_to_its_right(room: str) -> None:
    order = {name: k for k, names in enumerate(INSIDE[room]) for name in names}
    for path in (PACKAGE / room).rglob("*.py"):
        place = path.relative_to(PACKAGE / room).with_suffix("").parts
        own = (m.split(".") for m in _imports(path))
        for module in (m for m in own if m[0] == room and place[0] != "__init__"):
            assert order[module[1]] <= order[place[0]], f"{'/'.join(place)} imports {'.'.join(module)}"


@pytest.mark.parametrize("room", INSIDE)
def test_every_room_inside_a_room_has_its_place(room: str) -> None:
    assert _names(PACKAGE / room) == set().union(*INSIDE[room])


def test_every_room_has_its_place_in_the_order() -> None:
    assert _names(PACKAGE) - {"py.typed"} == set().union(*ORDER)


def _names(folder: Path) -> set[str]:
    """Modules and rooms of a folder."""
    return {p.name.removesuffix(".py") for p in folder.iterdir() if not p.name.startswith("_")}


def test_commands_on_data_do_without_the_distributions_that_take_long_to_load() -> None:
    doors = (
        "symstiff.cli, symstiff.calibration.identify, symstiff.discrepancy.workflow, symstiff.report.folder"
    )
    script = f"import sys, {doors}\nprint('scipy.stats' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
