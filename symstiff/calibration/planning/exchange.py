"""The choice of N poses among the candidates: a start, then exchange until nothing improves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from symstiff.calibration.planning.approximate import Approximate
from symstiff.calibration.planning.criteria import Criterion, basis, best_gain, gains, information_of
from symstiff.errors import UserError

_RELATIVE = 1e-9  # an exchange has to improve by more than rounding
_SWEEPS = 50


@dataclass(frozen=True)
class Selection:
    """Indices of the chosen candidates, the score, and the score after every step (non-decreasing)."""

    chosen: tuple[int, ...]
    score: float
    history: tuple[float, ...]


def exchange(
    rows: np.ndarray,
    start: tuple[int, ...],
    criterion: Criterion,
    ridge: float = 0.0,
    labels: np.ndarray | None = None,
) -> Selection:
    """Exchange chosen candidates for better ones until a whole sweep changes nothing (Fedorov's k-exchange).

    ``rows`` (m, N, P); ``labels`` (N, g): every value of every column that ``start`` covers stays covered.
    One pose leaves; the gain of every candidate on what remains is a rank-m update; the best one enters.
    """
    labels = np.zeros((rows.shape[1], 0), dtype=np.int64) if labels is None else labels
    chosen = list(start)
    history = [criterion.score(information_of(rows[:, chosen]) + ridge * np.eye(rows.shape[2]))]
    for _ in range(_SWEEPS):
        before = tuple(chosen)
        for position in range(len(chosen)):
            _exchange_one(rows, chosen, position, criterion, ridge, labels, history)
        if tuple(chosen) == before:
            break
    return Selection(tuple(sorted(chosen)), history[-1], tuple(history))


def _exchange_one(
    rows: np.ndarray,
    chosen: list[int],
    position: int,
    criterion: Criterion,
    ridge: float,
    labels: np.ndarray,
    history: list[float],
) -> None:
    rest = chosen[:position] + chosen[position + 1 :]
    information = information_of(rows[:, rest]) + ridge * np.eye(rows.shape[2])
    candidates = _keeping_levels(labels, chosen, rest)
    barred = _barred(rows.shape[1], rest, candidates)
    old = chosen[position]
    try:
        coordinates = basis(criterion, information)
    except np.linalg.LinAlgError:
        return
    own = float(gains(rows[:, [old]], coordinates)[0])
    new, _ = best_gain(rows, coordinates, own + _RELATIVE * abs(own), barred)
    if new < 0:
        return
    trial = [*chosen[:position], new, *chosen[position + 1 :]]
    score = criterion.score(information_of(rows[:, trial]) + ridge * np.eye(rows.shape[2]))
    if score > history[-1]:
        chosen[position] = new
        history.append(score)


def greedy(rows: np.ndarray, count: int, criterion: Criterion, ridge: float) -> tuple[int, ...]:
    """Choose candidates one by one, each the best addition so far; ``ridge`` carries the first steps."""
    chosen: list[int] = []
    information = ridge * np.eye(rows.shape[2])
    while len(chosen) < count:
        barred = _barred(rows.shape[1], chosen, None)
        new, _ = best_gain(rows, basis(criterion, information), -np.inf, barred)
        chosen.append(new)
        information = information + information_of(rows[:, [new]])
    return tuple(chosen)


def random_start(count: int, design: Approximate, rng: np.random.Generator) -> tuple[int, ...]:
    """Draw ``count`` different candidates, more likely those of large weight in the approximate design."""
    size = min(count, int(np.count_nonzero(design.weights)))
    drawn = rng.choice(design.support, size, replace=False, p=design.weights)
    others = np.setdiff1d(np.arange(len(design.derivative)), drawn)
    filled = np.concatenate([drawn, rng.choice(others, count - size, replace=False)])
    return tuple(int(i) for i in filled)


def cover_levels(start: tuple[int, ...], labels: np.ndarray, derivative: np.ndarray) -> tuple[int, ...]:
    """Change as few poses of a start as needed for every level to occur: the most promising candidates enter.

    ``labels`` (N, g), ``derivative`` (N,). Raises UserError where no candidate combines the levels needed.
    """
    chosen = list(start)
    for column in range(labels.shape[1]):
        for level in np.unique(labels[:, column]):
            if level in labels[chosen, column]:
                continue
            position = _dispensable(chosen, labels, column)
            same = _matches(labels, chosen, position, column, int(level))
            same[chosen] = False
            index = np.flatnonzero(same)
            if not len(index):
                raise UserError(
                    "no candidate combines the levels wanted of several joints: ask for fewer levels"
                )
            chosen[position] = int(index[derivative[index].argmax()])
    return tuple(chosen)


def pool_of(design: Approximate, size: int, labels: np.ndarray) -> np.ndarray:
    """Return the candidates worth a thorough search, sorted: large derivatives, of every level some."""
    order = np.argsort(-design.derivative, kind="stable")
    parts = [order[:size], design.support]
    for column in range(labels.shape[1]):
        levels = np.unique(labels[:, column])
        parts += [order[labels[order, column] == level][: size // len(levels)] for level in levels]
    return np.unique(np.concatenate(parts))


def _barred(count: int, taken: list[int], candidates: np.ndarray | None) -> np.ndarray:
    barred = np.zeros(count, dtype=bool) if candidates is None else ~candidates
    barred[taken] = True
    return barred


def _keeping_levels(labels: np.ndarray, chosen: list[int], rest: list[int]) -> np.ndarray | None:
    allowed: np.ndarray | None = None
    for column in range(labels.shape[1]):
        lost = np.setdiff1d(labels[chosen, column], labels[rest, column])
        if len(lost):
            same = labels[:, column] == lost[0]
            allowed = same if allowed is None else allowed & same
    return allowed


def _dispensable(chosen: list[int], labels: np.ndarray, column: int) -> int:
    """Position of a pose whose level in ``column`` occurs again, as do most of its other levels."""
    again = [
        [int(np.sum(labels[chosen, c] == labels[i, c]) > 1) for c in range(labels.shape[1])] for i in chosen
    ]
    return int(np.argmax([labels.shape[1] * row[column] + sum(row) for row in again]))


def _matches(labels: np.ndarray, chosen: list[int], position: int, column: int, level: int) -> np.ndarray:
    """Candidates of the wanted level that keep whatever only the leaving pose covers in other columns."""
    rest = chosen[:position] + chosen[position + 1 :]
    wanted = labels[:, column] == level
    for other in range(labels.shape[1]):
        if other != column and labels[chosen[position], other] not in labels[rest, other]:
            wanted &= labels[:, other] == labels[chosen[position], other]
    return np.asarray(wanted)
