"""The README's Python: it runs, a type checker accepts it, and `help(symstiff)` shows what a user may import."""

from __future__ import annotations

import os
import pydoc
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import symstiff
from symstiff import Goal, Load, StiffnessModel, Task, load

ROOT = Path(__file__).parent.parent
(BLOCK,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
TRUTH = """format = 1
robot = "planar2r"
[measure]
components = "pose"
[noise]
sigma_mm = 0.01
sigma_mrad = 0.01
"""


def test_the_python_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(BLOCK, "README.md", "exec"), names)
    assert names["dt"].shape == (1, 6)  # type: ignore[attr-defined]
    assert (tmp_path / "kr270" / "manifest.json").is_file()


@pytest.mark.slow
def test_the_python_of_the_readme_passes_a_strict_type_checker(tmp_path: Path) -> None:
    file = tmp_path / "readme.py"
    uses = "".join(f"print(symstiff.{name})\n" for name in symstiff.__all__)
    file.write_text(f"import symstiff\n{BLOCK}{uses}", encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", str(file)]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"MYPYPATH": str(ROOT)},
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_docstring_holds_the_python_of_the_readme() -> None:
    assert symstiff.__doc__ is not None
    lines = [line.strip() for line in symstiff.__doc__.splitlines()]
    assert [line for line in BLOCK.splitlines() if line] == [n for n in lines if n in BLOCK and n]


def test_every_door_that_the_readme_names_is_there() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    doors = re.findall(r"`symstiff\.([\w.]+)\.(\w+)(?:\([^`]*\))?`", text)
    assert len(doors) >= 4
    for module, name in doors:
        assert callable(getattr(import_module(f"symstiff.{module}"), name)), f"{module}.{name}"
    assert callable(symstiff.reduce(load("planar2r")).full_values)


def test_help_shows_every_exported_name() -> None:
    assert set(symstiff.__all__) == set(symstiff._HOME)
    shown = pydoc.render_doc(symstiff, renderer=pydoc.plaintext)
    for name in symstiff.__all__:
        assert re.search(rf"^    (class )?{name}\b", shown, re.MULTILINE), name


def test_arrays_become_a_table_that_is_identified() -> None:
    rng = np.random.default_rng(0)
    q, w = rng.uniform(-2.0, 2.0, (30, 2)), rng.normal(size=(30, 6)) * [50.0, 50, 50, 0, 0, 0]
    truth = symstiff.truth_from_table({"robot": "planar2r", "measure": {"components": "pose"}})
    read = symstiff.simulate(truth, symstiff.measurements(q, w), 1).values
    table = symstiff.measurements(q, w, values=read, kind="deflection")
    model = symstiff.identify(load("planar2r"), table, start="joints").model
    assert model.deflection(q, w) == pytest.approx(read, abs=0.5 * np.abs(read).max())
    grown = model.with_effect(symstiff.EffectInstance("backlash", {"joint": 1}, {"width": 5.0}))
    assert len(grown.parameters) == len(model.parameters) + 1


@pytest.mark.slow
def test_from_a_plan_to_a_report_without_the_command_line(tmp_path: Path) -> None:
    robot = load("planar2r")
    model = StiffnessModel.of(symstiff.reduce(robot, "force", "pose"))
    plan = symstiff.plan(model, Goal(12), Load("force", 50.0), search=None)
    (tmp_path / "poses.csv").write_text(
        "q1[rad],q2[rad],fx[N],fy[N],fz[N]\n"
        + "".join(f"{q[0]},{q[1]},{w[0]},{w[1]},{w[2]}\n" for q, w in zip(plan.q, plan.w, strict=True))
    )
    (tmp_path / "truth.toml").write_text(TRUTH)
    poses = symstiff.read_poses(tmp_path / "poses.csv")
    symstiff.write_table(
        symstiff.simulate(symstiff.load_truth(tmp_path / "truth.toml"), poses, 1), tmp_path / "d.csv"
    )
    table = symstiff.read_table(tmp_path / "d.csv")
    assert symstiff.identify(robot, table).model.parameters
    finding = symstiff.diagnose(Task(robot, table, loads="force"))
    assert symstiff.write_report(finding, tmp_path / "report").verdict["robot"] == "planar2r"
