"""Proposals of sets of effects, and what is computed once for all of them: scans, evidence, null distributions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from symstiff.arrays import Array
from symstiff.discrepancy.problem import Options
from symstiff.discrepancy.statistics.evidence import Evidence, Own, evidence
from symstiff.discrepancy.statistics.null import Null, null
from symstiff.discrepancy.statistics.scan import Scan, alone, extend
from symstiff.discrepancy.statistics.strata import Stratum

_SCANS = 8
"""Scans that a search keeps at most."""


@dataclass(frozen=True)
class Proposal:
    """A set of candidates, each at one shape, not yet added to the model."""

    members: tuple[int, ...]
    entries: tuple[int, ...]
    score: float
    """Log evidence with the prior."""
    lost: float = 0.0
    """What the physical range of its sizes has taken from that."""


@dataclass
class Workshop:
    """The start, the options, and scans and null distributions already made (a cache, nothing else)."""

    start: Scan
    allowed: Array
    options: Options
    lack: Callable[[Scan], Sequence[Stratum]] = lambda scan: ()
    """Lack of fit by strata with some entries in the model."""
    parts: Sequence[Stratum] = ()
    """The same for the start."""
    scans: dict[tuple[int, ...], Scan] = field(default_factory=dict)
    found: dict[tuple[int, ...], Evidence] = field(default_factory=dict)
    parts_of: dict[int, Scan] = field(default_factory=dict)
    nulls: dict[tuple[tuple[int, ...], tuple[int, ...]], Null] = field(default_factory=dict)

    def scan(self, entries: tuple[int, ...]) -> Scan:
        """The scan with some entries in the model; the latest are kept."""
        key = tuple(sorted(entries))
        if key not in self.scans:
            if len(self.scans) >= _SCANS:
                del self.scans[next(iter(self.scans))]
            self.scans[key] = extend(self.start, key)
        return self.scans[key]

    def evidence(self, entries: tuple[int, ...]) -> Evidence:
        """The evidence of everything else with some entries in the model."""
        key = tuple(sorted(entries))
        if key not in self.found:
            self.found[key] = evidence(self.scan(key))
        return self.found[key]

    def own(self, candidate: int, entries: tuple[int, ...]) -> Own:
        """The evidence of one candidate with some entries in the model; that of all others only where it is known."""
        key, rows = tuple(sorted(entries)), self.start.bank.entries_of(candidate)
        if key in self.found:
            known = self.found[key]
            shapes, score, best = known.entry[rows], known.score[candidate], known.best_entry[candidate]
            return Own(rows.start, shapes, float(score), int(best))
        if candidate not in self.parts_of:
            self.parts_of[candidate] = alone(self.start, candidate)
        known = evidence(extend(self.start, key, self.parts_of[candidate]))
        return Own(rows.start, known.entry, float(known.score[0]), rows.start + int(known.best_entry[0]))

    def null(self, members: tuple[int, ...], entries: tuple[int, ...]) -> Null:
        """Null distribution of the maximum over all candidates that are not in the set."""
        key = (tuple(sorted(members)), tuple(sorted(entries)))
        if key not in self.nulls:
            draws = self.options.draws * (1 if members else 2)
            self.nulls[key] = null(self.scan(entries), draws, self.options.seed, self.free(members))
        return self.nulls[key]

    def free(self, members: tuple[int, ...]) -> Array:
        """Mask (candidates,) of those that may still be added."""
        free = np.array(self.allowed, dtype=bool)
        free[list(members)] = False
        return np.asarray(free)

    def score(self, members: tuple[int, ...], entries: tuple[int, ...], generic: bool) -> Array:
        """Scores (candidates,) of the named or the unnamed ones that may still be added, -inf for the others."""
        found = self.evidence(entries)
        bank = self.start.bank
        return np.where(self.free(members) & (bank.generic == generic), found.score, -np.inf)
