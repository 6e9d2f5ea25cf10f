"""How the work grows with the number of joints: snake robots of 2 to 30 joints, axes alternating.

python -m tests.benchmarks.bench_growth [-o docs/growth.svg] [--joints 2 4 … 30] [--json FILE]

Seconds of processor time, best of two, imports left out: exact reduction for any wrench and measured pose; derivation
of the five programs; emission of every C file, its 50-digit test vectors included, and of the CasADi functions.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.targets import TARGETS
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import Robot
from symstiff.robot.loading import from_table

JOINTS = tuple(range(2, 31, 2))


@dataclass(frozen=True)
class Growth:
    """Seconds of every step for one robot, and what it led to."""

    joints: int
    full: int
    kept: int
    operations: int
    reduction: float
    derivation: float
    emission: float

    @property
    def total(self) -> float:
        """All steps."""
        return self.reduction + self.derivation + self.emission


def snake(n: int) -> Robot:
    """n revolute joints, twists of ±90° in turn, links of 100 mm that bend as beams."""
    joint = {"a": "0.1", "d": 0, "limits": [-2.0, 2.0], "link": {"beam_axis": "x"}}
    joints = [joint | {"alpha": "pi/2" if i % 2 == 0 else "-pi/2"} for i in range(n)]
    table = {"format": 1, "name": f"snake{n}", "joint": joints, "tool": {"xyz": ["0.05", 0, 0]}}
    return from_table(table, f"snake of {n} joints")


def grown(n: int) -> Growth:
    """One robot, from its table to the text of its sources; nothing is compiled."""
    robot = snake(n)
    reduction, reducing = _timed(lambda: reduce(robot))
    functions = Functions(StiffnessModel.of(reduction))
    _, deriving = _timed(lambda: functions.all)
    _, emitting = _timed(lambda: [TARGETS[t].emitter()(functions, Options()) for t in ("c", "casadi")])
    deflection = functions.operations["deflection"]
    count = sum(deflection[kind] for kind in ("add", "mul", "neg"))
    return Growth(n, len(reduction.full), len(reduction.kept), count, reducing, deriving, emitting)


def _timed(step: Callable[[], Any]) -> tuple[Any, float]:
    start = time.process_time()
    result = step()
    return result, time.process_time() - start


def measured(joints: Sequence[int] = JOINTS, repeat: int = 2) -> list[Growth]:
    """The fastest of several runs for every number of joints; the first robot is run once more beforehand."""
    grown(min(joints))  # first use pays for imports
    return [min((grown(n) for _ in range(repeat)), key=lambda g: g.total) for n in joints]


def table(found: Sequence[Growth]) -> str:
    """One row a robot."""
    lines = ["joints  π′ full  π″ kept  deflection ops  reduction s  derivation s  emission s  total s"]
    lines += [
        f"{g.joints:6d}  {g.full:7d}  {g.kept:7d}  {g.operations:14d}  {g.reduction:11.2f}  {g.derivation:12.2f}"
        f"  {g.emission:10.2f}  {g.total:7.2f}"
        for g in found
    ]
    return "\n".join(lines)


def plot(found: Sequence[Growth], target: Path) -> None:
    """Stacked seconds over the number of joints; the same figures give the same bytes."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    style = {"svg.hashsalt": "symstiff", "svg.fonttype": "path", "font.size": 9}
    with matplotlib.rc_context(style):
        figure, axis = pyplot.subplots(figsize=(6.0, 3.4), layout="constrained")
        steps = ("reduction", "derivation", "emission")
        names = ("exact reduction", "derivation of all programs", "emission of C and CasADi")
        series = [[getattr(g, step) for g in found] for step in steps]
        axis.stackplot(
            [g.joints for g in found], series, labels=names, colors=("#4477aa", "#88ccee", "#ddcc77")
        )
        axis.set_xlabel("joints")
        axis.set_ylabel("processor time [s]")
        axis.set_xlim(found[0].joints, found[-1].joints)
        axis.set_ylim(0, None)
        axis.grid(alpha=0.3)
        axis.legend(loc="upper left", frameon=False)
        axis.set_title("Snake robots, from the DH table to emitted code")
        metadata: dict[str, Any] = {"Date": None} if target.suffix == ".svg" else {"Software": None}
        figure.savefig(target, metadata=metadata, dpi=150)
        pyplot.close(figure)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, metavar="PICTURE", help="write the plot (.svg or .png)")
    parser.add_argument("--joints", type=int, nargs="+", default=JOINTS)
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    found = measured(arguments.joints)
    print(table(found))
    if arguments.output:
        plot(found, arguments.output)
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(g) for g in found], indent=2) + "\n")


if __name__ == "__main__":
    main()
