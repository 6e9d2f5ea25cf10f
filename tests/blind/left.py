"""``python -m tests.blind.left --n 96 --seed 461``: how much of each hidden effect its own candidate leaves.

Without noise, in units of λ. What a shape of the catalogue leaves of another shape is meant to be there; what an effect
leaves of itself is a column that does not hold.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

from symstiff.calibration.fits.decomposition import column_space
from symstiff.discrepancy.workflow import first_assembly
from tests.blind.apart import outside
from tests.blind.generate import FORCE, Case, Options, case
from tests.blind.score import same
from tests.blind.stories import ONE

_ZERO = 1e-5


def left(hidden: Case) -> Iterator[tuple[str, float, float, str]]:
    """For each hidden effect: its story, its λ, what its best shape leaves of that, and that shape."""
    assembly = first_assembly(hidden.model, hidden.table)
    groups = {c.key: c.group for c in assembly.candidates if c.group}
    space = outside(hidden, assembly)
    for story, truth, part in zip(hidden.label.story, hidden.label.truth, hidden.parts, strict=True):
        signal = space.signal(part)
        best = (float(signal @ signal), "no candidate")
        for candidate in assembly.candidates:
            if candidate.unavailable or not same((candidate.effect, candidate.where), truth, groups):
                continue
            for shape in candidate.shapes:
                own = column_space(space.left(candidate.columns(shape)), _ZERO)
                rest = signal - own @ (own.T @ signal)
                best = min(best, (float(rest @ rest), f"{candidate.key} {dict(shape)}"))
        yield story, float(signal @ signal), *best


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.blind.left", description=__doc__)
    parser.add_argument("--n", type=int, default=96, help="number of cases")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=4, help="another seed draws other cases")
    parser.add_argument("--story", choices=[s.name for s in ONE], help="single effects of this story only")
    parser.add_argument("--robot", choices=tuple(FORCE), help="on this robot only")
    given = parser.parse_args()
    options = Options(seed=given.seed)
    if given.story:
        options = replace(options, story=given.story, classes=("one",), shares=(1.0,))
    if given.robot:
        options = replace(options, robots=(given.robot,))
    shares = []
    for number in range(given.first, given.first + given.n):
        hidden = case(number, options)
        if len(hidden.parts) != len(hidden.label.truth):
            continue
        for story, lam, rest, shape in left(hidden):
            told = f"{number:4d} {hidden.label.robot:13s} {story:22s}"
            shares.append(100 * rest / max(lam, 1e-12))
            print(f"{told} λ {lam:7.1f} left {rest:7.2f} ({shares[-1]:4.1f} %) {shape}")
    if shares:
        print(
            f"{len(shares)} effects: {sum(shares) / len(shares):.2f} % left on average, {max(shares):.1f} % at most"
        )


if __name__ == "__main__":
    main()
