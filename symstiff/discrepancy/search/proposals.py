"""Sets of effects proposed: each candidate beside those that are there, its best shape, sizes that are physical."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from symstiff.arrays import TINY
from symstiff.discrepancy.search.workshop import Proposal, Workshop

LEADING = 6
"""Sets of a size whose sizes are looked at; those behind them are never judged."""
_BREADTH, _WEIGHED, _POLISHED, _HIDING = 24, 24, 4, 8
"""At most: candidates that join a base, sets of a size that count as rivals, those whose shapes are chosen again, and
single effects beside which a hidden one is looked for. Each further one costs time."""
BEYOND = 2.0
"""Log likelihood that a set may lose by its sizes' physical range: two standard deviations of one size."""

Beyond = Callable[[Proposal], float]
"""What a set loses of its log likelihood where a size is moved into its physical range."""


def proposals(shop: Workshop, bases: list[Proposal]) -> list[Proposal]:
    """Sets with one more member than their base, best first, each set once."""
    made: dict[frozenset[int], Proposal] = {}
    for base in bases:
        score = shop.score(base.members, base.entries, False)
        for candidate in np.argsort(score)[::-1][:_BREADTH]:
            if not np.isfinite(score[candidate]):
                break
            entry, own = _entry(shop, int(candidate), base.entries)
            members = (*base.members, int(candidate))
            total = base.score + base.lost + own
            key = frozenset(members)
            if np.isfinite(own) and (key not in made or made[key].score < total):
                made[key] = Proposal(members, (*base.entries, entry), total)
    return sorted(made.values(), key=lambda p: -p.score)


def _entry(shop: Workshop, member: int, others: tuple[int, ...]) -> tuple[int, float]:
    """A candidate's best shape beside others that does not contradict what they take for granted, and its score."""
    bank, found = shop.start.bank, shop.own(member, others)
    if not bank.contradict(found.best, others):
        return found.best, found.score
    own = [found.first + k for k in range(len(found.entry)) if not bank.contradict(found.first + k, others)]
    if not own:
        return found.best, -np.inf
    likely = [found.at(e) + np.log(max(bank.share[e], TINY)) for e in own]
    entry = own[int(np.argmax(likely))]
    return entry, found.at(entry)


def polish(shop: Workshop, proposal: Proposal) -> Proposal:
    """Choose each member's shape again, given the others, and count the evidence along the better path."""
    if len(proposal.members) < 2:
        return proposal
    entries = list(_of_one_joint(shop, proposal))
    for place, member in enumerate(proposal.members):
        others = tuple(e for i, e in enumerate(entries) if i != place)
        entry, own = _entry(shop, member, others)
        entries[place] = entry if np.isfinite(own) else entries[place]
    score = proposal.score
    for place, member in enumerate(proposal.members):
        others = tuple(e for i, e in enumerate(entries) if i != place)
        if len(others) == 1:
            first = proposal.members[1 - place]
            path = shop.own(first, ()).at(others[0]) + shop.own(member, others).score
            score = max(score, path)
    return Proposal(proposal.members, tuple(entries), score)


def _of_one_joint(shop: Workshop, proposal: Proposal) -> tuple[int, ...]:
    """The entries, shapes of laws of one virtual joint chosen together: after the other, each fits a part of both."""
    bank, entries = shop.start.bank, list(proposal.entries)
    for a, b in combinations(range(len(entries)), 2):
        first, second = proposal.members[a], proposal.members[b]
        if bank.place[first] != bank.place[second] or not bank.place[first]:
            continue
        others = tuple(e for k, e in enumerate(entries) if k not in (a, b))
        alone, best = shop.own(first, others), -np.inf
        for entry in bank.alike(entries[a]):
            partner, own = _entry(shop, second, (*others, entry))
            value = alone.at(entry) + own
            if value > best:
                best, entries[a], entries[b] = value, entry, partner
    return tuple(entries)


def together(shop: Workshop, members: Sequence[int]) -> Proposal:
    """A set of candidates, each at its best shape beside those before it."""
    entries: tuple[int, ...] = ()
    score = 0.0
    for member in members:
        found = shop.own(member, entries)
        score += found.score
        entries = (*entries, found.best)
    return Proposal(tuple(members), entries, score)


def in_range(proposal: Proposal, beyond: Beyond) -> Proposal | None:
    """The proposal as far as its sizes are physical: less likely for what it loses by that, None beyond ``BEYOND``."""
    lost = beyond(proposal)
    return replace(proposal, score=proposal.score - lost, lost=lost) if lost < BEYOND else None


def ranked(
    shop: Workshop, bases: list[Proposal], beyond: Beyond, but: frozenset[int] | None = None
) -> list[Proposal]:
    """Proposals without those that hold all of ``but``: first those that lead, polished and in range, best first."""
    bank, out = shop.start.bank, list[Proposal]()
    for proposal in proposals(shop, bases):
        if len(out) >= _WEIGHED:
            break
        if but and but <= {bank.twins(e)[0] for e in proposal.entries}:
            continue
        done = polish(shop, proposal) if len(out) < _POLISHED else proposal
        kept = in_range(done, beyond) if len(out) < LEADING else done
        if kept is not None:
            out.append(kept)
    return [*sorted(out[:LEADING], key=lambda p: -p.score), *out[LEADING:]]


def of_two(shop: Workshop, beyond: Beyond) -> float:
    """Score of the likeliest two effects together, of which each may hide the other from tests of one."""
    likeliest = ranked(shop, [Proposal((), (), 0.0)], beyond)[:_HIDING]
    pairs = ranked(shop, likeliest, beyond) if likeliest else []
    return pairs[0].score if pairs else -np.inf
