"""Sets of effects judged: what they leave unexplained, whether they need each member, what rivals them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from symstiff.arrays import TINY
from symstiff.discrepancy.laws.unnamed import of_load
from symstiff.discrepancy.noise.sharing import Sharing
from symstiff.discrepancy.problem import Options
from symstiff.discrepancy.search.rivals import Rivals, rivals
from symstiff.discrepancy.search.workshop import Proposal, Workshop
from symstiff.discrepancy.statistics.bank import Bank
from symstiff.discrepancy.statistics.design import effective_rank
from symstiff.discrepancy.statistics.scan import (
    Layer,
    Scan,
    explained,
    log_likelihood,
)
from symstiff.discrepancy.statistics.strata import PROPORTIONAL, Stratum, fills

_UNCLEAR, _CLEAR = 10.0, 1e-5
"""Factor over the largest level, and p-value: beyond them the null distribution of the start decides, and only between
them it is worth the time to draw the set's own."""
_SIGMAS, _FEW = 3.0, 4.0
"""Standard deviations above its mean that noise explains along some directions, and what it may explain beyond: few
directions have a longer tail than a normal one."""
_HALF = 0.5
"""Part of what a shape may miss that a set may leave to a further effect where a shape explains that as well."""


@dataclass(frozen=True)
class Judged:
    """A set with its tests."""

    members: tuple[int, ...]
    entries: tuple[int, ...]
    score: float
    bank: Bank
    sharing: Sharing
    """The likeliest with the entries in the model."""
    rss: float
    """What is left there, in units of the noise's spread."""
    freedom: int
    p_left_named: float
    p_left_unnamed: float
    missed_share: float
    rivals: Rivals
    """What unnamed laws do in the members' places."""
    sufficient: bool
    p_members: tuple[float, ...]
    """Family-wise p-value of each member given the others."""

    @property
    def proposal(self) -> Proposal:
        """The set as one that others are made from or held against."""
        return Proposal(self.members, self.entries, self.score)


def judge(shop: Workshop, proposal: Proposal) -> Judged:
    """Is the set sufficient, is each member needed, and does an unnamed law do better?"""
    options, proposal = shop.options, _by_strength(shop, proposal)
    members, entries = proposal.members, proposal.entries
    scan = shop.scan(entries)
    named = float(np.max(shop.score(members, entries, False), initial=-np.inf))
    unnamed = float(np.max(shop.score(members, entries, True), initial=-np.inf))
    # the null of the start decides clear cases; draws for this set are made where it could tip the balance
    distribution = shop.null((), ())
    p_named, p_unnamed = distribution.p_named(named), distribution.p_generic(unnamed)
    close = _UNCLEAR * max(options.alpha_sufficient, options.alpha_further, options.alpha_notable)
    if min(p_named, p_unnamed) < close and max(p_named, p_unnamed) > _CLEAR:
        distribution = shop.null(members, entries)
        p_named, p_unnamed = distribution.p_named(named), distribution.p_generic(unnamed)
    gained = _gained(shop, scan, scan.best)
    missed = _missed_share(shop, proposal, scan)
    further = _level_of_further(options, missed)
    other = options.alpha_notable if missed > options.tolerated_shape else options.alpha_sufficient
    # what is left must be more believable than nothing: small p-values alone are shapes that are only close
    lack_named = p_named < further and named > 0 and missed > _tolerated(shop, proposal, False)
    lack_unnamed = p_unnamed < other and unnamed > 0 and missed > _tolerated(shop, proposal, True)
    usual = sum(effective_rank(shop.start, e) for e in entries)
    p_members = tuple(_needed(shop, proposal, i) for i in range(len(members)))
    return Judged(
        members, entries, proposal.score, scan.bank, scan.best.sharing, scan.best.rss, scan.freedom, p_named,
        p_unnamed, missed, rivals(shop, proposal),
        not (lack_named or lack_unnamed or _lacking(shop, scan, gained, usual)), p_members,
    )  # fmt: skip


def _level_of_further(options: Options, missed: float) -> float:
    """Level at which a further effect of the catalogue makes a set insufficient, by the share that is missed."""
    if missed > options.notable:
        return options.alpha_notable
    return options.alpha_further if missed > options.little else options.alpha_little


def _by_strength(shop: Workshop, proposal: Proposal) -> Proposal:
    """The set with its members in the order of their evidence given the others."""
    n = range(len(proposal.members))
    strength = [_evidence_of(shop, proposal, place) for place in n]
    order = sorted(n, key=lambda place: -strength[place])
    return replace(
        proposal,
        members=tuple(proposal.members[k] for k in order),
        entries=tuple(proposal.entries[k] for k in order),
    )


def _proportional(parts: Sequence[Stratum]) -> int:
    """Directions proportional to the load that are left."""
    return next((p.degrees_of_freedom for p in parts if p.name == PROPORTIONAL), 0)


def _lacking(shop: Workshop, scan: Scan, gained: float, usual: float) -> bool:
    """Whether a stratum still rejects, and what it holds is more of the signal than a shape that is only close.

    Or whether the set fills a stratum, so that nothing is left there that could reject; ``usual`` is the number of
    directions in which its parameters usually have a share.
    """
    parts, left = shop.lack(scan), _proportional(shop.parts)
    if fills(left - _proportional(parts), left, usual):
        return True
    for part in parts:
        further = max(part.sum_of_squares - part.degrees_of_freedom, 0.0)
        rejects = part.p_value is not None and part.p_value < shop.options.alpha_sufficient
        if rejects and further > shop.options.tolerated_shape * (further + gained):
            return True
    return False


def _tolerated(shop: Workshop, proposal: Proposal, generic: bool) -> float:
    """Share of the signal that may be missed: more where the best further law is another shape of a member's.

    There, at one virtual joint and by what moves it, only the member's law is off. A further effect of the catalogue
    anywhere else is never tolerated: a frame that drifts and is turned, or a link that is longer and heavier than told,
    is two effects.
    """
    bank, options = shop.start.bank, shop.options
    score = shop.score(proposal.members, proposal.entries, generic)
    if not np.any(np.isfinite(score)):
        return 1.0
    best = int(np.argmax(score))
    law = int(shop.evidence(proposal.entries).best_entry[best])
    here = [e for e in proposal.entries if bank.another_shape(law, e)]
    if here:
        # two laws at one place bend to almost anything: what they still miss there is another law
        return options.tolerated_shape if len(here) == 1 else options.tolerated_share
    if generic:
        return options.tolerated_share
    return _HALF * options.tolerated_shape if _shape_explains(shop, proposal, float(score[best])) else 0.0


def _shape_explains(shop: Workshop, proposal: Proposal, further: float) -> bool:
    """Whether another law of the load at a member's place accounts for what is left as well as a further effect.

    A priori what is left of an effect with a place is as likely its shape as an effect more.
    """
    bank = shop.start.bank
    places = {bank.place[m] for m in proposal.members} - {""}
    driven = np.array([g and of_load(c) for c, g in zip(bank.candidates, bank.generic, strict=True)])
    here = np.array([p in places for p in bank.place]) & driven
    if not np.any(here):
        return False
    found = shop.evidence(proposal.entries).candidate[here]
    prior = 0.5 / np.sum(here)
    return float(np.max(found)) + float(np.log(prior)) >= further


def _missed_share(shop: Workshop, proposal: Proposal, scan: Scan) -> float:
    """Share of the explainable signal that the set leaves to the best further candidate, noise deducted.

    Under the shared error that is likeliest with that candidate: without it a shared error may take its place.
    """
    free = shop.free(proposal.members)
    if not np.any(free):
        return 0.0
    found = shop.evidence(proposal.entries)
    best = int(found.best_entry[int(np.argmax(np.where(free, found.score, -np.inf)))])
    squares, rss = explained(scan), np.array([layer.rss for layer in scan.layers])
    r = int(np.argmax(log_likelihood(scan, rss - squares[:, best])))
    layer, scale2 = scan.layers[r], max(rss[r] / max(scan.freedom, 1), TINY)
    noise = layer.bases.rank + _SIGMAS * np.sqrt(2.0 * layer.bases.rank) + _FEW
    left = np.where(free[scan.bank.owner], squares[r] / scale2 - noise, 0.0)
    further = max(0.0, float(np.max(left)))
    return further / max(further + _gained(shop, scan, layer), TINY)


def _gained(shop: Workshop, scan: Scan, layer: Layer) -> float:
    """Sum of squares that a set has explained under one of its scan's sharings, in units of the variance left."""
    before = next(start.rss for start in shop.start.layers if start.sharing == layer.sharing)
    return (before - layer.rss) / max(layer.rss / max(scan.freedom, 1), TINY)


def _needed(shop: Workshop, proposal: Proposal, place: int) -> float:
    """Backward check: family-wise p-value of one member given the others, by the null of the start."""
    return shop.null((), ()).p_named(_evidence_of(shop, proposal, place))


def _evidence_of(shop: Workshop, proposal: Proposal, place: int) -> float:
    """Score of one member given the others."""
    entries = tuple(e for i, e in enumerate(proposal.entries) if i != place)
    return shop.own(proposal.members[place], entries).score
