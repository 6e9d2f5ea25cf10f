"""``python -m tests.blind.again --n 24``: a second campaign, whose start model has the hidden effect in an old shape.

One effect is hidden as in the blind benchmark, and the model to start from has it already, in a shape drawn from those
that the catalogue tries. That is right which names the effect anew, or finds that the old shape will do; any other name
stands for what is there already.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.problem import key_of
from symstiff.discrepancy.search.verdict import AMBIGUOUS, NAMED, NOTHING
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.threads import one_thread
from tests.blind.generate import Case, Options, case

ANEW, AS_IT_IS, OTHER, OPEN = "named anew", "as it is", "another name", "no name"


def old_shape(hidden: Case, seed: int) -> EffectInstance | None:
    """The hidden effect in a shape of the catalogue; None where that has one alone."""
    ((effect, where),) = hidden.label.truth
    known = {c.key: c for c in assemble(hidden.model, hidden.table).candidates if not c.unavailable}
    candidate = known.get(key_of(effect, where))
    if candidate is None or len(candidate.simplest) < 2:
        return None
    rng = np.random.default_rng([seed, hidden.label.number])
    shape = candidate.simplest[int(rng.integers(len(candidate.simplest)))]
    return EffectInstance(effect, dict(where), dict(shape))


def judged(finding: Finding, old: EffectInstance) -> str:
    """What the diagnosis makes of it."""
    if finding.verdict == NOTHING:
        return AS_IT_IS
    if finding.verdict not in (NAMED, AMBIGUOUS):
        return OPEN
    return (
        ANEW
        if [key_of(e.effect, e.where) for e in finding.named] == [key_of(old.effect, old.where)]
        else OTHER
    )


def one(number: int, options: Options) -> tuple[str, str] | None:
    """A case in a line, and what became of it; None where the effect has one shape alone."""
    with one_thread():
        hidden = case(number, options)
        if not hidden.label.truth or hidden.label.truth[0][0] in {e.effect for e in hidden.model.effects}:
            return None
        old = old_shape(hidden, options.seed)
        if old is None:
            return None
        finding = diagnose(Task(hidden.model.robot, hidden.table, hidden.model.with_effect(old)))
    what = judged(finding, old)
    names = " + ".join(f"{e.effect}@{dict(e.where)} {dict(e.shape)}" for e in finding.named)
    told = f"{number:4d} {hidden.label.robot[:8]:8s} {what:12s} {finding.verdict:18s}"
    return f"{told} {old.effect}@{dict(old.where)} {dict(old.shape)} -> {names}", what


def several(count: int, options: Options, jobs: int) -> Iterator[tuple[str, str]]:
    """The first cases whose effect has several shapes."""
    number = 0
    with ProcessPoolExecutor(jobs) as pool:
        while count:
            found = pool.map(partial(one, options=options), range(number, number + 2 * jobs))
            for row in [row for row in found if row is not None][:count]:
                count -= 1
                yield row
            number += 2 * jobs


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.blind.again", description=__doc__)
    parser.add_argument("--n", type=int, default=24, help="number of cases")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--seed", type=int, default=4, help="another seed draws other cases")
    parser.add_argument(
        "--size", type=float, nargs="+", default=[150.0], metavar="λ", help="sizes of the effects"
    )
    given = parser.parse_args()
    options = Options(classes=("one",), shares=(1.0,), lambdas=tuple(given.size), seed=given.seed)
    became = Counter[str]()
    for line, what in several(given.n, options, given.jobs):
        print(line, flush=True)
        became[what] += 1
    print("\n" + ", ".join(f"{became[what]} {what}" for what in (ANEW, AS_IT_IS, OTHER, OPEN)))


if __name__ == "__main__":
    main()
