"""The command that produces code."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from symstiff.cli.output import check_targets, console, note, stages, write_json
from symstiff.cli.show import parse_fixed, print_stages
from symstiff.errors import UserError
from symstiff.robot import load

if TYPE_CHECKING:
    from rich.console import Console

    from symstiff.codegen.generate import Generated
    from symstiff.model import StiffnessModel
    from symstiff.robot.schema import Robot

_SAME = 1e-9
"""Distance [m] up to which two tool centre points are one."""


def run_generate(
    robot: str,
    output: Path,
    loads: str | None,
    measure: str | None,
    fixed: str | None,
    model_file: Path | None,
    precision: str,
    layout: str,
    targets: tuple[str, ...],
    compile_c: bool,
    json: str | None,
) -> None:
    """Derive, reduce, emit, compile, verify, report."""
    from symstiff.codegen.generate import generate
    from symstiff.codegen.options import Options

    options = Options(precision, layout, targets)
    if model_file is not None and fixed:
        raise UserError("--fixed has no effect with --model, which was reduced already: leave it out")
    check_targets({"--json": json}, [p for p in (robot, model_file) if p is not None], folder=output)
    out = console(json)
    with stages(out) as progress:
        progress("deriving and reducing")
        if model_file is None:
            model = _fresh(out, robot, loads or "wrench", measure or "pose", fixed)
        else:
            model = _identified(robot, model_file, loads, measure)
        result = generate(model, output, options, compile_c=compile_c, footprint=compile_c, progress=progress)
    _report(out, result)
    write_json(json, result.manifest)


def _fresh(out: Console, robot: str, loads: str, measure: str, fixed: str | None) -> StiffnessModel:
    from symstiff.model import StiffnessModel
    from symstiff.reduction import reduce

    reduction = reduce(load(robot), loads, measure, parse_fixed(fixed))
    print_stages(out, reduction)
    return StiffnessModel.of(reduction)


def _identified(robot: str, model_file: Path, loads: str | None, measure: str | None) -> StiffnessModel:
    from symstiff.calibration.soundness import usable_model

    model, given = usable_model(model_file), load(robot)
    if model.robot.name != given.name:
        raise UserError(f"{model_file} is a model of {model.robot.name}, not of {given.name}")
    apart = _apart(model.robot, given)
    if apart > _SAME:
        raise UserError(
            f"{model_file} was made with another geometry than {robot}: their tool centre points are up to "
            f"{1e3 * apart:.3g} mm apart; give the robot file it was made with, or identify again"
        )
    for key, wanted, has in (("loads", loads, model.loads), ("measure", measure, model.measure)):
        if wanted is not None and wanted != has:
            raise UserError(
                f"{model_file} was reduced for {key} {has}: leave out --{key} {wanted}, or identify again"
            )
    return model


def _apart(one: Robot, other: Robot) -> float:
    """Greatest distance [m] between the tool centre points of two robots at a few joint angles."""
    from symstiff.symbolic.numeric import forward

    if one.dof != other.dof:
        return math.inf
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, one.dof))
    away = forward(one, q) - forward(other, q)
    turned = np.abs(away[:, :3, :3]).max() * one.reach
    return float(max(np.linalg.norm(away[:, :3, 3], axis=1).max(), turned))


def _report(out: Console, result: Generated) -> None:
    from rich.table import Table

    from symstiff.codegen.compiler import ignored

    table = Table(title="operations per call", title_justify="left")
    for column in ("function", "add", "mul", "sign changes", "sin/cos", "other"):
        table.add_column(column, justify="left" if column == "function" else "right")
    for name, c in result.manifest["operations"].items():
        table.add_row(name, *(str(c[k]) for k in ("add", "mul", "neg", "trig", "other")))
    out.print(table)
    proof = result.verification
    if proof.compiled:
        out.print(f"compiled by {proof.compiler} without a warning, self-test passed")
    elif "c" in result.manifest["options"]["targets"].split(","):
        why = proof.reason or "not wanted"
        out.print(f"not compiled: {why} (pip install symstiff[compiler] brings a compiler)")
    if proof.max_relative_error is not None:
        out.print(f"greatest relative error against 50-digit values: {proof.max_relative_error:.1e}")
    if ignored():
        note(out, f"$CC is {ignored()!r}, which is no command here: it was not used")
    if result.left_out:
        note(out, f"without {', '.join(result.left_out)}: no law of the robot that a controller evaluates")
    out.print(f"wrote {result.folder}")


def run_footprint(robot: str, loads: str, measure: str, json: str | None) -> None:
    """Measure all variants of precision and layout on every machine that the tools at hand can show."""
    from symstiff.codegen.footprint import markdown, variants
    from symstiff.codegen.functions import Functions
    from symstiff.model import StiffnessModel
    from symstiff.reduction import reduce

    check_targets({"--json": json}, [robot])
    out = console(json)
    with stages(out) as progress:
        progress("compiling and measuring")
        measured = variants(Functions(StiffnessModel.of(reduce(load(robot), loads, measure))))
    if not measured:
        raise UserError(
            "no compiler or emulator was found: install gcc, and arm-none-eabi-gcc with QEMU for boards"
        )
    out.print(markdown(measured), markup=False, soft_wrap=True)
    write_json(json, measured)
