"""Every candidate tested at once after projection off the model, by columns that simulated noise can use as well.

The noise's scale and the share of the approach error are profiled or averaged in every test, so that a wrongly
stated sigma changes nothing here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from symstiff.calibration.decomposition import svd
from symstiff.discrepancy.bank import Bank, mixes, orthonormal
from symstiff.discrepancy.marginal import of_groups, of_rank, of_sizes
from symstiff.discrepancy.noise import Noise
from symstiff.discrepancy.problem import Array, Index
from symstiff.discrepancy.sharing import Roots, Sharing
from symstiff.threads import in_threads

Mask = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


@dataclass(frozen=True)
class Layer:
    """All that belongs to one hypothesis of the error that a pose's rows share."""

    sharing: Sharing
    whiten: Roots
    colour: Roots
    y: Array
    """(M,) whitened residual after the model."""
    length2: Array
    """(K,) squared lengths of the whitened bank."""
    left2: Array
    """(K,) the same after projection off the model."""
    basis: Array
    """(M, P') orthonormal basis of the model."""
    Q: Array
    """(M, K) orthonormal bases of the entries outside the model."""
    variance: Array
    """(K,) how the entries' usual sizes spread over the directions of Q; sums to one within an entry."""
    rank: Array
    """(S,)"""
    rss: float
    determinant: float
    """log|V| + log|A' V^-1 A| (restricted likelihood)."""

    @cached_property
    def alive(self) -> Mask:
        """(K,) whether a direction of Q is there."""
        return np.asarray(np.einsum("mk,mk->k", self.Q, self.Q) > 0.5)


@dataclass(frozen=True)
class Scan:
    """A model with the candidates projected off it."""

    bank: Bank
    noise: Noise
    layers: tuple[Layer, ...]
    freedom: int
    """M - rank of the model."""

    @property
    def log_likelihood(self) -> Array:
        """(R,) restricted profile log-likelihood of each sharing."""
        return log_likelihood(self, np.array([layer.rss for layer in self.layers]))

    @property
    def best(self) -> Layer:
        """The layer of the likeliest sharing."""
        return self.layers[int(np.argmax(self.log_likelihood))]


def open_scan(bank: Bank, noise: Noise, y: Array, A: Array) -> Scan:
    """Whiten by every sharing and project data and candidates off the model's column space."""
    basis = column_space(A / noise.spread[:, None])
    together = np.column_stack([y, bank.columns]) / noise.spread[:, None]
    together = np.column_stack([together[:, 0], basis, together[:, 1:]])
    layers = in_threads(
        lambda sharing: _layer(bank, noise, sharing, together, basis.shape[1]), noise.sharings
    )
    return Scan(bank, noise, tuple(layers), len(y) - basis.shape[1])


def column_space(A: Array, tolerance: float = 1e-9) -> Array:
    """Orthonormal basis (M, rank) of the columns of A (M, P), each scaled to unit length first."""
    length = np.linalg.norm(A, axis=0)
    used = A[:, length > 0] / length[length > 0]
    if used.shape[1] == 0:
        return np.zeros((len(A), 0))
    U, s, _ = svd(used)
    return np.asarray(U[:, s > tolerance * s[0]])


def _layer(bank: Bank, noise: Noise, sharing: Sharing, together: Array, rank: int) -> Layer:
    """The layer of a sharing, ``together`` being data, the model's ``rank`` directions and the bank, side by side."""
    whiten = noise.root(sharing, -0.5)
    data = noise.apply(whiten, together)
    y, A, columns = data[:, 0], data[:, 1 : 1 + rank], data[:, 1 + rank :]
    basis, s, _ = svd(A)
    outside = basis @ (basis.T @ columns)
    np.subtract(columns, outside, out=outside)
    residual = y - basis @ (basis.T @ y)
    length2 = np.einsum("mk,mk->k", columns, columns)
    left2 = np.einsum("mk,mk->k", outside, outside)
    Q, variance, found = orthonormal(bank, outside, length2)
    determinant = noise.log_determinant(sharing) + 2.0 * float(np.log(s).sum())
    return Layer(
        sharing, whiten, noise.root(sharing, 0.5), residual, length2, left2, basis, Q, variance, found,
        float(residual @ residual), determinant,
    )  # fmt: skip


def outside(scan: Scan, layer: Layer, entries: Sequence[int]) -> Array:
    """(M, k) whitened columns of some entries, projected off the model."""
    columns = np.hstack([scan.bank.columns[:, scan.bank.slice(e)] for e in entries])
    white = scan.noise.apply(layer.whiten, columns / scan.noise.spread[:, None])
    return np.asarray(white - layer.basis @ (layer.basis.T @ white))


def directions(scan: Scan, layer: Layer, entries: Sequence[int]) -> tuple[Array, Array]:
    """Orthonormal directions (M, p) that entries add to the model, and their sizes (p,)."""
    if not entries:
        return np.zeros((len(layer.y), 0)), np.zeros(0)
    U, s, _ = svd(outside(scan, layer, entries))
    return U[:, s > 1e-7 * s[0]], s[s > 1e-7 * s[0]]


def likeliest(scan: Scan, entries: tuple[int, ...]) -> Layer:
    """The layer of the likeliest sharing once some entries are in the model."""
    if not entries or len(scan.layers) == 1:
        return scan.best
    layers, gained = [], 0
    for layer in scan.layers:
        U, s = directions(scan, layer, entries)
        rss = layer.rss - float(np.sum((U.T @ layer.y) ** 2))
        layers.append(replace(layer, rss=rss, determinant=layer.determinant + 2.0 * float(np.log(s).sum())))
        gained = len(s)
    after = Scan(scan.bank, scan.noise, tuple(layers), scan.freedom - gained)
    return scan.layers[int(np.argmax(after.log_likelihood))]


def one_sharing(scan: Scan) -> Noise:
    """The noise at its likeliest sharing alone."""
    return replace(scan.noise, sharings=(scan.best.sharing,))


def at_sharing(scan: Scan, sharing: Sharing) -> Scan:
    """The scan at one of its sharings."""
    return at_sharings(scan, np.array([layer.sharing == sharing for layer in scan.layers]))


def extend(scan: Scan, entries: tuple[int, ...]) -> Scan:
    """The scan after the columns of some entries have joined the model."""
    if not entries:
        return scan
    layers, gained = zip(*in_threads(lambda layer: _extended(scan, layer, entries), scan.layers), strict=True)
    return Scan(scan.bank, scan.noise, layers, scan.freedom - gained[-1])


def _extended(scan: Scan, layer: Layer, entries: tuple[int, ...]) -> tuple[Layer, int]:
    """A layer after some entries, and the directions that they add."""
    U, s = directions(scan, layer, entries)
    residual = layer.y - U @ (U.T @ layer.y)
    inside = U.T @ layer.Q
    mix = mixes(scan.bank, layer.alive, layer.variance, inside)
    whitened = scan.noise.apply(layer.whiten[::-1], U) / scan.noise.spread[:, None]
    after = replace(
        layer, y=residual, left2=layer.left2 - np.sum((whitened.T @ scan.bank.columns) ** 2, axis=0),
        basis=np.hstack([layer.basis, U]), Q=mix(layer.Q - U @ inside), variance=mix.variance,
        rank=mix.rank, rss=float(residual @ residual),
        determinant=layer.determinant + 2.0 * float(np.log(s).sum()),
    )  # fmt: skip
    return after, len(s)


def likely(scan: Scan, squares: Array, by_way: bool = False, within: float = 5.0) -> Mask:
    """(R,) the sharings within some log-likelihood of the best, or of the best of their way.

    It is enough to be so with or without the best candidate, by what every direction explains (R, K).
    """
    explains = sum_entries(scan.bank, squares.T)
    top = explains.max(axis=0) if explains.size else np.zeros(len(scan.layers))
    rss = np.array([layer.rss for layer in scan.layers])
    ways = np.array([layer.sharing.way for layer in scan.layers])
    kept = np.zeros(len(scan.layers), bool)
    for value in (scan.log_likelihood, log_likelihood(scan, rss - top)):
        best = np.array([value[ways == way].max() if by_way else value.max() for way in ways])
        kept |= value > best - within
    return kept


def at_sharings(scan: Scan, keep: Mask) -> Scan:
    """The scan at some of its sharings."""
    return replace(scan, layers=tuple(la for la, k in zip(scan.layers, keep, strict=True) if k))


def log_likelihood(scan: Scan, rss: Array) -> Array:
    """Restricted log-likelihood with the scale profiled; rss (R, ...) -> (R, ...)."""
    determinant = np.array([layer.determinant for layer in scan.layers])
    shape = (-1,) + (1,) * (rss.ndim - 1)
    return np.asarray(
        -0.5 * scan.freedom * np.log(np.maximum(rss, 1e-300)) - 0.5 * determinant.reshape(shape)
    )


def by_direction(scan: Scan) -> Array:
    """(R, K) squares that each direction of the entries' bases explains of the residual."""
    return np.stack([(layer.Q.T @ layer.y) ** 2 for layer in scan.layers])


def explained(scan: Scan) -> Array:
    """(R, S) sum of squares that each entry explains of the residual."""
    return sum_entries(scan.bank, by_direction(scan).T).T


def sum_entries(bank: Bank, squares: Array) -> Array:
    """Sums over the columns of each entry: (K, B) -> (S, B)."""
    return of_groups(squares, bank.start)


def entry_evidence(scan: Scan, squares: Array, rss: Array) -> Array:
    """Evidence of each entry at its likeliest sharing: squares by direction (R, K, B), rss (R, B) -> (S, B).

    ``rss`` may differ between entries, (R, S, B).
    """
    each = rss.ndim == 3
    weight = log_likelihood(scan, rss)
    weight = weight - weight.max(axis=0)
    total = np.full((len(scan.bank.start), squares.shape[2]), -np.inf)
    for r, layer in enumerate(scan.layers):
        left = np.maximum(rss[r], 1e-300)
        shares = squares[r] / (np.repeat(left, scan.bank.width, axis=0) if each else left)
        total = np.maximum(total, weight[r] + _of_layer(scan.bank, layer, shares, scan.freedom))
    return total


def _of_layer(bank: Bank, layer: Layer, shares: Array, freedom: int) -> Array:
    """Evidence (S, B) of each entry at one sharing, by both beliefs about its directions."""
    share = sum_entries(bank, shares)
    value = np.empty_like(share)
    for rank in np.unique(layer.rank):
        rows = np.flatnonzero(layer.rank == rank)
        value[rows] = of_rank(share[rows], float(rank), freedom)
    sized = np.flatnonzero(bank.sized & (layer.rank > 1))
    if len(sized):
        own = np.concatenate([np.arange(bank.start[e], bank.start[e] + bank.width[e]) for e in sized])
        start = np.concatenate([[0], np.cumsum(bank.width[sized])[:-1]]).astype(np.intp)
        known = of_sizes(shares[own], layer.variance[own], start, freedom)
        value[sized] = np.logaddexp(value[sized], known) - np.log(2.0)
    return value


def candidate_evidence(bank: Bank, entries: Array) -> Array:
    """Average over a candidate's shapes by their prior shares: (S, B) -> (candidates, B)."""
    if not len(bank.start):
        return np.zeros((0, entries.shape[1]))
    first = bank.first_entry
    count = np.diff(np.append(first, len(bank.start)))
    if np.all(count == 1):
        return entries
    top = np.maximum.reduceat(entries, first, axis=0)
    several = np.flatnonzero(count > 1)
    for c in several:
        own = slice(first[c], first[c] + count[c])
        block = entries[own]
        base = np.where(np.isfinite(top[c]), top[c], 0.0)
        with np.errstate(divide="ignore"):
            top[c] = base + np.log(bank.share[own] @ np.exp(block - base))
    return np.asarray(top)


@dataclass(frozen=True)
class Evidence:
    """Evidence on the data."""

    entry: Array
    """(S,)"""
    candidate: Array
    """(candidates,) without the prior."""
    score: Array
    """(candidates,) with the catalogue-size penalty."""
    best_entry: Index
    """(candidates,) likeliest shape of each, with its prior share."""


def evidence(scan: Scan) -> Evidence:
    """Evidence for every candidate given the data."""
    return of_squares(scan, by_direction(scan))


def of_squares(scan: Scan, squares: Array) -> Evidence:
    """Evidence from what each direction explains at each sharing, (R, K)."""
    rss = np.array([[layer.rss] for layer in scan.layers])
    entry = entry_evidence(scan, squares[:, :, None], rss)
    candidate = candidate_evidence(scan.bank, entry)[:, 0]
    entry = entry[:, 0]
    first, likely = scan.bank.first_entry, entry + np.log(np.maximum(scan.bank.share, 1e-300))
    ends = zip(first, np.append(first[1:], len(entry)), strict=True)
    best = np.array([a + int(np.argmax(likely[a:b])) for a, b in ends], dtype=np.intp)
    return Evidence(entry, candidate, candidate + scan.bank.log_prior, best)


def coefficients(scan: Scan, A: Array, y: Array, entries: tuple[int, ...]) -> tuple[Array, Array, Array]:
    """Joint least squares of model and entries at the sharing that is likeliest with them.

    Returns estimates (P + k,), their standard deviations, and the fitted values (M,) in the data's unit.
    Directions of the model that the data do not hold are left at their least-norm value, with infinite
    standard deviation where they touch a parameter.
    """
    layer = likeliest(scan, entries)
    D = scan.noise.spread[:, None]
    chosen = [scan.bank.columns[:, scan.bank.slice(e)] for e in entries]
    X = np.hstack([A, *chosen])
    W = scan.noise.apply(layer.whiten, np.column_stack([y, X]) / D)
    length = np.linalg.norm(W[:, 1:], axis=0)
    length[length == 0] = 1.0
    U, s, Vt = svd(W[:, 1:] / length)
    keep = s > 1e-9 * s.max(initial=0.0)
    beta = Vt[keep].T @ ((U[:, keep].T @ W[:, 0]) / s[keep])
    residual = W[:, 0] - W[:, 1:] @ (beta / length)
    scale2 = float(residual @ residual) / max(len(y) - int(keep.sum()), 1)
    variance = np.einsum("kp,k->p", Vt[keep] ** 2, scale2 / s[keep] ** 2)
    lost = np.einsum("kp->p", Vt[~keep] ** 2) > 1e-6
    deviation = np.where(lost, np.inf, np.sqrt(variance))
    estimate = beta / length
    fitted = X @ estimate
    unit = np.concatenate([np.ones(A.shape[1]), *(scan.bank.scale[scan.bank.slice(e)] for e in entries)])
    return estimate / unit, deviation / length / unit, fitted
