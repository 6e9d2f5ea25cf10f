"""The outcome of the search put into tables: effects, candidates, growth path, confusability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from symstiff.arrays import TINY, Array
from symstiff.discrepancy.findings.instead import instead
from symstiff.discrepancy.findings.result import CandidateResult, Found, Name, Quantity, RivalLaw, Step
from symstiff.discrepancy.findings.spread import Spread, spread
from symstiff.discrepancy.problem import Candidate, Options, Parameter, Problem
from symstiff.discrepancy.reasons import Why
from symstiff.discrepancy.search.judging import Judged
from symstiff.discrepancy.search.proof import poses_of_their_own
from symstiff.discrepancy.search.rivals import Rival
from symstiff.discrepancy.search.shares import same_columns
from symstiff.discrepancy.search.verdict import Outcome
from symstiff.discrepancy.statistics.bank import Bank
from symstiff.discrepancy.statistics.design import confusability, share_left
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.null import critical
from symstiff.discrepancy.statistics.power import visible
from symstiff.discrepancy.statistics.prepare import Prepared
from symstiff.discrepancy.statistics.scan import (
    Scan,
    at_sharing,
    at_sharings,
    basis_of,
    coefficients,
    extend,
    likeliest,
    sum_entries,
)
from symstiff.discrepancy.statistics.strata import lack_of_fit, strata
from symstiff.discrepancy.statistics.testability import plainly_absorbed, telling, why_untestable
from symstiff.effects.base import Shape

CONFUSED = 0.9
"""Share of a candidate's fitted signal inside another's space from which they are said to be confused."""
_NEARLY = 2.0
"""Log evidence by which a law without a name may trail what it describes elsewhere, to be spoken of."""
_TOLD = 0.2
"""p-value of a candidate up to which is told what it is confused with."""
_DOUBTS, _ABSURD, _NEVER = 2.0, 10.0, 1e3
"""Standard deviations by which a plausible size may be out of its physical range, times that range at most, and from
how many on nothing is ever seen of it."""
_CARRIED = 0.75
"""Share of what is seen of an effect that one pose shows, to be spoken of."""
_PLAINLY = "in its plainest form the model absorbs it wholly: what is told is of another shape"
"""Why some of what is testable is not in every shape."""
_LEADERS = 8
"""Candidates among which confusion is told."""


def _name(candidate: Candidate) -> Name:
    return Name(candidate.effect, candidate.where)


def _estimates(bank: Bank, entry: int, value: Array, std: Array) -> Mapping[str, Quantity]:
    return {
        p.name: Quantity(float(v), float(s), p.unit)
        for p, v, s in zip(bank.parameters(entry), value, std, strict=False)
    }


def _fitted(
    problem: Problem, ready: Prepared, entries: tuple[int, ...]
) -> tuple[Array, Array, Array, list[tuple[Name, Mapping[str, Quantity]]]]:
    """Model estimates, their deviations, fitted values, and each entry's estimates."""
    bank: Bank = ready.bank
    value, std, fitted = coefficients(ready.scan, problem.A, problem.y, entries)
    at = problem.A.shape[1]
    effects = []
    for e in entries:
        candidate = bank.candidates[int(bank.owner[e])]
        width = int(bank.width[e])
        effects.append((_name(candidate), _estimates(bank, e, value[at : at + width], std[at : at + width])))
        at += width
    P = problem.A.shape[1]
    return value[:P], std[:P], fitted, effects


def named_effects(problem: Problem, ready: Prepared, outcome: Outcome) -> tuple[Found, ...]:
    """The effects of the admissible sets, best set first."""
    bank, sure = ready.bank, _confidences(outcome)
    out = []
    for number, judged in enumerate(outcome.admissible):
        effects = _fitted(problem, ready, judged.entries)[3]
        for i, (member, entry) in enumerate(zip(judged.members, judged.entries, strict=True)):
            candidate, confused = bank.candidates[member], _confused(ready, entry)
            shapes = spread(ready.scan, judged.entries, i)
            sizes = {name: _counting(size, shapes) for name, size in effects[i][1].items()}
            out.append(
                Found(
                    candidate.effect, candidate.where, shapes.shape, sizes,
                    judged.p_members[i], float(np.clip(sure[number][member], 0.0, 1.0)),
                    tuple(_name(bank.candidates[c]) for c in confused), number, _twins(bank, entry),
                    instead(ready.scan, judged.entries, i, confused), _carried(problem, ready, entry),
                )
            )  # fmt: skip
    return tuple(out)


def _carried(problem: Problem, ready: Prepared, entry: int) -> tuple[int, float] | None:
    """The pose that shows nearly all of an entry, and its share of the squares; None where none does or could."""
    if len(poses_of_their_own(problem, ready.bank, [entry])):
        return None
    layer = ready.scan.best
    Q = basis_of(ready.scan, layer, entry)
    square = np.bincount(problem.pose, (Q @ (Q.T @ layer.y)) ** 2)
    pose, total = int(np.argmax(square)), float(square.sum())
    return (pose, float(square[pose]) / total) if square[pose] > _CARRIED * total else None


def _counting(size: Quantity, shapes: Spread) -> Quantity:
    """A size with what the data leave open of its shape."""
    std = float(np.hypot(size.std, shapes.deviation))
    return replace(size, std=std, across=shapes.sizes, by_shape=shapes.deviation)


def leading(
    problem: Problem, ready: Prepared, outcome: Outcome
) -> tuple[tuple[Name, Shape, Mapping[str, Quantity]], ...]:
    """The effects of the leading set with their shapes and estimates, none where nothing was found."""
    if outcome.chosen is None:
        return ()
    entries = outcome.chosen.entries
    found = _fitted(problem, ready, entries)[3]
    return tuple(
        (name, ready.bank.shape_of(e), values) for e, (name, values) in zip(entries, found, strict=True)
    )


def alike(ready: Prepared, outcome: Outcome) -> RivalLaw | None:
    """The law without a name that describes what the leading set does, and explains nearly as much."""
    law = outcome.admissible[0].rivals.alike if outcome.admissible else None
    return None if law is None or law.lead < -_NEARLY else _law(ready, law)


def rival(ready: Prepared, outcome: Outcome) -> RivalLaw | None:
    """The law without a name that does most in the place of a member of the leading set."""
    law = None if outcome.chosen is None else outcome.chosen.rivals.first
    return None if law is None else _law(ready, law)


def _law(ready: Prepared, law: Rival) -> RivalLaw:
    where = ready.bank.candidates[law.candidate].where
    return RivalLaw(str(where["at"]), str(where["law"]), law.lead)


def _confidences(outcome: Outcome) -> list[Mapping[int, float]]:
    """Confidence of every set's members: what all sets share keeps its own, the sets divide the rest by evidence, and
    names of the same columns theirs evenly.
    """
    if not outcome.admissible:
        return []
    leader = outcome.admissible[0]
    sure = dict(zip(leader.members, outcome.confidence, strict=True))
    columns = [same_columns(j, j.bank) for j in outcome.admissible]
    alike = [j for j, c in zip(outcome.admissible, columns, strict=True) if c == columns[0]]
    names = [len(set(members)) for members in zip(*(j.members for j in alike), strict=True)]
    own = {m: c / n for j in alike for m, c, n in zip(j.members, outcome.confidence, names, strict=True)}
    weight = [
        float(np.exp(j.score - leader.score)) if c != columns[0] else 0.0
        for j, c in zip(outcome.admissible, columns, strict=True)
    ]
    out: list[Mapping[int, float]] = []
    for judged, w in zip(outcome.admissible, weight, strict=True):
        most = min((c for m, c in sure.items() if m not in judged.members), default=1.0)
        share = min(w * most, (1.0 - most) * w / max(sum(weight), TINY))
        out.append({m: own.get(m, share) for m in judged.members})
    return out


def _twins(bank: Bank, entry: int) -> tuple[Name, ...]:
    return tuple(_name(bank.candidates[k]) for k in bank.twins(entry) if k != bank.owner[entry])


def _confused(ready: Prepared, entry: int) -> list[int]:
    """Other named candidates that hold most of the fitted signal of an entry, or share its structural group."""
    bank, layer = ready.bank, ready.scan.best
    own = int(bank.owner[entry])
    Q = basis_of(ready.scan, layer, entry)
    signal = Q @ (Q.T @ layer.y)
    total = float(signal @ signal)
    seen = at_sharing(ready.scan, layer.sharing).seen([signal[:, None]])[0]
    inside = sum_entries(bank, seen**2)[:, 0]
    twins = bank.twins(entry)
    found: dict[int, float] = {}
    for e, value in enumerate(inside):
        c = int(bank.owner[e])
        if c != own and not bank.generic[c] and (c in twins or (total > 0 and value > CONFUSED * total)):
            found[c] = max(found.get(c, 0.0), float(value))
    return sorted(found, key=lambda c: -found[c])


def candidate_table(
    problem: Problem, candidates: Sequence[Candidate], ready: Prepared, allowed: Array, outcome: Outcome,
    options: Options,
) -> tuple[CandidateResult, ...]:  # fmt: skip
    """All candidates of the catalogue, tested ones best first, then those that these data cannot test."""
    bank, scan = ready.bank, ready.scan
    threshold = critical(outcome.null.named, options.alpha)
    threshold = threshold if np.isfinite(threshold) else 0.0
    there = [i for c in candidates if (i := bank.named.get(c.key)) is not None]
    clean = _after(scan, outcome.chosen.entries if outcome.chosen is not None else ())
    asked = [telling(ready, i, int(outcome.found.best_entry[i])) for i in there]
    told = dict(zip(there, asked, strict=True))
    seen = dict(zip(there, visible(clean, asked, threshold), strict=True))
    judged = {j.members[0]: j for j in outcome.tried if len(j.members) == 1}
    out = []
    for candidate in candidates:
        i = bank.named.get(candidate.key)
        if i is None:
            reason = candidate.unavailable or "its columns vanish for these data"
            out.append(_untested(candidate, reason))
            continue
        entry = int(outcome.found.best_entry[i])
        smallest = _smallest(bank, told[i], seen[i].sizes)
        left = share_left(scan, entry)
        if not allowed[i]:
            why = why_untestable(problem, ready, entry)
            out.append(_untested(candidate, why, left, smallest, bank.shape_of(told[i])))
            continue
        effects = _fitted(problem, ready, (entry,))[3]
        verdict = judged.get(i)
        score = float(outcome.found.score[i])
        p = outcome.null.p_named(score)
        out.append(
            CandidateResult(
                candidate.effect, candidate.where, score, p, True,
                _PLAINLY if plainly_absorbed(ready, i) else "",
                None if verdict is None else verdict.sufficient, _within(bank, entry, effects[0][1]),
                bank.shape_of(entry), effects[0][1], left, smallest,
                tuple(_name(bank.candidates[c]) for c in _confused(ready, entry)) if p < _TOLD else (),
                seen[i].noncentrality, bank.shape_of(told[i]),
            )
        )  # fmt: skip
    return tuple(sorted(out, key=lambda c: -c.score))


def _after(scan: Scan, entries: tuple[int, ...]) -> Scan:
    """The scan with the noise that is left after some entries: what was found hides no other effect any more."""
    after = extend(scan, entries)
    layers = (
        replace(one, rss=other.rss, determinant=other.determinant)
        for one, other in zip(scan.layers, after.layers, strict=True)
    )
    return replace(scan, layers=tuple(layers), freedom=after.freedom)


def _smallest(bank: Bank, entry: int, sizes: Array) -> Mapping[str, Quantity]:
    """The sizes that would be seen; infinite where they are far beyond what such sizes ever are."""
    largest = [max(abs(p.low), abs(p.high)) for p in bank.parameters(entry)]
    possible = sizes <= _NEVER * np.array(largest[: len(sizes)])
    return _estimates(bank, entry, np.where(possible, sizes, np.inf), np.zeros_like(sizes))


def _within(bank: Bank, entry: int, estimates: Mapping[str, Quantity]) -> bool:
    return all(_plausible(estimates[p.name], p) for p in bank.parameters(entry) if p.name in estimates)


def _plausible(found: Quantity, known: Parameter) -> bool:
    """Whether a size is in its physical range, as far as its deviation tells and no further than sizes ever are."""
    margin = min(_DOUBTS * found.std, _ABSURD * max(abs(known.low), abs(known.high)))
    return known.low - margin <= found.value <= known.high + margin


def _untested(
    candidate: Candidate, reason: str, left: float = 0.0, smallest: Mapping[str, Quantity] | None = None,
    seen_as: Shape | None = None,
) -> CandidateResult:  # fmt: skip
    return CandidateResult(
        candidate.effect, candidate.where, -np.inf, 1.0, False, reason, None, None,
        candidate.shapes[0] if candidate.shapes else {}, {}, left, smallest or {}, (), seen_as=seen_as or {},
    )  # fmt: skip


def unavailable(candidates: Sequence[Candidate], reason: str) -> tuple[CandidateResult, ...]:
    """The table where nothing could be tested."""
    return tuple(_untested(c, c.unavailable or reason) for c in candidates)


def steps(
    problem: Problem, ready: Prepared, named: Judged | None, allowed: Array, outcome: Outcome
) -> tuple[Step, ...]:
    """The growth path: the starting model, then each member of the named set in the order of its strength.

    Of what stands out further, those that the data can test (``allowed``), as the null distribution has it.

    All tests and sizes under the shared error that is left at its end: before it, what is missing passes for one. What
    is left is that of models identified by the rows' own noise, whose residuals can be compared: weighed by a shared
    error a model leaves more than it has to, and the gap would seem wider than it is.
    """
    entries: tuple[int, ...] = named.entries if named is not None else ()
    alone = replace(ready, scan=_unshared(ready.scan))
    ready = replace(ready, scan=at_sharing(ready.scan, likeliest(ready.scan, entries).sharing))
    out = []
    for count in range(len(entries) + 1):
        used = entries[:count]
        scan = extend(ready.scan, used)
        model, std, _, effects = _fitted(problem, ready, used)
        residual = problem.y - _fitted(problem, alone, used)[2]
        found = evidence(scan)
        owners = [int(ready.bank.owner[e]) for e in used]
        score = np.where(ready.bank.generic | ~allowed.astype(bool), -np.inf, found.score)
        score[owners] = -np.inf
        best = float(np.max(score, initial=-np.inf))
        further = _name(ready.bank.candidates[int(np.argmax(score))]) if np.isfinite(best) else None
        p_left = outcome.null.p_named(best) if count < len(entries) or named is None else named.p_left_named
        # where a stratum alone decided it is told as it did
        decided = outcome.because.why is Why.ONE_STRATUM
        lack = strata(problem, scan) if decided else lack_of_fit(problem, scan, ready.report)
        out.append(
            Step(
                effects[-1][0] if effects else None, model, std, tuple(effects),
                float(np.sqrt(np.mean(residual[problem.main] ** 2))), lack, p_left, residual, further,
                ready.scan.freedom - scan.freedom, problem.rows - scan.freedom,
            )
        )  # fmt: skip
    return tuple(out)


def _unshared(scan: Scan) -> Scan:
    """The scan by the rows' own noise alone."""
    return at_sharings(scan, np.array([layer.sharing.ratio == 0.0 for layer in scan.layers]))


def noise_floor(ready: Prepared) -> float:
    """Root mean square of the noise, approach error included, of the translations where there are any."""
    return float(np.hypot(ready.report.sigma, ready.report.approach))


def confusion(ready: Prepared, outcome: Outcome) -> tuple[tuple[Name, ...], Array]:
    """D_ij of the leading named candidates."""
    bank = ready.bank
    order = [int(i) for i in np.argsort(-outcome.found.score) if not bank.generic[i]][:_LEADERS]
    D = confusability(ready.scan, [int(outcome.found.best_entry[i]) for i in order])
    return tuple(_name(bank.candidates[i]) for i in order), D
