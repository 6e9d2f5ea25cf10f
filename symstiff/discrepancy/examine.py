"""The discrepancy workflow on arrays: noise, lack of fit, place, candidates, verdict, growth, proof.

It knows no effect by name: candidates are columns with a key.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr, ndtri

from symstiff.arrays import TINY, Array
from symstiff.calibration.fits.decomposition import column_space
from symstiff.discrepancy.findings.constancy import inconstancies
from symstiff.discrepancy.findings.result import Diagnosis, Name, Rms
from symstiff.discrepancy.findings.tables import (
    alike,
    candidate_table,
    confusion,
    leading,
    named_effects,
    noise_floor,
    rival,
    steps,
    unavailable,
)
from symstiff.discrepancy.noise.scales import CONTRADICTED, REPEATABILITY, Noise, NoiseReport
from symstiff.discrepancy.problem import Candidate, Options, Problem, key_of
from symstiff.discrepancy.reasons import Reason, Why
from symstiff.discrepancy.search.localise import (
    FittedDevice,
    FittedLaw,
    Localisation,
    best_law,
    device_law,
    localise,
    with_law,
)
from symstiff.discrepancy.search.proof import HeldOut, held_out, poses_of_their_own
from symstiff.discrepancy.search.rivals import AS_MUCH
from symstiff.discrepancy.search.verdict import (
    AMBIGUOUS,
    EVEN,
    INSUFFICIENT,
    NAMED,
    NOTHING,
    UNEXPLAINED,
    UNTESTABLE,
    Outcome,
    decide,
)
from symstiff.discrepancy.search.workshop import Proposal
from symstiff.discrepancy.statistics.bank import Bank
from symstiff.discrepancy.statistics.evidence import Evidence
from symstiff.discrepancy.statistics.prepare import Prepared, noise_told_anew, prepare
from symstiff.discrepancy.statistics.scan import Scan, coefficients
from symstiff.discrepancy.statistics.strata import Stratum, strata
from symstiff.discrepancy.statistics.testability import testable

ROUNDING = 1e-9
"""Share of the readings that the model leaves, from which there is something to test."""
_NEXT = 4
"""Virtual joints that would explain most at which a law is looked for where there is none at the accused one."""
_FAR = 8.0
"""Standard deviations that are out of range of however many."""
LEAST_FREEDOM = 5
"""Degrees of freedom outside the model below which no test is made."""


def examine(
    problem: Problem,
    candidates: Sequence[Candidate],
    options: Options | None = None,
    progress: Callable[[str], None] | None = None,
    given: Sequence[Name] = (),
    doubt: Reason | None = None,
    like: Noise | None = None,
) -> Diagnosis:
    """Say whether something is missing from the model, where, what it is called and how sure that is.

    ``candidates`` is the catalogue at all its places; ``progress`` is told each stage; effects that are ``given``
    belong to every explanation; the noise is looked for near one that is ``like`` it. Data in which nothing can be
    tested, or of which there is a ``doubt``, give the verdict ``untestable``. The same input gives the same answer: all
    draws come from ``options.seed``.
    """
    options = options or Options()
    tell = progress or (lambda stage: None)
    obstacle = untestable(problem) or doubt
    if obstacle:
        return _without_tests(UNTESTABLE, problem, candidates, obstacle)
    if _exact(problem):
        return _without_tests(NOTHING, problem, candidates, Reason(Why.EXACT))
    tell("noise")
    ready = prepare(problem, candidates, like)
    tell("lack of fit")
    parts = strata(problem, ready.scan)
    allowed = testable(problem, ready)
    tell("candidates")
    outcome = decide(
        ready.scan, allowed, options, lambda p: beyond(problem, ready, p), parts, tell,
        named_among(ready.bank, given), lambda scan: strata(problem, scan),
    )  # fmt: skip
    if outcome.admissible:
        ready = noise_told_anew(problem, ready, outcome.admissible[0].entries)
    proof = _proof(problem, ready, allowed, outcome, options, tell)
    outcome = against_sigma(outcome if proof is None else doubted(outcome, proof), ready.report)
    tell("place")
    place = localise(problem, ready.scan, outcome.found, ready.residual)
    if outcome.because.why in (Why.ONE_STRATUM, Why.SETTLES):
        places = ready.report.settling if outcome.because.why is Why.SETTLES else ()
        place = replace(place, accused=f"joint {places[0].joint}" if places else "")
    return _written(problem, candidates, ready, parts, allowed, outcome, place, proof, options, tell)


def named_among(bank: Bank, names: Sequence[Name]) -> list[int]:
    """Numbers of named candidates in the bank; names that it does not hold are left out."""
    found = [bank.named.get(key_of(n.effect, n.where)) for n in names]
    return [k for k in found if k is not None]


def untestable(problem: Problem) -> Reason | None:
    """Why nothing can be tested with these data."""
    freedom = problem.rows - column_space(problem.A).shape[1]
    repeats = problem.rows - len(np.unique(problem.cells))
    if freedom < LEAST_FREEDOM:
        few = f"{freedom} degrees of freedom are left outside the model: measure more poses"
        return Reason(Why.UNTESTABLE, (few,))
    if problem.poses < 2:
        blind = ", no sigma and no repeats" if problem.sigma is None and repeats < LEAST_FREEDOM else " alone"
        one = f"with one pose{blind} no place on the robot can be told from another; measure more poses"
        return Reason(Why.UNTESTABLE, (one,))
    return None


def beyond(problem: Problem, ready: Prepared, proposal: Proposal) -> float:
    """Log likelihood that a set loses where the coefficient that is furthest out of its physical range moves there.

    The furthest of several that are zero or more may be out by more than a single one.
    """
    estimate, deviation, _ = coefficients(ready.scan, problem.A, problem.y, proposal.entries)
    bank = ready.bank
    sizes = [p for e in proposal.entries for p in bank.parameters(e)[: int(bank.width[e])]]
    value, margin = estimate[problem.A.shape[1] :], deviation[problem.A.shape[1] :]
    low, high = np.array([(p.low, p.high) for p in sizes]).T
    outside = np.maximum(np.maximum(low - value, value - high), 0.0)
    furthest = float(np.max(outside / np.maximum(margin, TINY), initial=0.0))
    return 0.5 * _as_single(furthest, int(np.sum(low >= 0))) ** 2


def _as_single(deviations: float, count: int) -> float:
    """Standard deviations of one size that are as rare as these are of the largest of several."""
    if count < 2 or deviations > _FAR:
        return deviations
    chance = -np.expm1(count * np.log1p(-ndtr(-deviations)))
    return max(float(-ndtri(chance)), 0.0)


def against_sigma(outcome: Outcome, report: NoiseReport) -> Outcome:
    """Nothing is named missing, and yet the residual contradicts the stated sigma: that is not an explained table."""
    limit = REPEATABILITY if report.single else CONTRADICTED
    if outcome.verdict != NOTHING or report.ratio_interval is None or report.ratio_interval[0] < limit:
        return outcome
    because = report.settles or Reason(Why.SIGMA, (f"{report.ratio:.1f}",))
    return replace(outcome, verdict=UNEXPLAINED, because=because)


def _written(
    problem: Problem, candidates: Sequence[Candidate], ready: Prepared, parts: tuple[Stratum, ...],
    allowed: Array, outcome: Outcome, place: Localisation, proof: HeldOut | None, options: Options,
    tell: Callable[[str], None],
) -> Diagnosis:  # fmt: skip
    scan: Scan = ready.scan
    tell("growth")
    growth = steps(problem, ready, outcome.admissible[0] if outcome.admissible else None, allowed, outcome)
    somewhere = outcome.because.why not in (Why.ONE_STRATUM, Why.SIGMA, Why.SETTLES)
    open_end = outcome.verdict == UNEXPLAINED and somewhere
    law = _law(problem, scan, outcome.found, place) if open_end else None
    device = _device(problem, scan, outcome.found, place.accused) if open_end else None
    names, D = confusion(ready, outcome)
    return Diagnosis(
        outcome.verdict, outcome.because, named_effects(problem, ready, outcome),
        candidate_table(problem, candidates, ready, allowed, outcome, options),
        outcome.p_named, outcome.p_unnamed, ready.report, parts, place, law, device, growth,
        Rms(growth[0].rms, growth[-1].rms, proof.before if proof else None, proof.after if proof else None,
            noise_floor(ready)),
        proof, D, names, leading(problem, ready, outcome), alike(ready, outcome),
        inconstancies(problem, ready, outcome.admissible[0].entries) if outcome.admissible else (),
        rival(ready, outcome), None if outcome.verdict in (INSUFFICIENT, UNEXPLAINED) else _weights(ready, outcome),
    )  # fmt: skip


def _weights(ready: Prepared, outcome: Outcome) -> Noise:
    """The noise, the sharing first that is likeliest beside the leading set."""
    noise = ready.scan.noise
    first = outcome.admissible[0].sharing if outcome.admissible else ready.scan.best.sharing
    return replace(noise, sharings=(first, *(s for s in noise.sharings if s != first)))


def _proof(
    problem: Problem, ready: Prepared, allowed: Array, outcome: Outcome, options: Options,
    tell: Callable[[str], None],
) -> HeldOut | None:  # fmt: skip
    """How the poses that are left out are predicted; None where no other pose can tell."""
    sets = [judged.entries for judged in outcome.admissible]
    found = sets[0] if sets else ()
    # what is in one pose each no other pose can prove
    if not options.held_out or 0 < len(found) == len(poses_of_their_own(problem, ready.bank, found)):
        return None
    tell("proof")
    return held_out(
        problem, ready.bank, _weights(ready, outcome).alone, noise_floor(ready), sets, allowed, options
    )


def doubted(outcome: Outcome, proof: HeldOut) -> Outcome:
    """The verdict where poses that were left out speak against a name: it says no more than who leads.

    Or where they do not confirm it, and a law without a name that does the same explains more. A member of a set
    without which they are better predicted is an even bet.
    """
    law = outcome.admissible[0].rivals.alike if outcome.verdict == NAMED else None
    if proof.refutes and outcome.verdict in (NAMED, AMBIGUOUS):
        why = Why.REFUTED
    elif proof.after >= proof.before and law is not None and law.lead > AS_MUCH:
        why = Why.AS_WELL
    else:
        doubts = proof.spoken_against or (False,) * len(outcome.confidence)
        bets = zip(outcome.confidence, doubts, strict=True)
        return replace(outcome, confidence=tuple(min(c, EVEN) if doubt else c for c, doubt in bets))
    even = tuple(min(c, EVEN) for c in outcome.confidence)
    return replace(
        outcome, verdict=INSUFFICIENT, because=Reason(why), admissible=outcome.admissible[:1], confidence=even
    )


def _law(problem: Problem, scan: Scan, found: Evidence, place: Localisation) -> FittedLaw | None:
    """The best smooth law at the accused virtual joint; at the next best ones where there is none."""
    if any(place.accused == law.place for law in problem.devices):
        return None
    names = dict.fromkeys([place.accused, *(b.virtual_joint for b in place.back_projections[:_NEXT])])
    laws = (best_law(problem, with_law(scan, found, name), name) for name in names)
    return next((law for law in laws if law is not None), None)


def _device(problem: Problem, scan: Scan, found: Evidence, place: str) -> FittedDevice | None:
    """The best law at a place that is no virtual joint."""
    return device_law(problem, with_law(scan, found, place), found, place)


def _exact(problem: Problem) -> bool:
    """Whether the model leaves nothing but rounding, among which tests would find something."""
    basis = column_space(problem.A)
    left = problem.y - basis @ (basis.T @ problem.y)
    return bool(np.linalg.norm(left) < ROUNDING * np.linalg.norm(problem.y))


def _without_tests(
    verdict: str, problem: Problem, candidates: Sequence[Candidate], because: Reason
) -> Diagnosis:
    ready = prepare(problem, ())
    rms = float(np.sqrt(np.mean(ready.residual**2)))
    p = float("nan") if verdict == UNTESTABLE else 1.0
    return Diagnosis(
        verdict, because, (), unavailable(candidates, str(because)), p, p, ready.report, (), None, None, None, (),
        Rms(rms, rms, None, None, ready.report.sigma), None, np.zeros((0, 0)), (),
    )  # fmt: skip
