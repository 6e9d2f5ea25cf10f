"""Laws without a name that may take the place of a set's members."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from symstiff.arrays import Array
from symstiff.discrepancy.scan import Scan, basis_of
from symstiff.discrepancy.workshop import Proposal, Workshop
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
_CLEARLY = 0.1
"""Share of a set's score by which another shape of a member's law has to lead as well: no shape is at hand exactly."""


@dataclass(frozen=True)
class Alike:
    """An unnamed law elsewhere whose signal lies in a set's space."""

    candidate: int
    lead: float
    """Score of the best set in which it takes a member's place, minus that of the set."""


@dataclass(frozen=True)
class Rivals:
    """Sets in which an unnamed law takes the place of one member of a set, or of all: their scores over the set's."""

    leads: tuple[float, ...]
    """Those that are not far behind; the set is ahead where all are negative."""
    challenge: tuple[float, ...]
    """Of each member the largest among those in which its place is taken."""
    alike: Alike | None
    """What explains most of the unnamed laws that describe what a member does."""

    @property
    def best(self) -> float:
        """The largest lead."""
        return max(self.leads, default=-np.inf)

    @property
    def together(self) -> float:
        """Log evidence of all of them together, over the set's."""
        return float(np.logaddexp.reduce(self.leads, initial=-np.inf))


def rivals(shop: Workshop, proposal: Proposal) -> Rivals:
    """What unnamed laws of another form do in the place of a set's members, and the law alike that leads."""
    out, alike = list[float](), list[Alike]()
    challenge = [-np.inf] * len(proposal.members)
    for replaced, kept in _replaced(proposal):
        leads, same = _in_place(shop, proposal, replaced, kept)
        out, alike = [*out, *leads], [*alike, *same]
        for k in replaced:
            challenge[k] = max(challenge[k], *leads, -np.inf)
    return Rivals(tuple(out), tuple(challenge), max(alike, key=lambda one: one.lead, default=None))


def _in_place(
    shop: Workshop, proposal: Proposal, replaced: tuple[int, ...], kept: tuple[int, ...]
) -> tuple[list[float], list[Alike]]:
    """Leads of the laws that take some members' places, and those that describe the same as what they replace."""
    entries = tuple(proposal.entries[k] for k in kept)
    old = tuple(proposal.entries[k] for k in replaced)
    found, scan = shop.evidence(entries), shop.scan(entries)
    score = _instead(shop, proposal, replaced, kept)
    leads, alike = list[float](), list[Alike]()
    for candidate in np.argsort(score)[::-1][:_RIVALS]:
        lead, law = float(score[candidate]), int(found.best_entry[candidate])
        if not lead > -_FAR:
            break
        share, narrow = _inside(scan, law, old)
        shape = share > SAME_PLACE and any(scan.bank.another_shape(law, e) for e in old)
        if shape and lead <= max(_AHEAD, _CLEARLY * proposal.score):
            continue
        same = share > SAME_SIGNAL and narrow
        if same:
            alike.append(Alike(int(candidate), lead))
        if not same or lead > _AHEAD:
            leads.append(lead)
    return leads, alike


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
        base = proposal.score - float(shop.evidence(entries).score[proposal.members[replaced[0]]])
    return shop.score(members, entries, True) + (base if np.isfinite(base) else 0.0) - proposal.score


def _inside(scan: Scan, law: int, entries: tuple[int, ...]) -> tuple[float, bool]:
    """Share of a law's fitted signal in the space of some entries, and whether that is hardly larger than its own."""
    layer = scan.best
    a = basis_of(scan, layer, law)
    signal = a @ (a.T @ layer.y)
    U, s, _ = svd(np.hstack([basis_of(scan, layer, e) for e in entries]))
    U = U[:, s > 1e-7]
    inside = U.T @ signal
    share = float(inside @ inside) / max(float(signal @ signal), 1e-300)
    return share, bool(U.shape[1] <= layer.bases.rank[law] + 2)
