"""Shapes between those that are profiled: what a grid of them misses of something that stands out would be seen too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from symstiff.arrays import TINY, Array, Index
from symstiff.calibration.fits.decomposition import column_space
from symstiff.discrepancy.problem import Candidate, Problem
from symstiff.discrepancy.statistics.bank import Bank, build
from symstiff.discrepancy.statistics.evidence import Evidence, evidence
from symstiff.discrepancy.statistics.scan import Layer, Scan, directions, extend, likeliest
from symstiff.effects.base import Move, Shape

WORTH = 2.0
"""Log likelihood that a shape between two has to gain."""
TRAILS, SHARE = 10.0, 0.3
"""Log evidence, and its share of the leader's, by which a candidate or a law of it may trail and still be looked at."""
STEPS = (0.5, 0.25, 0.125)
"""Steps by which a value is moved, over those of its profile."""

More = Mapping[int, Sequence[tuple[Shape, int]]]
"""Further shapes by candidate, each with the number of the shape that it came from."""


def between(scan: Scan, others: tuple[int, ...] = ()) -> More:
    """Shapes that explain clearly more than those of the bank, of the leader beside ``others`` and of its rivals."""
    bank, found = scan.bank, evidence(extend(scan, others))
    score = np.where(bank.generic, -np.inf, found.score)
    score[bank.owner[list(others)]] = -np.inf
    more = {}
    for candidate in np.flatnonzero(score > _trailing(float(np.max(score, initial=-np.inf)))):
        shapes = [
            (shape, int(bank.shape[entry]))
            for entry in _forms(bank, found, int(candidate))
            if (shape := moved(scan, others, entry)) is not None
        ]
        if shapes:
            more[int(candidate)] = shapes
    return more


def with_shapes(problem: Problem, bank: Bank, more: More) -> Bank:
    """The bank with further shapes, each as likely as the one that it came from."""
    grown = [_with(candidate, more.get(k, ())) for k, candidate in enumerate(bank.candidates)]
    named = int(np.sum(~bank.generic))
    return build(problem, grown[:named], grown[named:])


def _with(candidate: Candidate, more: Sequence[tuple[Shape, int]]) -> Candidate:
    new = [(shape, parent) for shape, parent in more if shape not in candidate.shapes]
    weights = candidate.weights or (1.0,) * len(candidate.shapes)
    return replace(
        candidate,
        shapes=(*candidate.shapes, *(shape for shape, _ in new)),
        weights=(*weights, *(weights[parent] for _, parent in new)),
        between=candidate.between + len(new),
    )


def _forms(bank: Bank, found: Evidence, candidate: int) -> list[int]:
    """The best entry of each law in a candidate's profile: shapes that differ by what can be moved are one law."""
    best: dict[str, int] = {}
    known = bank.candidates[candidate]
    for entry in np.flatnonzero((bank.owner == candidate) & (bank.shape < known.profiled)):
        shape = bank.shape_of(int(entry))
        moves = _moves(known, shape)
        law = repr(sorted((key, key in moves or value) for key, value in shape.items()))
        if moves and (law not in best or found.entry[entry] > found.entry[best[law]]):
            best[law] = int(entry)
    top = max((found.entry[e] for e in best.values()), default=0.0)
    return [e for e in best.values() if found.entry[e] > _trailing(float(top))]


def _trailing(top: float) -> float:
    return top - max(TRAILS, SHARE * top)


def moved(scan: Scan, others: tuple[int, ...], entry: int, rows: Index | slice = slice(None)) -> Shape | None:
    """An entry's shape, its values moved as far as that explains more beside ``others``; None where it is not worth it.

    No value goes further than a step, or out of those of its profile, so that a law stays what its name says. ``rows``
    are those of the problem that the scan holds.
    """
    bank = scan.bank
    candidate, origin = bank.candidates[int(bank.owner[entry])], bank.shape_of(entry)
    view = _View.of(scan, others, entry)
    moves = _moves(candidate, origin)
    within = {key: _within(candidate, origin, key, move) for key, move in moves.items()}
    at = dict.fromkeys(moves, 0.0)
    shape, start = origin, view.likelihood(bank.columns[:, bank.slice(entry)])
    value = start
    for step, key, way in product(STEPS, tuple(at), (1.0, -1.0)):
        while abs(at[key] + way * step) <= 1.0:
            steps = {**at, key: at[key] + way * step}
            tried = {**origin, **{k: moves[k](origin[k], s) for k, s in steps.items() if s}}
            if not within[key][0] <= tried[key] <= within[key][1]:
                break
            gained = view.likelihood(candidate.columns(tried)[rows])
            if gained <= value:
                break
            shape, value, at = tried, gained, steps
    return shape if value > start + WORTH else None


@dataclass(frozen=True)
class Alternative:
    """A shape of a law that has one size, with what that is then: in its own unit, and how likely it makes the data."""

    shape: Shape
    value: float
    std: float
    likelihood: float


def alternatives(scan: Scan, others: tuple[int, ...], entry: int) -> tuple[Alternative, ...]:
    """An entry's law in its own shape, first, and with each value elsewhere in its profile, beside ``others``.

    None where it has several sizes, or no value that can be moved.
    """
    bank = scan.bank
    candidate, origin = bank.candidates[int(bank.owner[entry])], bank.shape_of(entry)
    moves = {k: move for k, move in _moves(candidate, origin).items() if not move.around}
    if int(bank.width[entry]) != 1 or not moves:
        return ()
    view = _View.of(scan, others, entry)
    shapes = [origin, *(s for key, move in moves.items() for s in _along(candidate, origin, key, move))]
    columns = ((shape, candidate.columns(shape)) for shape in shapes)
    return tuple(view.alternative(shape, c) for shape, c in columns if np.all(np.isfinite(c)) and np.any(c))


def size_of(scan: Scan, others: tuple[int, ...], entry: int) -> float:
    """The size of an entry that has one, beside ``others``, in its own unit."""
    bank = scan.bank
    shape = bank.shape_of(entry)
    column = bank.candidates[int(bank.owner[entry])].columns(shape)
    return _View.of(scan, others, entry).alternative(shape, column).value


def _along(candidate: Candidate, shape: Shape, key: str, move: Move) -> list[Shape]:
    """The shapes of the profile that differ from one by a value alone, and those half a step beside these and it."""
    low, high = _within(candidate, shape, key, move)
    if not np.isfinite(low):
        return []
    known = {s[key] for s in candidate.shapes if key in s and {**s, key: shape[key]} == dict(shape)} | {
        shape[key]
    }
    values = sorted({move(v, step) for v in known for step in (-0.5, 0.0, 0.5)} - {shape[key]})
    return [{**shape, key: v} for v in values if low <= v <= high]


def _moves(candidate: Candidate, shape: Shape) -> dict[str, Move]:
    return {key: move for key, move in candidate.moves(shape).items() if key in shape}


def _within(candidate: Candidate, shape: Shape, key: str, move: Move) -> tuple[float, float]:
    """The ends of a value's profile: of the shapes that differ from this one by nothing else."""
    rest = {k: v for k, v in shape.items() if k != key}
    alike = [s for s in candidate.shapes[: candidate.profiled] if s.keys() == shape.keys()]
    values = [s[key] for s in alike if {k: v for k, v in s.items() if k != key} == rest]
    return (min(values), max(values)) if len(values) > 1 and not move.around else (-np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class _View:
    """What is left beside some entries, under the shared error that is likeliest with one more."""

    scan: Scan
    layer: Layer
    beside: Array
    """(M, p) orthonormal directions of the other entries."""

    @classmethod
    def of(cls, scan: Scan, others: tuple[int, ...], entry: int) -> _View:
        layer = likeliest(scan, (*others, entry))
        return cls(scan, layer, directions(scan, layer, others)[0])

    def likelihood(self, columns: Array) -> float:
        """Log likelihood with further columns (M, k) in the model, the scale profiled."""
        if not np.all(np.isfinite(columns)):
            return -np.inf
        return self._log_likelihood(self._left_by(column_space(self._white(columns), 1e-7)))

    def alternative(self, shape: Shape, column: Array) -> Alternative:
        """A law's shape with its column (M, 1)."""
        white = self._white(column)
        square = max(float(np.sum(white**2)), TINY)
        left = self._left_by(white / np.sqrt(square))
        value = float(np.sum(white * self.layer.y[:, None])) / square
        return Alternative(
            shape, value, float(np.sqrt(left / self.scan.freedom / square)), self._log_likelihood(left)
        )

    def _white(self, columns: Array) -> Array:
        """Columns (M, k) as the noise whitens them, outside of the model and the other entries."""
        noise = self.scan.noise
        white = noise.apply(self.layer.whiten, columns / noise.spread[:, None])
        for known in (self.layer.basis, self.beside):
            white = white - known @ (known.T @ white)
        return white

    def _left_by(self, directions: Array) -> float:
        """Sum of squares that the other entries and further directions (M, k) leave."""
        found = np.hstack([self.beside, directions])
        return max(self.layer.rss - float(np.sum((found.T @ self.layer.y) ** 2)), TINY)

    def _log_likelihood(self, left: float) -> float:
        return -0.5 * self.scan.freedom * float(np.log(left))
