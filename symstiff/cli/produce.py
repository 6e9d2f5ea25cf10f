"""The command that produces code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from symstiff.cli.output import check_targets, console, note, print_table, stages, write_json
from symstiff.cli.show import parse_fixed, print_stages
from symstiff.errors import UserError
from symstiff.files import CODE
from symstiff.robot import load

if TYPE_CHECKING:
    from rich.console import Console

    from symstiff.codegen.generate import Generated
    from symstiff.model import StiffnessModel


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
    from symstiff.calibration.doubts.soundness import of_tool
    from symstiff.codegen.generate import generate
    from symstiff.codegen.options import Options
    from symstiff.model import StiffnessModel
    from symstiff.reduction import reduce

    options = Options(precision, layout, targets)
    if model_file is not None and fixed:
        raise UserError("--fixed has no effect with --model, which was reduced already: leave it out")
    check_targets({"--json": json}, [p for p in (robot, model_file) if p is not None], output, CODE)
    out = console(json)
    reduction = None
    with stages(out) as progress:
        progress("deriving and reducing")
        if model_file is None:
            reduction = reduce(load(robot), loads or "wrench", measure or "pose", parse_fixed(fixed))
            model = StiffnessModel.of(reduction)
        else:
            model = _identified(robot, model_file, loads, measure)
        result = generate(model, output, options, compile_c=compile_c, footprint=compile_c, progress=progress)
    write_json(json, result.manifest)  # before a word is said: a closed pipe ends the command
    if reduction is not None:
        print_stages(out, reduction)
    for remark in of_tool(model):
        note(out, remark)
    if not any(model.values.values()):
        note(
            out,
            "all parameters are zero, so that this code corrects nothing by itself: give an identified --model, or set "
            "them in the controller",
        )
    _report(out, result)


def _identified(robot: str, model_file: Path, loads: str | None, measure: str | None) -> StiffnessModel:
    from symstiff.calibration.doubts.soundness import check_same_robot
    from symstiff.model import load_model

    model = load_model(model_file)
    check_same_robot(model, load(robot), str(model_file))
    for key, wanted, has in (("loads", loads, model.loads), ("measure", measure, model.measure)):
        if wanted is not None and wanted != has:
            raise UserError(
                f"{model_file} was reduced for {key} {has}: leave out --{key} {wanted}, or identify again"
            )
    return model


def _report(out: Console, result: Generated) -> None:
    from rich.table import Table

    from symstiff.codegen.compiler import ignored
    from symstiff.effects.places import named

    table = Table(title="operations per call", title_justify="left")
    for column in ("function", "add", "mul", "sign changes", "sin/cos", "other"):
        table.add_column(column, justify="left" if column == "function" else "right")
    for name, c in result.manifest["operations"].items():
        table.add_row(name, *(str(c[k]) for k in ("add", "mul", "neg", "trig", "other")))
    print_table(out, table)
    proof = result.verification
    if proof.compiled:
        out.print(f"compiled by {proof.compiler} without a warning, self-test passed")
    elif "c" in result.manifest["options"]["targets"].split(","):
        advice = f"{proof.reason} (pip install symstiff[compiler] brings a compiler)"
        out.print(f"not compiled: {advice if proof.reason else 'not wanted'}")
    if proof.max_relative_error is not None:
        out.print(f"greatest relative error against 50-digit values: {proof.max_relative_error:.1e}")
    if ignored():
        note(out, f"$CC is {ignored()!r}, which is no command here: it was not used")
    if result.left_out:
        without = ", ".join(named(e.effect, e.where) for e in result.left_out)
        note(out, f"without {without}: no law of joints or links, which a controller evaluates")
    out.print(f"wrote {result.folder}")


def run_footprint(robot: str, loads: str, measure: str, json: str | None) -> None:
    """Measure all variants of precision and layout on every machine that the tools at hand can show."""
    from symstiff.codegen.footprint import markdown, unmeasured, variants
    from symstiff.codegen.functions import Functions
    from symstiff.model import StiffnessModel
    from symstiff.reduction import reduce

    check_targets({"--json": json}, [robot])
    out = console(json)
    with stages(out) as progress:
        progress("compiling and measuring")
        measured = variants(Functions(StiffnessModel.of(reduce(load(robot), loads, measure))))
    if not any(measured.values()):
        raise UserError(
            "no compiler or emulator was found: install gcc, and arm-none-eabi-gcc with QEMU for boards"
        )
    write_json(json, measured)
    out.print(markdown(measured), markup=False, soft_wrap=True)
    if lacking := unmeasured(measured):
        note(
            out,
            f"not measured, for want of a tool: {', '.join(lacking)}; arm-none-eabi-gcc and QEMU show the boards",
        )
