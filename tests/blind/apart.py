"""How hard a case is, under the noise that the generator knows: what the data tell apart, and what can be named."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import gammaln, ive

from symstiff.calibration.fits.decomposition import column_space
from symstiff.discrepancy.bridge.assemble import Assembly
from symstiff.discrepancy.problem import Candidate
from tests.blind.generate import Case
from tests.blind.score import same

LEVEL = 0.05
"""Share of tables without an effect in which the judge of ``limit`` may speak."""
DRAWS = 1000
_ZERO = 1e-5
"""Length against which a column, or a direction, is nothing."""


@dataclass(frozen=True)
class Outside:
    """What is left of columns (problem rows, k) outside a basis, in units of the noise."""

    hidden: Case
    assembly: Assembly
    basis: np.ndarray

    def white(self, block: np.ndarray) -> np.ndarray:
        """(3·rows, k), whitened by the true noise."""
        view = self.assembly.situation.view
        full = np.zeros((len(self.hidden.signal), 3, block.shape[1]))
        full[view.state, view.component] = block
        return self.hidden.whitened(full).reshape(-1, block.shape[1])

    def left(self, block: np.ndarray) -> np.ndarray:
        """The same, projected off the basis; zero where nothing is left but rounding."""
        found = self.white(block)
        rest = found - self.basis @ (self.basis.T @ found)
        kept = np.linalg.norm(rest, axis=0) > _ZERO * np.linalg.norm(found, axis=0)
        return np.asarray(np.where(kept, rest, 0.0))

    def signal(self, values: np.ndarray) -> np.ndarray:
        """A signal (rows, 6) alike: (3·rows,)."""
        view = self.assembly.situation.view
        return self.left(values[view.state, view.component][:, None])[:, 0]


def outside(hidden: Case, assembly: Assembly, *beside: np.ndarray) -> Outside:
    """Outside the start model and further columns."""
    empty = Outside(hidden, assembly, np.zeros((3 * len(hidden.signal), 0)))
    basis = column_space(empty.white(np.column_stack([assembly.problem.A, *beside])))
    return Outside(hidden, assembly, basis)


def apart(hidden: Case, assembly: Assembly, groups: Any) -> float | None:
    """D: what of a hidden effect's λ the nearest candidate of another name leaves; small means inseparable.

    For an effect outside of the catalogue: what the nearest candidate leaves, of any name. Of two hidden effects
    the smaller D, with the other one's candidate beside the model.
    """
    truth = hidden.label.truth
    if not np.any(hidden.signal) or len(hidden.parts) > 2 or (len(hidden.parts) == 2) != (len(truth) == 2):
        return None
    if len(hidden.parts) < 2:
        lam = max(hidden.label.noncentrality, default=0.0)
        return lam * _least_left(hidden, hidden.signal, assembly, groups, ())
    found = []
    for k, (signal, lam) in enumerate(zip(hidden.parts, hidden.label.noncentrality, strict=True)):
        beside = _nearest(hidden.parts[1 - k], assembly, groups, truth[1 - k])
        found.append(lam * _least_left(hidden, signal, assembly, groups, beside))
    return min(found)


def _least_left(
    hidden: Case, values: np.ndarray, assembly: Assembly, groups: Any, beside: tuple[np.ndarray, ...]
) -> float:
    """Share of a signal (rows, 6) outside the model that the nearest candidate which is not the truth leaves."""
    space = outside(hidden, assembly, *beside)
    signal = space.signal(values)
    least = 1.0
    for candidate in assembly.candidates:
        if candidate.unavailable or _true(candidate, hidden, groups):
            continue
        for shape in candidate.shapes:
            own = column_space(space.left(candidate.columns(shape)), _ZERO)
            rest = signal - own @ (own.T @ signal)
            least = min(least, float(rest @ rest / max(signal @ signal, 1e-300)))
    return least


def _nearest(
    values: np.ndarray, assembly: Assembly, groups: Any, truth: tuple[str, Any]
) -> tuple[np.ndarray, ...]:
    """Columns of the true candidate's shape that is nearest to a signal; none where the catalogue lacks it."""
    view = assembly.situation.view
    model = column_space(assembly.problem.A, 1e-8)
    signal = values[view.state, view.component]
    signal = signal - model @ (model.T @ signal)
    best: tuple[float, tuple[np.ndarray, ...]] = (np.inf, ())
    for candidate in assembly.candidates:
        if candidate.unavailable or not same((candidate.effect, candidate.where), truth, groups):
            continue
        for shape in candidate.shapes:
            block = candidate.columns(shape)
            own = column_space(block - model @ (model.T @ block), 1e-8)
            rest = signal - own @ (own.T @ signal)
            if float(rest @ rest) < best[0]:
                best = (float(rest @ rest), (block,))
    return best[1]


def limit(hidden: Case, assembly: Assembly, groups: Any) -> float | None:
    """Share of repetitions of a case in which a judge who knows noise and λ would name what is hidden.

    The judge weighs the catalogue by exact likelihoods, every effect alike and its places alike, and speaks where the
    greatest is above what ``LEVEL`` of the tables without an effect reach. A reference and no strict bound: places
    and directions are weighed as the catalogue has them, not as the generator draws them. Of two effects the judge
    is told one and names the other, each in turn, without having to ask whether there is another.
    """
    truth, parts = hidden.label.truth, hidden.parts
    if len(parts) not in (1, 2) or len(parts) != len(truth) or not np.any(hidden.signal):
        return None
    errors = np.random.default_rng(0).standard_normal((3 * len(hidden.signal), DRAWS))
    right = np.ones(DRAWS, bool)
    for k, t in enumerate(truth):
        told = [_nearest(p, assembly, groups, truth[i]) for i, p in enumerate(parts) if i != k]
        right &= _judged(outside(hidden, assembly, *(c for found in told for c in found)), groups, t, errors)
    return float(np.mean(right))


def _judged(space: Outside, groups: Any, truth: tuple[str, Any], errors: np.ndarray) -> np.ndarray:
    """(B,) whether the judge names an effect in the hidden signal and each of the errors (M, B)."""
    told = [t for t in space.hidden.label.truth if t is not truth]
    there = [
        c
        for c in space.assembly.candidates
        if not c.unavailable and not any(same((c.effect, c.where), t, groups) for t in told)
    ]
    right = np.array([same((c.effect, c.where), truth, groups) for c in there])
    signal = space.signal(space.hidden.signal)
    lam = float(signal @ signal)

    def weights(data: np.ndarray) -> np.ndarray:
        return np.stack([_weight(c, space, lam, data) for c in there]) + _prior(there)[:, None]

    heard = weights(errors + signal[:, None])
    named = right[heard.argmax(axis=0)]
    if len(space.hidden.parts) > 1:
        return np.asarray(named)
    threshold = np.quantile(weights(errors).max(axis=0), 1.0 - LEVEL)
    return np.asarray(named & (heard.max(axis=0) > threshold))


def _true(candidate: Candidate, hidden: Case, groups: Any) -> bool:
    return any(same((candidate.effect, candidate.where), t, groups) for t in hidden.label.truth)


def _prior(there: list[Candidate]) -> np.ndarray:
    """Log weights: every effect the same, divided among its places."""
    effects = [c.effect for c in there]
    return -np.log([len(set(effects)) * effects.count(e) for e in effects])


def _weight(candidate: Candidate, space: Outside, lam: float, errors: np.ndarray) -> np.ndarray:
    """Log likelihood ratio (B,) of a candidate of size λ against noise (M, B), its shapes alike."""
    found = []
    for shape in candidate.shapes:
        block = space.left(candidate.columns(shape))
        own = column_space(block, _ZERO) if np.any(block) else block[:, :0]
        if own.shape[1]:
            seen = (own.T @ errors) ** 2
            found.append(
                np.logaddexp(_alike(seen, lam), _usual(candidate, shape, block, lam, errors)) - np.log(2)
            )
    return (
        np.logaddexp.reduce(found, axis=0) - np.log(len(found))
        if found
        else np.full(errors.shape[1], -np.inf)
    )


def _alike(seen: np.ndarray, lam: float) -> np.ndarray:
    """All directions of the space as likely, |signal|² = λ: a Bessel function of √(λ·what the space explains)."""
    half = 0.5 * len(seen)
    x = np.sqrt(lam * seen.sum(axis=0))
    bessel = np.log(ive(half - 1.0, x)) + x
    return np.asarray(-0.5 * lam + gammaln(half) + (1.0 - half) * np.log(0.5 * x) + bessel)


def _usual(candidate: Candidate, shape: Any, block: np.ndarray, lam: float, errors: np.ndarray) -> np.ndarray:
    """Parameters normal about zero with their usual sizes, mean square of the signal λ."""
    size = np.array([p.typical for p in candidate.parameters_at(shape)])
    if len(size) != block.shape[1] or not np.all(size > 0):
        size = np.ones(block.shape[1])
    U, s, _ = np.linalg.svd(block * size, full_matrices=False)
    gain = lam * s**2 / np.sum(s**2)
    return np.asarray(0.5 * (gain / (1.0 + gain)) @ (U.T @ errors) ** 2 - 0.5 * float(np.sum(np.log1p(gain))))
