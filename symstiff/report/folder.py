"""The folder of a diagnosis: report.html, verdict.json, model.toml, code/, decide.csv; whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from symstiff.arguments import require
from symstiff.calibration.experiment.readings import experiment_of
from symstiff.calibration.identify import start_model
from symstiff.calibration.tables.measurements import COMPONENTS, Measurements
from symstiff.calibration.tables.writing import LOADS
from symstiff.discrepancy.apart.deciding import Choice, Rival, decide_by, setups_like
from symstiff.discrepancy.apart.separate import TAKEN
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.search.verdict import AMBIGUOUS
from symstiff.effects.places import named
from symstiff.errors import UserError
from symstiff.files import DIAGNOSIS, new_folder
from symstiff.model import StiffnessModel
from symstiff.report.code import Line, core, difference, excerpt
from symstiff.report.html import render
from symstiff.report.verdict import verdict_table

FEWEST, MOST, AMPLE = 6, 15, 100.0
"""Poses in decide.csv: as many as make the explanations differ amply, within these bounds."""


@dataclass(frozen=True)
class Written:
    """What was written: the verdict as plain values, and what became of the code."""

    folder: Path
    verdict: dict[str, Any]
    code: str

    def __repr__(self) -> str:
        return f"Written({str(self.folder)!r}: report.html, verdict.json, model.toml; {self.code})"


def write_report(finding: Finding, folder: str | Path, tell: Callable[[str], None] | None = None) -> Written:
    """Write report.html, verdict.json, model.toml and the code of the grown model; whole or not at all.

    ``folder`` is new, or of an earlier diagnosis, whose files are replaced; ``tell`` is told each stage. The result's
    ``verdict`` holds what verdict.json does. Raises UserError where the place cannot be written.
    """
    require(finding, Finding, "a finding", "diagnose(Task(robot, table)) gives one")
    folder, tell = Path(folder), tell or (lambda stage: None)
    with new_folder(folder, DIAGNOSIS) as temporary:
        tell("code")
        code = _code(finding, temporary.resolve() / "code")
        changes = _changes(finding, temporary / "code") if code["folder"] else []
        decide = write_deciding_poses(finding, temporary, tell)
        verdict = {**verdict_table(finding, decide), "code": code}
        finding.model.save(temporary / "model.toml")
        tell("report")
        page = render(finding, {"code": code, "decide": decide}, changes)
        (temporary / "report.html").write_bytes(page.encode())
        (temporary / DIAGNOSIS).write_bytes(
            (json.dumps(verdict, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()
        )
    return Written(folder, verdict, code["text"])


def _code(finding: Finding, folder: Path) -> dict[str, Any]:
    """Regenerate the code; a model that no controller can evaluate gets none, with the reason."""
    from symstiff.codegen.generate import generate

    if finding.last.doubtful:
        return _no_code("no code was written: model.toml is of a table that has to be corrected", fault=False)
    if finding.grown.absorbed and not finding.testable:
        return _no_code("no code was written: the data do not determine the model", fault=False)
    if not _gives_way(finding.model):
        return _no_code(
            "no code was written: the data do not determine any compliance, nor any law of joints or links",
            fault=False,
        )
    try:
        made = generate(finding.model, folder)
    except UserError as error:
        return _no_code(f"no code was written: {error}", fault=False)
    except Exception as fault:  # the verdict is worth keeping without the code
        return _no_code(
            f"no code was written, by a fault of ours: {type(fault).__name__}: {fault}", fault=True
        )
    proof = made.verification
    if proof.compiled:
        text = f"compiled by {proof.compiler} without a warning, self-test passed"
    else:
        text = f"not compiled: {proof.reason or 'no C compiler was found'}"
    if not finding.model.bends:
        text += "; all compliances are zero: it bends under no load"
    if made.left_out:
        names = ", ".join(named(e.effect, e.where) for e in made.left_out)
        text += f"; without {names}: no law of joints or links, which a controller evaluates"
    return {
        "folder": True,
        "compiled": proof.compiled,
        "text": text,
        "error": proof.max_relative_error,
        "fault": False,
    }


def _gives_way(model: StiffnessModel) -> bool:
    """Whether a compliance, or a law of joints or links, has a value: errors of frames are some without any load."""
    lawful = {t.parameter for t in model.terms if t.at.kind in ("link", "joint")}
    return any(value for name, value in model.values.items() if name in lawful)


def _no_code(text: str, *, fault: bool) -> dict[str, Any]:
    return {"folder": False, "compiled": False, "text": text, "error": None, "fault": fault}


def _changes(finding: Finding, code: Path) -> list[Line]:
    """What the effects changed in the C that was written."""
    before, after = finding.told.of_robot(), finding.model.of_robot()
    if before.structure_hash == after.structure_hash:
        return []
    emitted = "".join((code / f"{after.robot.name}.{end}").read_text("utf-8") for end in ("h", "c"))
    return difference(core(before), excerpt(emitted))


def write_deciding_poses(
    finding: Finding, folder: Path, tell: Callable[[str], None]
) -> dict[str, Any] | None:
    """decide.csv for an ambiguous verdict: poses and loads that tell the admissible sets apart; its record."""
    from symstiff.calibration.tables.table import write_table

    if finding.verdict != AMBIGUOUS:
        return None
    rivals = rivals_of(finding)
    if len(rivals) < 2:
        return None
    choice, model = Choice(MOST, FEWEST, AMPLE, finding.task.seed), _free_model(finding)
    setup, table, found = decide_by(
        setups_like(finding.table),
        model,
        rivals,
        finding.last.noise.by_component(),
        choice,
        finding.table,
        tell,
    )
    record = {
        "file": "decide.csv" if found.poses else None,
        "taken": TAKEN if found.poses else None,
        "kind": setup.kind,
        "components": list(setup.components),
        "points": list(setup.points),
        "loads": [dict(zip(LOADS, map(float, w), strict=True)) for w in setup.loads],
        "branches": [b for b in ("up", "down") if len(setup.branches) > 1],
        "poses": [
            {"pose": label, "q": _joints(table, k), "separation": float(s)}
            for k, (label, s) in enumerate(zip(table.labels, found.separation, strict=True))
        ],
    }
    if found.poses:
        write_table(table, folder / "decide.csv", "deg")
        write_table(_without_readings(finding.table), folder / TAKEN)
    return record


def _joints(table: Measurements, pose: int) -> dict[str, float]:
    """Joint variables of a pose in the units of decide.csv."""
    q = table.q[np.flatnonzero(table.pose == pose)[0]]
    turning = [unit == "rad" for unit in table.joint_units]
    return {
        f"q{k + 1}[{'deg' if t else 'm'}]": round(float(np.degrees(x) if t else x), 9)
        for k, (x, t) in enumerate(zip(q, turning, strict=True))
    }


def _without_readings(table: Measurements) -> Measurements:
    nothing = np.full((len(table), len(COMPONENTS)), np.nan)
    return replace(table, kind="none", values=nothing, sigma=nothing)


def _free_model(finding: Finding) -> StiffnessModel:
    """The start model as it is where no joint stands still: the deciding poses turn them all."""
    task, start = finding.task, finding.start.model
    experiment = experiment_of(finding.table, task.robot)
    if task.start not in ("complete", "joints") or not experiment.fixed:
        return start
    moving = replace(experiment.wished(start.loads, start.measure), fixed={})
    free = start_model(task.robot, task.start, moving)[0]
    return free.with_values({n: start.values.get(n, 0.0) for n in free.parameters})


def rivals_of(finding: Finding) -> list[Rival]:
    """The admissible sets as rivals."""
    out = []
    for number in sorted({e.set_number for e in finding.effects}):
        members = [e for e in finding.effects if e.set_number == number]
        values = {n: v.value for e in members for n, v in e.parameters.items()}
        out.append(Rival(tuple(e.instance for e in members), values))
    return out
