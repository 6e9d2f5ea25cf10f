"""Optimality criteria of a design, and what one more pose would bring, for a hundred thousand poses at once.

A design's information matrix is M = Σ BᵀB over its poses, B the whitened rows (m, P). Two families:

- D-optimality: maximise log det M, the volume of the confidence ellipsoid;
- linear criteria: minimise tr(M⁻¹ L). L = I is A-optimality (the mean variance of the scaled parameters);
  L = mean of A0ᵀA0 over test poses is the expected squared error there after compensation, the
  industry-oriented measure of Wu, Klimchik et al. (2013) to which the seed refers.

Every function works with scores, which a better design has higher: log det M, or -tr(M⁻¹ L).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from symstiff.calibration.planning.parallel import slices
from symstiff.threads import in_threads

_CHUNK = 4096  # candidates at a time: their rows stay in the cache
_FIRST = 128  # candidates of a chunk that are evaluated before the others
_RUN = 4  # chunks that share a running best; fixed, so that threads do not change which candidate wins


@dataclass(frozen=True)
class Criterion:
    """``name`` D, A or test; ``weight`` L (P, P), symmetric positive semidefinite, None for D-optimality."""

    name: str
    weight: np.ndarray | None = None

    def score(self, information: np.ndarray) -> float:
        """Return log det M or -tr(M⁻¹ L); -inf where M is singular."""
        try:
            factor = np.linalg.cholesky(information)
        except np.linalg.LinAlgError:
            return -np.inf
        if self.weight is None:
            return float(2.0 * np.log(np.diag(factor)).sum())
        half = np.linalg.solve(factor, self.weight)
        return -float(np.trace(np.linalg.solve(factor.T, half)))

    def gradient(self, information: np.ndarray) -> np.ndarray:
        """Return the symmetric matrix G with d(score) = tr(G dM): M⁻¹, or M⁻¹ L M⁻¹."""
        inverse = np.linalg.inv(information)
        matrix = inverse if self.weight is None else inverse @ self.weight @ inverse
        return np.asarray(0.5 * (matrix + matrix.T))

    def efficiency(self, score: float, reference: float, parameters: int) -> float:
        """Return how good a score is relative to a reference: the factor by which fewer poses would do."""
        if self.weight is None:
            return float(np.exp((score - reference) / parameters))
        return float(reference / score)

    def bound(self, score: float, largest: float, poses: int, parameters: int) -> float:
        """Return a score that no exact design of the candidate set exceeds (equivalence theorem).

        ``score`` is that of an approximate design whose weights sum to ``poses``; ``largest`` the greatest
        directional derivative tr(G BᵀB) over all candidates. From the concavity of det^(1/P) and of 1/tr.
        """
        if self.weight is None:
            return score + parameters * float(np.log(max(1.0, largest * poses / parameters)))
        return -(score**2) / max(-score, largest * poses)


@dataclass(frozen=True)
class Basis:
    """Coordinates in which M is the identity and L diagonal: U UᵀM = I, Uᵀ L U = diag(spread)."""

    U: np.ndarray
    spread: np.ndarray | None


def basis(criterion: Criterion, information: np.ndarray) -> Basis:
    """Return the coordinates of a non-singular information matrix (P, P)."""
    inverse = np.linalg.inv(np.linalg.cholesky(information))
    if criterion.weight is None:
        return Basis(np.ascontiguousarray(inverse.T), None)
    spread, rotation = np.linalg.eigh(inverse @ criterion.weight @ inverse.T)
    return Basis(np.ascontiguousarray(inverse.T @ rotation), np.maximum(spread, 0.0))


def information_of(rows: np.ndarray) -> np.ndarray:
    """Return Σ BᵀB of whitened rows (m, K, P), summed in the given order."""
    flat = rows.reshape(-1, rows.shape[2])
    return np.asarray(flat.T @ flat)


def gains(rows: np.ndarray, coordinates: Basis) -> np.ndarray:
    """Return by how much every candidate (m, N, P) raises the score when added, (N,): a rank-m update each.

    With Z = B U: log det(I + Z Zᵀ), or tr((I + Z Zᵀ)⁻¹ Z diag(spread) Zᵀ).
    """
    parts = [_gains_of(rows[:, cut] @ coordinates.U, coordinates.spread) for cut in _chunks(rows)]
    return np.concatenate(parts)


def directional(rows: np.ndarray, coordinates: Basis) -> np.ndarray:
    """Return tr(G BᵀB) of every candidate, (N,): the score's derivative towards it."""
    parts = in_threads(
        lambda cut: _sensitivity(rows[:, cut] @ coordinates.U, coordinates.spread), _chunks(rows)
    )
    return np.concatenate(parts)


def best_gain(
    rows: np.ndarray, coordinates: Basis, to_beat: float, barred: np.ndarray | None = None
) -> tuple[int, float]:
    """Return the candidate of the largest gain above ``to_beat`` and that gain, or (-1, ``to_beat``).

    ``barred`` (N,) excludes candidates. Exact: a candidate is skipped only where an upper bound of its gain
    (Hadamard's inequality) does not reach the best one found so far. Same inputs, same candidate.
    """
    chunks = _chunks(rows)
    runs = [chunks[start : start + _RUN] for start in range(0, len(chunks), _RUN)]
    found = in_threads(lambda run: _best_of(rows, run, coordinates, to_beat, barred), runs)
    winner, best = -1, to_beat
    for index, gain in found:
        if gain > best:
            winner, best = index, gain
    return winner, best


def _best_of(
    rows: np.ndarray, chunks: list[slice], coordinates: Basis, to_beat: float, barred: np.ndarray | None
) -> tuple[int, float]:
    winner, best = -1, to_beat
    for cut in chunks:
        image = rows[:, cut] @ coordinates.U
        bound = _gain_bound(image, coordinates.spread)
        if barred is not None:
            bound[barred[cut]] = -np.inf
        hopeful = np.flatnonzero(bound > best)
        hopeful = hopeful[np.argsort(-bound[hopeful], kind="stable")]
        for index in (hopeful[:_FIRST], hopeful[_FIRST:]):  # the most promising ones spare the others
            index = np.sort(index[bound[index] > best])
            if not len(index):
                continue
            found = _gains_of(image[:, index], coordinates.spread)
            top = int(found.argmax())
            if found[top] > best:
                winner, best = cut.start + int(index[top]), float(found[top])
    return winner, best


def _chunks(rows: np.ndarray) -> list[slice]:
    return list(slices(rows.shape[1], _CHUNK))


def _sensitivity(image: np.ndarray, spread: np.ndarray | None) -> np.ndarray:
    if spread is None:
        return np.asarray(np.einsum("mnp,mnp->n", image, image))
    return np.asarray(np.einsum("mnp,mnp->np", image, image) @ spread)


def _gain_bound(image: np.ndarray, spread: np.ndarray | None) -> np.ndarray:
    if spread is None:
        m = len(image)
        norms = np.einsum("mnp,mnp->mn", image, image)
        return np.asarray(np.log1p(norms).sum(axis=0)) * (1 + 1e-12) if m else norms
    squares = np.einsum("mnp,mnp->np", image, image)
    return np.asarray((squares / (1.0 + squares)) @ spread) * (1 + 1e-12)


def _gains_of(image: np.ndarray, spread: np.ndarray | None) -> np.ndarray:
    factor = _cholesky(_products(image, image, identity=True))
    if spread is None:
        return np.asarray(2.0 * sum(np.log(factor[a][a]) for a in range(len(image))))
    return _trace_of_quotient(factor, _products(image, image * spread, identity=False))


def _products(left: np.ndarray, right: np.ndarray, identity: bool) -> list[list[np.ndarray]]:
    m = len(left)
    return [
        [
            np.einsum("np,np->n", left[a], right[b]) + (1.0 if identity and a == b else 0.0)
            for b in range(a + 1)
        ]
        for a in range(m)
    ]


def _cholesky(gram: list[list[np.ndarray]]) -> list[list[np.ndarray]]:
    """Cholesky factors of N small matrices, entry by entry: each entry is one array over all candidates."""
    factor: list[list[np.ndarray]] = []
    for a, row in enumerate(gram):
        new: list[np.ndarray] = []
        for b in range(a):
            rest = row[b] - sum(new[k] * factor[b][k] for k in range(b))
            new.append(rest / factor[b][b])
        new.append(np.sqrt(row[a] - sum(x * x for x in new)))
        factor.append(new)
    return factor


def _trace_of_quotient(factor: list[list[np.ndarray]], middle: list[list[np.ndarray]]) -> np.ndarray:
    """Return tr((F Fᵀ)⁻¹ H) for N small factors F and symmetric H (lower triangles)."""
    m = len(factor)
    inverse: list[list[np.ndarray]] = []
    for a in range(m):
        row = [-sum(factor[a][k] * inverse[k][b] for k in range(b, a)) / factor[a][a] for b in range(a)]
        inverse.append([*row, 1.0 / factor[a][a]])
    total = np.zeros_like(factor[0][0])
    for a in range(m):
        for b in range(a + 1):
            for c in range(b + 1):
                twice = 1.0 if b == c else 2.0
                total += twice * inverse[a][b] * inverse[a][c] * middle[b][c]
    return total
