"""What would stand in the place of a named effect: how nearly it fits, and by how many parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from symstiff.discrepancy.findings.result import Instead, Name
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.scan import Scan, explained, extend, log_likelihood


def instead(scan: Scan, entries: Sequence[int], place: int, others: Sequence[int]) -> tuple[Instead, ...]:
    """Other candidates in the place of a set's entry, its other entries in the model, each at its best shape."""
    if not others:
        return ()
    rest = extend(scan, tuple(e for k, e in enumerate(entries) if k != place))
    found, own = evidence(rest), int(entries[place])
    best = [own, *(int(found.best_entry[c]) for c in others)]
    rss = np.array([layer.rss for layer in rest.layers])[:, None]
    fit = np.max(log_likelihood(rest, rss - explained(rest)[:, best]), axis=0)
    rank = rest.best.bases.rank[best]
    score = found.score[[int(rest.bank.owner[own]), *others]]
    return tuple(
        Instead(
            _name(rest, c), float(score[0] - score[k]), float(fit[0] - fit[k]), int(rank[0]), int(rank[k])
        )
        for k, c in enumerate(others, 1)
    )


def _name(scan: Scan, candidate: int) -> Name:
    told = scan.bank.candidates[candidate]
    return Name(told.effect, told.where)
