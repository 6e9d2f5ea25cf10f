"""Which candidates these data can test: something of them is left outside the model, and it says something."""

from __future__ import annotations

import numpy as np

from symstiff.arrays import TINY, Array, numbered
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.statistics.design import effective_rank, least_sizes, share_left
from symstiff.discrepancy.statistics.prepare import Prepared
from symstiff.discrepancy.statistics.scan import Scan
from symstiff.discrepancy.statistics.strata import SEVERAL, fills

_USUAL = 0.4
"""Share of what the model leaves in a stratum beyond which the directions of usual sizes alone fill it."""
_HELD = 1e-8
"""Share of a column's squared length outside the model that is rounding."""
_TIMES = 3.0
"""Physical ranges up to which a size is worth a test: ranges are those of usual robots."""
_BENT = 0.01
"""Share of a signal's square that may depart from the load's course in what is proportional to it."""


def testable(problem: Problem, ready: Prepared) -> Array:
    """Mask (candidates,) of those of which something is left outside the model and visible at a believable size."""
    scan, bank = ready.scan, ready.bank
    sigma2 = scan.best.rss / max(scan.freedom, 1)
    mask = np.ones(len(bank.candidates), bool)
    for c, (a, b) in enumerate(zip(bank.first_entry, bank.last_entry, strict=True)):
        entries = range(int(a), int(b))
        if all(_absorbed(scan, e) for e in entries):
            mask[c] = False
            continue
        if bank.generic[c]:
            continue
        if fills_its_stratum(problem, ready, int(a)):
            mask[c] = False
            continue
        mask[c] = any(_believable(ready, e, sigma2) for e in entries)
    return mask


def why_untestable(problem: Problem, ready: Prepared, entry: int) -> str:
    """Why these data do not test a candidate of which this is an entry."""
    if _absorbed(ready.scan, entry):
        return "the model absorbs it wholly"
    if fills_its_stratum(problem, ready, entry):
        return "beside the model it would fit anything proportional to the load: more poses would tell"
    return "a believable size is below what would be seen"


def plainly_absorbed(ready: Prepared, candidate: int) -> bool:
    """Whether the model holds all of a candidate that has no shape, and not of one that has."""
    own = [int(e) for e in np.flatnonzero(ready.bank.owner == candidate)]
    plain = [e for e in own if not ready.bank.shape_of(e)]
    return any(_absorbed(ready.scan, e) for e in plain) and not all(_absorbed(ready.scan, e) for e in own)


def telling(ready: Prepared, candidate: int, likeliest: int) -> int:
    """The entry of a candidate whose smallest size is told: the likeliest, or one that is seen at a believable size.

    A gap that the loads do not cross in the likeliest shape would have to be larger than any robot.
    """
    sigma2 = ready.scan.best.rss / max(ready.scan.freedom, 1)
    own = np.flatnonzero(ready.bank.owner == candidate)
    order = [likeliest, *(int(e) for e in own)]
    return next((e for e in order if _believable(ready, e, sigma2)), likeliest)


def _absorbed(scan: Scan, entry: int) -> bool:
    """Whether the model holds all of an entry's columns."""
    return share_left(scan, entry) < _HELD or scan.best.bases.rank[entry] == 0


def _believable(ready: Prepared, entry: int, sigma2: float) -> bool:
    """Would some parameter be seen at a size of up to ``_TIMES`` its physical range?"""
    parameters = ready.bank.parameters(entry)
    bound = np.array([max(abs(p.low), abs(p.high)) for p in parameters])
    if len(bound) != ready.bank.width[entry] or not np.all(np.isfinite(bound)):
        return True
    return bool(np.any(least_sizes(ready.scan, entry, sigma2) < _TIMES * bound))


def fills_its_stratum(problem: Problem, ready: Prepared, entry: int) -> bool:
    """Would a candidate that is proportional to the load take so much of what is left there that it fits anything?

    The stratum "proportional to load, by pose" has one degree of freedom for each pose and channel, less the model. A
    candidate fills it by the directions in which its parameters usually have a share, or by all, unless the usual ones
    leave several.
    """
    full = float(ready.scan.best.bases.rank[entry])
    usual = effective_rank(ready.scan, entry)
    label = numbered(problem.pose, problem.channel)
    left = int(label.max()) + 1 - (problem.rows - ready.scan.freedom)
    if not fills(full, left, usual) and (usual < SEVERAL or usual <= _USUAL * left):
        return False
    load = np.ones(problem.rows) if problem.load is None else problem.load
    columns = ready.bank.columns[:, ready.bank.slice(entry)]
    total = np.maximum(np.bincount(label, load**2), TINY)
    slope = np.column_stack([np.bincount(label, load * c) / total for c in columns.T])
    return bool(np.sum((columns - slope[label] * load[:, None]) ** 2) < _BENT * np.sum(columns**2))
