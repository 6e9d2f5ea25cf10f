"""The folder of a diagnosis: report.html, verdict.json, model.toml, code/, decide.csv; whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from symstiff.discrepancy.deciding import Rival, decide_poses, experiment_like, rival_columns
from symstiff.discrepancy.growth import of_robot
from symstiff.discrepancy.workflow import Finding
from symstiff.errors import UserError
from symstiff.files import new_folder
from symstiff.report.code import Line, core, difference
from symstiff.report.html import render
from symstiff.report.verdict import verdict_table

DECIDING = 6
"""Poses in decide.csv."""


@dataclass(frozen=True)
class Written:
    """What was written: the verdict as plain values, and what became of the code."""

    folder: Path
    verdict: dict[str, Any]
    code: str


def write_folder(finding: Finding, folder: Path, tell: Callable[[str], None] = lambda stage: None) -> Written:
    """Write everything that a diagnosis leaves behind. Raises UserError where the place cannot be written."""
    with new_folder(folder) as temporary:
        verdict = verdict_table(finding)
        tell("code")
        code = _code(finding, temporary.resolve() / "code")
        changes = _changes(finding) if code["folder"] else []
        decide = write_deciding_poses(finding, temporary, verdict, tell)
        verdict["code"] = code
        finding.grown.model.save(temporary / "model.toml")
        tell("report")
        page = render(finding, {"code": code, "decide": decide}, changes)
        (temporary / "report.html").write_bytes(page.encode())
        (temporary / "verdict.json").write_bytes(
            (json.dumps(verdict, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()
        )
    return Written(folder, verdict, code["text"])


def _code(finding: Finding, folder: Path) -> dict[str, Any]:
    """Regenerate the code; a model that no controller can evaluate gets none, with the reason."""
    from symstiff.codegen.generate import generate

    model = of_robot(finding.grown.model)
    left_out = [e.effect for e in finding.grown.model.effects if e not in model.effects]
    note = (
        f"; without {', '.join(left_out)}: no law of the robot that a controller evaluates"
        if left_out
        else ""
    )
    try:
        made = generate(model, folder)
    except UserError as error:
        return {"folder": False, "compiled": False, "text": f"no code was written: {error}", "error": None}
    proof = made.verification
    if proof.compiled:
        text = f"compiled by {proof.compiler} without a warning, self-test passed"
    else:
        text = "not compiled: no C compiler was found"
    return {
        "folder": True,
        "compiled": proof.compiled,
        "text": text + note,
        "error": proof.max_relative_error,
    }


def _changes(finding: Finding) -> list[Line]:
    before, after = of_robot(finding.start.model), of_robot(finding.grown.model)
    if before.structure_hash == after.structure_hash:
        return []
    return difference(core(before), core(after))


def write_deciding_poses(
    finding: Finding, folder: Path, verdict: dict[str, Any], tell: Callable[[str], None]
) -> dict[str, Any] | None:
    """decide.csv for an ambiguous verdict: poses and loads that tell the admissible sets apart."""
    from symstiff.calibration.table import write_table

    if finding.verdict != "ambiguous":
        return None
    rivals = rivals_of(finding)
    if len(rivals) < 2:
        return None
    tell("deciding poses")
    model, experiment = finding.start.model, experiment_like(finding.table)
    taken = rival_columns(model, rivals, finding.table)
    table, found = decide_poses(
        model, rivals, experiment, finding.last.noise.sigma, DECIDING, finding.task.seed, taken
    )
    write_table(table, folder / "decide.csv", "deg")
    record = {
        "poses": [
            {"pose": label, "separation": float(s)}
            for label, s in zip(table.labels, found.separation, strict=True)
        ],
        "file": "decide.csv",
    }
    verdict["decide"] = record
    return record


def rivals_of(finding: Finding) -> list[Rival]:
    """The admissible sets as rivals."""
    out = []
    for number in sorted({e.set_number for e in finding.effects}):
        members = [e for e in finding.effects if e.set_number == number]
        values = {n: v.value for e in members for n, v in e.parameters.items()}
        out.append(Rival(tuple(e.instance for e in members), values))
    return out
