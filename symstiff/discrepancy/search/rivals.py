"""Laws without a name that may take the place of a set's members."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from symstiff.arrays import TINY, Array
from symstiff.discrepancy.search.workshop import Proposal, Workshop
from symstiff.discrepancy.statistics.between import size_of
from symstiff.discrepancy.statistics.scan import Scan, basis_of
from symstiff.reduction.svd import svd

SAME_SIGNAL = 0.85
"""Share of an unnamed law's signal inside a set's space from which both describe the same thing."""
SAME_PLACE = 0.5
"""The same share for another shape of a member's law: at its virtual joint, and by what that depends on."""
AS_MUCH = 1.0
"""Log evidence within which two sets explain the same."""
_RIVALS, _FAR, _AHEAD = 40, 8.0, 3.0
"""Unnamed laws at most that may take a member's place, log evidence by which they may trail, and by which one that
describes what a member does, as a compliance that follows a joint does what a compensator does, has to lead to be a
rival all the same."""
_EQUAL = 1e-6
"""Distance of two spaces of columns up to which they are one."""
_CLEARLY = 0.1
"""Share of a set's score by which another shape of a member's law has to lead as well: no shape is at hand exactly."""


@dataclass(frozen=True)
class Rival:
    """An unnamed law in the place of one member of a set, or of all."""

    candidate: int
    lead: float
    """Score of the set with the law, minus that of the set."""


@dataclass(frozen=True)
class Rivals:
    """What unnamed laws do in the places of a set's members."""

    found: tuple[Rival, ...]
    """Those that are not far behind; the set is ahead where all leads are negative."""
    challenge: tuple[float, ...]
    """Of each member the largest lead among those that take its place."""
    alike: Rival | None
    """What explains most of the laws elsewhere that describe what a member does."""

    @property
    def first(self) -> Rival | None:
        """The one that leads by most."""
        return _first(self.found)

    @property
    def best(self) -> float:
        """The largest lead."""
        return -np.inf if self.first is None else self.first.lead

    @property
    def together(self) -> float:
        """Log evidence of all of them together, over the set's."""
        return float(np.logaddexp.reduce([rival.lead for rival in self.found], initial=-np.inf))


def rivals(shop: Workshop, proposal: Proposal) -> Rivals:
    """What unnamed laws of another form do in the place of a set's members, and the law alike that leads."""
    out, alike = list[Rival](), list[Rival]()
    challenge = [-np.inf] * len(proposal.members)
    for replaced, kept in _replaced(proposal):
        others, same = _in_place(shop, proposal, replaced, kept)
        out, alike = [*out, *others], [*alike, *same]
        for k in replaced:
            challenge[k] = max(challenge[k], *(rival.lead for rival in others), -np.inf)
    return Rivals(tuple(out), tuple(challenge), _first(alike))


def _first(some: Sequence[Rival]) -> Rival | None:
    return max(some, key=lambda rival: rival.lead, default=None)


def _in_place(
    shop: Workshop, proposal: Proposal, replaced: tuple[int, ...], kept: tuple[int, ...]
) -> tuple[list[Rival], list[Rival]]:
    """The laws that take some members' places, and those that describe the same as what they replace."""
    entries = tuple(proposal.entries[k] for k in kept)
    old = tuple(proposal.entries[k] for k in replaced)
    found, scan = shop.evidence(entries), shop.scan(entries)
    score = _instead(shop, proposal, replaced, kept)
    others, alike = list[Rival](), list[Rival]()
    for candidate in np.argsort(score)[::-1][:_RIVALS]:
        lead, law = float(score[candidate]), int(found.best_entry[candidate])
        if not lead > -_FAR:
            break
        lead -= _unusual(shop.start, entries, law)
        if not lead > -_FAR:
            continue
        if len(old) == 1 and _its_own(scan, law, old[0]):
            continue
        share, narrow = _inside(scan, law, old)
        shape = share > SAME_PLACE and any(scan.bank.another_shape(law, e) for e in old)
        if shape and lead <= max(_AHEAD, _CLEARLY * proposal.score):
            continue
        same = share > SAME_SIGNAL and narrow
        if same:
            alike.append(Rival(int(candidate), lead))
        if not same or lead > _AHEAD:
            others.append(Rival(int(candidate), lead))
    return others, alike


def _unusual(scan: Scan, others: tuple[int, ...], law: int) -> float:
    """Log evidence that a law of one size loses where it is far beyond its usual one, as by a Cauchy prior.

    A robot file is wrong by 300 mm less often than by 30, and is so all the same where the data are sure of it.
    """
    usual = [p.typical for p in scan.bank.parameters(law)]
    if len(usual) != 1 or not usual[0] > 0:
        return 0.0
    return float(np.log1p((size_of(scan, others, law) / usual[0]) ** 2))


def _its_own(scan: Scan, law: int, entry: int) -> bool:
    """Whether an unnamed law is the one that a named effect has: the same columns at the same virtual joint."""
    bank = scan.bank
    if bank.candidates[int(bank.owner[law])].where.get("at") != bank.place[int(bank.owner[entry])]:
        return False
    a, b = (basis_of(scan, scan.best, e) for e in (law, entry))
    return a.shape == b.shape and bool(np.linalg.norm(a - b @ (b.T @ a)) < _EQUAL)


def _replaced(proposal: Proposal) -> Iterator[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Places of the members that a law replaces, all or one of several, and of those that stay."""
    every = tuple(range(len(proposal.members)))
    yield every, ()
    for k in every if len(every) > 1 else ():
        yield (k,), tuple(other for other in every if other != k)


def _instead(shop: Workshop, proposal: Proposal, replaced: tuple[int, ...], kept: tuple[int, ...]) -> Array:
    """Scores (candidates,) of unnamed laws beside the members that stay, minus the set's."""
    members = tuple(proposal.members[k] for k in kept)
    entries = tuple(proposal.entries[k] for k in kept)
    base = 0.0
    if kept:
        base = proposal.score - shop.own(proposal.members[replaced[0]], entries).score
    return shop.score(members, entries, True) + (base if np.isfinite(base) else 0.0) - proposal.score


def _inside(scan: Scan, law: int, entries: tuple[int, ...]) -> tuple[float, bool]:
    """Share of a law's fitted signal in the space of some entries, and whether that is hardly larger than its own."""
    layer = scan.best
    a = basis_of(scan, layer, law)
    signal = a @ (a.T @ layer.y)
    U, s, _ = svd(np.hstack([basis_of(scan, layer, e) for e in entries]))
    U = U[:, s > 1e-7]
    inside = U.T @ signal
    share = float(inside @ inside) / max(float(signal @ signal), TINY)
    return share, bool(U.shape[1] <= layer.bases.rank[law] + 2)
