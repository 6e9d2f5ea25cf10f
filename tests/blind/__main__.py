"""``python -m tests.blind --n 200 --jobs 2``: the blind benchmark at full size."""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")  # before NumPy: a process a case, one thread each


def main() -> None:
    from tests.blind.generate import CLASSES, Options
    from tests.blind.run import benchmark, keep, report
    from tests.blind.stories import ONE, RARE

    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    parser.add_argument("--n", type=int, default=200, help="number of cases")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--seed", type=int, default=4, help="another seed draws other cases")
    parser.add_argument("--kind", choices=CLASSES, help="only cases of one class")
    parser.add_argument(
        "--size", type=float, nargs="+", metavar="λ", help="only effects of these sizes, such as 25 60"
    )
    parser.add_argument(
        "--mild", action="store_true", help="robots repeat well and weigh what their files tell"
    )
    parser.add_argument(
        "--off", type=float, default=0.0, metavar="MM",
        help="absolute positions of arms whose frames are all off by so much, mm and mrad",
    )  # fmt: skip
    parser.add_argument(
        "--settling", type=float, default=0.0, metavar="X",
        help="a joint stops elsewhere at every reading, by so much of the noise at the tool",
    )  # fmt: skip
    parser.add_argument(
        "--story", choices=[s.name for s in (*ONE, *RARE)], help="single effects of this story only"
    )
    parser.add_argument(
        "--waves", action="store_true", help="pairs alone: waves of two numbers a turn in one gear"
    )
    parser.add_argument("--robot", nargs="+", metavar="NAME", help="only these robots")
    for name in ("poses", "levels", "markers"):
        parser.add_argument(
            f"--{name}", type=int, nargs="+", metavar="N", help=f"only designs of so many {name}"
        )
    parser.add_argument("--alone", action="store_true", help="leave out BIC, AIC, lasso and cross-validation")
    parser.add_argument("--json", type=Path, help="keep cases and results")
    parser.add_argument("--pool", type=Path, nargs="+", help="no new cases: the table of results kept before")
    given = parser.parse_args()
    if given.pool:
        print(report([row for path in given.pool for row in json.loads(path.read_text())["cases"]]))
        return
    options = Options(seed=given.seed, mild=given.mild, off=1e-3 * given.off, settling=given.settling)
    if given.off:
        options = replace(options, classes=("nothing", "one", "two"), shares=(0.2, 0.5, 0.3))
    if given.kind:
        options = replace(options, classes=(given.kind,), shares=(1.0,))
    if given.story:
        options = replace(options, classes=("one",), shares=(1.0,), story=given.story)
    if given.waves:
        options = replace(options, classes=("two",), shares=(1.0,), waves=True)
    if given.size:
        options = replace(options, lambdas=tuple(given.size))
    drawn = {"robots": given.robot, "poses": given.poses, "levels": given.levels, "markers": given.markers}
    options = replace(options, **{name: tuple(of) for name, of in drawn.items() if of})
    numbers = range(given.first, given.first + given.n)
    rows = benchmark(numbers, options, given.jobs, not given.alone, lambda text: print(text, flush=True))
    print("\n" + report(rows))
    if given.json:
        keep(rows, given.json)


if __name__ == "__main__":
    main()
