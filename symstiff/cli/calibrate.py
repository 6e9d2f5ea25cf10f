"""Commands before and after a calibration: simulate, compensate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from symstiff.cli.output import check_targets, console, note, stages, write_json
from symstiff.display import counted, few
from symstiff.errors import UserError

if TYPE_CHECKING:
    from symstiff.calibration.tables.measurements import Measurements
    from symstiff.compensation import Compensated
    from symstiff.model import StiffnessModel

LEAST_NOISE = 1e-9
"""Noise [mm] below which no device reads."""

_NO_ERROR = 1e-12  # m: rounding of an arm that nothing bends
_TOUCH = 1e-9  # rad, m: a command at a limit, read from a file, may miss it by rounding
_AROUND = "lower the load, or lead the path around the singularity"
_KEPT = {
    "singular": f"singular: {_AROUND}",
    "too_far": f"a joint would have to move by more than 0.25 rad or m, as beside a singular pose: {_AROUND}",
    "not_converged": f"the steps towards a solution did not converge, as beside a singular pose: {_AROUND}",
    "no_gain": "the error would grow: lower the load",
}
"""Why `compensate` leaves a command as it is."""


def run_simulate(
    truth_file: Path, poses: Path, output: Path, noise: float | None, seed: int, json: str | None = None
) -> None:
    """Run a virtual experiment."""
    from dataclasses import replace

    from symstiff.calibration.simulation import load_truth, simulate
    from symstiff.calibration.tables.checks import check_robot
    from symstiff.calibration.tables.measurements import COMPONENTS
    from symstiff.calibration.tables.table import read_poses, write_table

    if noise is not None and noise != 0 and not LEAST_NOISE <= noise < 100:
        raise UserError(
            f"--noise {noise:g}: a standard deviation in millimetres, 0 or {LEAST_NOISE:g} to 100"
        )
    targets = {"-o": output, "--json": json}
    check_targets(targets, [truth_file, poses])
    out = console(json)
    with stages(out) as progress:
        progress("reading the poses")
        truth, design = load_truth(truth_file), read_poses(poses)
        check_targets(targets, [] if truth.robot_file is None else [truth.robot_file])
        if not design.w.any() and (truth.kind or design.kind) != "absolute":
            raise UserError(
                f"{design.place(0)}: every wrench is zero: give the poses loads (fx[N] …), or measure absolute "
                "positions"
            )
        if noise is not None:
            truth = replace(truth, noise=replace(truth.noise, sigma_mm=(noise,) * 3))
        warned = check_robot(design, truth.robot)
        progress("finding equilibria")
        table = simulate(truth, design, seed)
        write_table(table, output)
    seen = [c for k, c in enumerate(COMPONENTS) if table.measured[:, k].any()]
    write_json(
        json,
        {
            "robot": truth.robot.name, "kind": table.kind, "components": seen, "points": list(table.points),
            "poses": len(set(table.pose.tolist())), "rows": len(table), "seed": seed, "file": str(output),
        },
    )  # fmt: skip
    for warning in warned:
        note(out, warning)
    if truth.components == "position" and len(table.points) < 3:
        told = 'rotations too need components = "pose" below [measure] in the truth'
        note(out, f"positions of {', '.join(table.points)}; {told}", "measured")
    out.print(f"wrote {output}")


def run_compensate(model_file: Path, trajectory: Path, output: Path, json: str | None) -> None:
    """Correct a trajectory."""
    from symstiff.calibration.doubts.soundness import check_bends, of_levers, of_tool
    from symstiff.calibration.remarks import of_sag
    from symstiff.calibration.rows import context_of
    from symstiff.calibration.tables.checks import check_robot
    from symstiff.calibration.tables.loading import as_loading, at_rest
    from symstiff.calibration.tables.rewriting import rewrite_joints
    from symstiff.calibration.tables.table import read_trajectory
    from symstiff.compensation import compensate
    from symstiff.effects.places import named
    from symstiff.model import load_model

    check_targets({"-o": output, "--json": json}, [model_file, trajectory])
    model = load_model(model_file)
    check_bends(model, str(model_file))
    table, cells = read_trajectory(trajectory)
    out = console(json)
    warned = check_robot(table, model.robot)
    without = [named(e.effect, e.where) for e in model.effects if e not in model.of_robot().effects]
    moment = context_of(model.of_robot(), at_rest(as_loading(table)))  # as the model's own tables were read
    with stages(out) as progress:
        progress("compensating")
        found = compensate(model, table.q, table.w, context=moment)
    before, after = found.rms
    split = rewrite_joints(cells, table, found.q_cmd, output)
    beyond = _beyond(model, found.q_cmd)
    rms_mm = {"before": 1e3 * before, "after": 1e3 * after}
    poses = len(set(table.pose.tolist()))
    write_json(json, {"poses": poses, "rows": len(table), "rms_mm": rms_mm, **_record(found, beyond, table)})
    for warning in (*warned, *found.remarks, *of_sag(model.robot), *of_tool(model)):
        note(out, warning)
    if without:
        note(out, f"without {', '.join(without)}: no law of joints or links, not compensated")
    error, left = _millimetres(before), _millimetres(after)
    rows = f" in {len(table)} rows" if poses < len(table) else ""
    out.print(
        f"{counted(poses, 'pose')}{rows}: predicted error {error} rms, after compensation {left} by the model"
    )
    unloaded = not table.w.any() and before < _NO_ERROR
    for remark in (
        *of_levers(model.robot, before), *_of_loads(unloaded, split), *_of_rows(found, beyond, table)
    ):  # fmt: skip
        note(out, remark)
    out.print(f"wrote {output}")


def _record(found: Compensated, beyond: np.ndarray, table: Measurements) -> dict[str, Any]:
    """What ``--json`` tells of rows: those that keep their command, and those (N,) whose command leaves the limits."""
    kept = [
        {"line": int(table.line[k]), "pose": table.labels[table.pose[k]], "reason": str(found.kept[k])}
        for k in np.flatnonzero(~found.solved)
    ]
    return {
        "unsolved": len(kept),
        "kept": kept,
        "beyond_limits": [int(line) for line in table.line[beyond]],
    }


def _of_loads(unloaded: bool, split: tuple[str, ...]) -> list[str]:
    """Remarks where no load bends the arm, and on poses that several loads ``split``."""
    told = []
    if unloaded:
        told.append("no loads at the tool: nothing that the model compensates; give columns fx[N] … mz[N*m]")
    if split:
        names = ", ".join(split)
        told.append(f"several loads need several commands: pose {names} became {split[0]}/1, {split[0]}/2, …")
    return told


def _of_rows(found: Compensated, beyond: np.ndarray, table: Measurements) -> list[str]:
    """Remarks on rows that keep their command, by reason, and on those (N,) whose command leaves the joint limits."""

    def lines(rows: np.ndarray) -> str:
        return (
            f"{rows.sum()} of {counted(len(table), 'row')} (line {few([str(k) for k in table.line[rows]])})"
        )

    told = [
        f"{lines(found.kept == reason)} keep their command: {words}"
        for reason, words in _KEPT.items()
        if (found.kept == reason).any()
    ]
    if beyond.any():
        told.append(f"{lines(beyond)} have a command beyond the joint limits of the robot file")
    return told


def _beyond(model: StiffnessModel, q: np.ndarray) -> np.ndarray:
    """Rows (N,) of commands (N, n) [rad, m] that leave the joint limits."""
    low, high = model.robot.ranges.T
    return np.asarray(((q < low - _TOUCH) | (q > high + _TOUCH)).any(axis=1))


def _millimetres(error: float) -> str:
    """An error [m] in words, as far as anybody would measure it."""
    return f"{1e3 * error:.3f} mm" if error >= 5e-7 else "less than 0.001 mm"
