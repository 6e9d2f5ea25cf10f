"""This project's C code against other engines on the same task, in one run: same inputs, same compiler flags.

python -m tests.benchmarks.bench_peers [--robot kuka_kr270] [--repeat N] [--json FILE]

Every competitor is held against the first before anything is timed. Derivation is processor time from the formula to
source text, imports left out. Operations are read from the engines' own lists, inputs and outputs left out.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import tempfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.benchmarks.case import Case
from tests.benchmarks.harness import FLAGS, build
from tests.benchmarks.peers import peers

AGREEMENT = 1e-10


@dataclass(frozen=True)
class Line:
    """One competitor's figures; zero where a figure does not apply. ``error``: relative, against symstiff."""

    name: str
    quantity: str
    derivation: float
    operations: dict[str, int]
    least_ns: float
    median_ns: float
    code: int
    stack: int
    instructions: int
    error: float
    note: str = ""

    @property
    def total(self) -> int:
        """Operations but for sines and cosines."""
        return sum(n for kind, n in self.operations.items() if kind != "trig")


@dataclass(frozen=True)
class Result:
    """All lines, ns of the sines and cosines alone, and the engines that were not installed."""

    robot: str
    parameters: int
    trig_ns: float
    lines: tuple[Line, ...]
    missing: tuple[str, ...] = ()
    targets: dict[str, dict[str, Any]] = field(default_factory=dict)

    def of(self, quantity: str) -> list[Line]:
        """The lines of one quantity."""
        return [line for line in self.lines if line.quantity == quantity]


def run(robot: str = "kuka_kr270", repeat: int = 2000) -> Result:
    """Derive, compile, verify, measure."""
    case = Case.of(robot)
    competitors, missing = peers(case)
    with tempfile.TemporaryDirectory() as scratch:
        built = build(case, competitors, Path(scratch))
        outputs = built.outputs()
        reference = {p.quantity: y for p, y in reversed(list(zip(competitors, outputs, strict=True)))}
        errors = [error(y, reference[p.quantity]) for p, y in zip(competitors, outputs, strict=True)]
        for peer, e in zip(competitors, errors, strict=True):
            if not e < AGREEMENT:
                raise RuntimeError(f"{peer.name}, {peer.quantity}: differs from symstiff by {e:.1e}")
        figures, trig = built.measured(repeat)
    lines = [
        Line(
            p.name,
            p.quantity,
            p.derivation,
            p.operations,
            m.least,
            m.median,
            m.code,
            m.stack,
            m.instructions,
            e,
            p.note,
        )
        for p, m, e in zip(competitors, figures, errors, strict=True)
    ]
    if importlib.util.find_spec("pinocchio") is None:
        missing.append("pinocchio")
    else:
        lines += _pinocchio(case, reference, max(3, repeat // 100))
    result = Result(robot, len(case.entries), trig, tuple(lines), tuple(missing))
    return Result(robot, len(case.entries), trig, tuple(lines), tuple(missing), targets(result))


def error(values: np.ndarray, reference: np.ndarray) -> float:
    """Greatest difference over the greatest value, translations and rotations (and columns) each by themselves."""
    parts = [
        np.abs(x[:, rows] - r[:, rows])
        for rows in (slice(0, 3), slice(3, 6))
        for x, r in [(values, reference)]
    ]
    sizes = [np.abs(reference[:, rows]).max(axis=(0, 1)) for rows in (slice(0, 3), slice(3, 6))]
    worst = [p.max(axis=(0, 1)) / np.where(s > 0, s, 1.0) for p, s in zip(parts, sizes, strict=True)]
    return float(np.max(worst))  # NaN where any value is


def _pinocchio(case: Case, reference: dict[str, np.ndarray], repeat: int) -> list[Line]:
    from tests.benchmarks.pinocchio_peer import functions, timed

    found, n = [], case.dof
    for quantity, function in zip(("deflection", "observation"), functions(case), strict=True):
        values = np.array([function(row[:n], row[n:]) for row in case.inputs])
        e = error(values, reference[quantity])
        if not e < AGREEMENT:
            raise RuntimeError(f"Pinocchio + NumPy, {quantity}: differs from symstiff by {e:.1e}")
        least = timed(function, case, repeat)
        found.append(
            Line("Pinocchio + NumPy", quantity, 0.0, {}, least, 0.0, 0, 0, 0, e, "called from Python")
        )
    return found


def targets(result: Result) -> dict[str, dict[str, Any]]:
    """The promises: ratio of the peers' time (and instructions) to ours, and whether it suffices."""
    ours = {q: result.of(q)[0] for q in ("deflection", "observation")}
    wanted = {"CasADi A·π + cse": 2.0, "CasADi ΣJ·k·JᵀW + cse": 1.4}
    found = {}
    for line in result.of("deflection"):
        if line.name in wanted:
            found[f"deflection against {line.name}"] = _ratio(line, ours["deflection"], wanted[line.name])
    peers_ = [x for x in result.of("observation") if not x.name.startswith("symstiff")]
    if peers_:
        best = min(peers_, key=lambda x: x.least_ns)
        found[f"observation against the best peer, {best.name}"] = _ratio(best, ours["observation"], 1.0)
    return found


def _ratio(peer: Line, own: Line, wanted: float) -> dict[str, Any]:
    ratio = peer.least_ns / own.least_ns
    instructions = peer.instructions / own.instructions if own.instructions else 0.0
    return {"wanted": wanted, "time": ratio, "instructions": instructions, "met": bool(ratio >= wanted)}


def table(result: Result) -> str:
    """Both quantities as tables, then the promises."""
    engines = (
        f"{result.robot}: {result.parameters} parameters; gcc and g++ {' '.join(FLAGS)}; least of all repeats"
    )
    text = [engines, f"sines and cosines alone: {result.trig_ns:.0f} ns"]
    head = (
        "",
        "derive s",
        "add",
        "mul",
        "neg",
        "sum",
        "sin/cos",
        "ns",
        "ratio",
        "instr.",
        "ratio",
        "code B",
        "stack B",
    )
    for quantity in ("deflection", "observation"):
        own = result.of(quantity)[0]
        rows = [head] + [_cells(x, own) for x in result.of(quantity)]
        widths = [max(len(r[c]) for r in rows) for c in range(len(head))]
        text += ["", quantity]
        text += [
            "  ".join(
                x.ljust(w) if c == 0 else x.rjust(w) for c, (x, w) in enumerate(zip(r, widths, strict=True))
            )
            for r in rows
        ]
    text.append("")
    for name, t in result.targets.items():
        verdict = "met" if t["met"] else "MISSED"
        text.append(
            f"{name}: {t['time']:.2f} × (instructions {t['instructions']:.2f} ×), wanted {t['wanted']}: {verdict}"
        )
    text += [f"not installed, left out: {name}" for name in result.missing]
    return "\n".join(text)


def _cells(line: Line, own: Line) -> tuple[str, ...]:
    counts = [str(line.operations.get(kind, "–")) for kind in ("add", "mul", "neg")]
    known = bool(line.operations)
    return (
        line.name,
        f"{line.derivation:.3f}" if known else "–",
        *counts,
        str(line.total) if known else "–",
        str(line.operations.get("trig", "–")),
        f"{line.least_ns:.0f}",
        f"{line.least_ns / own.least_ns:.2f}",
        str(line.instructions or "–"),
        f"{line.instructions / own.instructions:.2f}" if line.instructions and own.instructions else "–",
        str(line.code or "–"),
        str(line.stack or "–"),
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robot", default="kuka_kr270")
    parser.add_argument("--repeat", type=int, default=2000)
    parser.add_argument("--json", metavar="FILE")
    arguments = parser.parse_args()
    result = run(arguments.robot, arguments.repeat)
    print(table(result))
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(asdict(result), indent=2, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
