"""How explanations share the evidence: those that give the same columns are one, under several names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from symstiff.discrepancy.search.judging import Judged
from symstiff.discrepancy.search.workshop import Proposal, Workshop
from symstiff.discrepancy.statistics.bank import Bank
from symstiff.discrepancy.statistics.scan import directions


def same_columns(found: Proposal | Judged, bank: Bank) -> frozenset[int]:
    """The members, those whose columns are the same by structure as one."""
    return frozenset(bank.twins(e)[0] for e in found.entries)


def shares(scored: Sequence[tuple[frozenset[int], float]]) -> dict[frozenset[int], float]:
    """Scores of rival sets as shares of all their evidence."""
    best: dict[frozenset[int], float] = {}
    for members, score in scored:
        best[members] = max(score, best.get(members, -np.inf))
    total = float(logsumexp(list(best.values())))
    return {members: float(np.exp(score - total)) for members, score in best.items()}


def places(found: Proposal | Judged, place: Sequence[str]) -> list[str]:
    """Virtual joints of a set's members, by those of all candidates."""
    return sorted(place[m] for m in found.members)


def other_names(shop: Workshop, judged: Judged, k: int) -> tuple[Judged, ...]:
    """The set with its k-th member under other names that give the same columns, whatever is measured.

    A joint's law and what is none are two things; names of a base that gives way, or of what weighs at the flange, are
    names of one.
    """
    bank, entry, own = judged.bank, judged.entries[k], judged.members[k]
    found = []
    for twin in bank.twins(entry):
        at_joint = ["joint" in bank.candidates[member].where for member in (own, twin)]
        if at_joint[0] == at_joint[1]:
            continue
        scan, plainest = shop.scan(()), int(bank.first_entry[twin])
        first, second = (directions(scan, scan.best, [e])[1].size for e in (entry, plainest))
        if first == second:
            members = (*judged.members[:k], twin, *judged.members[k + 1 :])
            entries = (*judged.entries[:k], plainest, *judged.entries[k + 1 :])
            found.append(replace(judged, members=members, entries=entries))
    return tuple(found)
