"""Every candidate tested at once after projection off the model, by columns that simulated noise can use as well.

The noise's scale and the share of the approach error are profiled or averaged in every test, so that a wrongly
stated sigma changes nothing here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from symstiff.arrays import TINY, Array, Mask
from symstiff.calibration.fits.decomposition import RANK, column_space, unit_columns
from symstiff.discrepancy.noise.blocks import Roots
from symstiff.discrepancy.noise.scales import Noise
from symstiff.discrepancy.noise.sharing import Sharing
from symstiff.discrepancy.statistics.bank import Bank
from symstiff.discrepancy.statistics.bases import Bases, Single, bases_of, inner
from symstiff.discrepancy.statistics.marginal import of_groups
from symstiff.reduction.svd import svd
from symstiff.threads import in_threads

_ROWS = 128
"""Rows whose columns are worked on together, so that they stay near the processor."""
OWN = 1e-7
"""Singular value, of the largest one, that is rounding of what a model leaves of columns of unit length, of which it is
a larger share than of the columns."""
_TOUCHED = 1e-6
"""Square of a parameter's part in directions that are not held from which it is not determined."""
_NEAR = 5.0
"""Log likelihood by which a sharing may trail the best."""


@dataclass(frozen=True, eq=False)
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
    bases: Bases
    """Of the entries outside the model."""
    rss: float
    determinant: float
    """log|V| + log|A' V^-1 A| (restricted likelihood)."""


@dataclass(frozen=True, eq=False)
class Scan:
    """A model with the candidates projected off it."""

    bank: Bank
    noise: Noise
    columns: Array
    """(M, K) the bank in units of the noise, what readings share taken out: all sharings begin with it."""
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

    @cached_property
    def squares(self) -> Array:
        """(R, K) what each direction of the entries' bases explains of the residual."""
        seen = self.seen([layer.y[:, None] for layer in self.layers])
        return np.stack([along[:, 0] ** 2 for along in seen])

    def seen(self, vectors: Sequence[Array]) -> list[Array]:
        """For every layer the products (K, B) of the entries' bases with whitened vectors (M, B) outside the model."""
        return [layer.bases(x) for layer, x in zip(self.layers, self.products(vectors), strict=True)]

    def products(self, vectors: Sequence[Array]) -> list[Array]:
        """The same with the entries' whitened columns."""
        whitened = [back(self.noise, la.sharing, x) for la, x in zip(self.layers, vectors, strict=True)]
        ends = np.cumsum([x.shape[1] for x in whitened])[:-1]
        return np.split(self.columns.T @ np.hstack(whitened), ends, axis=1)

    @cached_property
    def single(self) -> Single:
        """The columns in single precision: for simulated noise, of which they explain little."""
        return self.columns.astype(np.float32)


def back(noise: Noise, sharing: Sharing, X: Array) -> Array:
    """Whitened rows (M, k) once more whitened by what a pose's rows share: products with columns that are not."""
    return noise.apply(noise.shared(sharing, -0.5), X)


def open_scan(bank: Bank, noise: Noise, y: Array, A: Array) -> Scan:
    """Whiten by every sharing and project data and candidates off the model's column space."""
    basis = column_space(A / noise.spread[:, None])
    own = noise.own(-0.5)
    first = noise.apply(own, np.column_stack([y / noise.spread, basis]))
    columns = noise.apply(own, bank.columns / noise.spread[:, None])
    whole = _whitened_products(bank, noise, columns)
    layers = in_threads(
        lambda sharing: _layer(bank, noise, sharing, first, columns, whole[sharing]), noise.sharings
    )
    return Scan(bank, noise, columns, tuple(layers), len(y) - basis.shape[1])


def _whitened_products(bank: Bank, noise: Noise, columns: Array) -> Mapping[Sharing, Array]:
    """For every sharing the products (K + Q,) of whitened columns: the hypotheses of one way differ by weights."""
    ways = list(dict.fromkeys(sharing.way for sharing in noise.sharings))

    def of_way(way: str) -> dict[Sharing, Array]:
        own = [sharing for sharing in noise.sharings if sharing.way == way]
        found = _weighted(bank, noise.ways[way], columns, np.array([sharing.ratio for sharing in own]))
        return dict(zip(own, found, strict=True))

    return {sharing: found for part in in_threads(of_way, ways) for sharing, found in part.items()}


def _weighted(bank: Bank, blocks: Roots, columns: Array, ratios: Array) -> Array:
    """(R, K + Q) products of columns (M, K) by (I + ratio·blocks)⁻¹: along the blocks' directions, and beside them."""
    total = np.zeros((len(ratios), columns.shape[1] + len(bank.pairs[0])))
    for rows, U, value in blocks:
        weight = 1.0 / (1.0 + ratios[:, None, None] * value)
        at_once = max(1, _ROWS // rows.shape[1])
        for k in range(0, len(rows), at_once):
            some = slice(k, k + at_once)
            part = columns[rows[some]]
            along = np.matmul(U[some].transpose(0, 2, 1), part)
            part -= np.matmul(U[some], along)
            beside, through = (x.reshape(x.shape[0] * x.shape[1], x.shape[2]) for x in (part, along))
            total += inner(bank, beside, np.ones((1, len(beside))))
            total += inner(bank, through, weight[:, some].reshape(len(ratios), -1))
    return total


def _layer(bank: Bank, noise: Noise, sharing: Sharing, first: Array, columns: Array, whole: Array) -> Layer:
    """The layer of a sharing, from data and the model's directions side by side, and products of all columns."""
    data = noise.apply(noise.shared(sharing, -0.5), first)
    basis, triangle = np.linalg.qr(data[:, 1:])
    residual = data[:, 0] - basis @ (basis.T @ data[:, 0])
    inside = back(noise, sharing, basis).T @ columns
    left = whole - inner(bank, inside, np.ones((1, len(inside))))[0]
    length2 = whole[: columns.shape[1]]
    determinant = noise.log_determinant(sharing) + 2.0 * float(np.log(np.abs(np.diag(triangle))).sum())
    return Layer(
        sharing, noise.root(sharing, -0.5), noise.root(sharing, 0.5), residual, length2,
        np.maximum(left[: len(length2)], 0.0), basis, bases_of(bank, left, length2),
        float(residual @ residual), determinant,
    )  # fmt: skip


def outside(scan: Scan, layer: Layer, entries: Sequence[int]) -> Array:
    """(M, k) whitened columns of some entries, projected off the model."""
    white = back(scan.noise, layer.sharing, np.hstack([scan.columns[:, scan.bank.slice(e)] for e in entries]))
    return np.asarray(white - layer.basis @ (layer.basis.T @ white))


def basis_of(scan: Scan, layer: Layer, entry: int) -> Array:
    """(M, w) orthonormal basis of an entry outside the model, whitened; zero where nothing is left of a direction."""
    return np.asarray(outside(scan, layer, [entry]) @ layer.bases.mix(scan.bank.slice(entry)))


def directions(scan: Scan, layer: Layer, entries: Sequence[int]) -> tuple[Array, Array]:
    """Orthonormal directions (M, p) that entries add to the model, and their sizes (p,)."""
    if not entries:
        return np.zeros((len(layer.y), 0)), np.zeros(0)
    U, s, _ = svd(outside(scan, layer, entries))
    own = s > OWN * s[0]
    return U[:, own], s[own]


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
    after = replace(scan, layers=tuple(layers), freedom=scan.freedom - gained)
    return scan.layers[int(np.argmax(after.log_likelihood))]


def one_sharing(scan: Scan) -> Noise:
    """The noise at its likeliest sharing alone."""
    return replace(scan.noise, sharings=(scan.best.sharing,))


def at_sharing(scan: Scan, sharing: Sharing) -> Scan:
    """The scan at one of its sharings."""
    return at_sharings(scan, np.array([layer.sharing == sharing for layer in scan.layers]))


def alone(scan: Scan, candidate: int) -> Scan:
    """The scan of one candidate."""
    bank, columns, own = scan.bank, scan.bank.columns_in(candidate), scan.bank.entries_of(candidate)
    layers = (
        replace(la, length2=la.length2[columns], left2=la.left2[columns], bases=la.bases.alone(columns, own))
        for la in scan.layers
    )
    return Scan(bank.alone(candidate), scan.noise, scan.columns[:, columns], tuple(layers), scan.freedom)


def extend(scan: Scan, entries: tuple[int, ...], part: Scan | None = None) -> Scan:
    """The scan, or a part of its candidates, after the columns of some of its entries have joined the model."""
    part = scan if part is None else part
    if not entries:
        return part
    bank = part.bank.beside(scan.bank, [int(scan.bank.owner[e]) for e in entries])
    found = [directions(scan, layer, entries) for layer in scan.layers]
    products = part.products([U for U, _ in found])
    layers = (
        _extended(bank, layer, U, s, seen)
        for layer, (U, s), seen in zip(part.layers, found, products, strict=True)
    )
    return replace(part, bank=bank, layers=tuple(layers), freedom=part.freedom - len(found[-1][1]))


def _extended(bank: Bank, layer: Layer, U: Array, s: Array, products: Array) -> Layer:
    """A layer after some directions, which the columns have products (K, p) with."""
    residual = layer.y - U @ (U.T @ layer.y)
    return replace(
        layer, y=residual, left2=np.maximum(layer.left2 - np.sum(products**2, axis=1), 0.0),
        basis=np.hstack([layer.basis, U]), bases=layer.bases.without(bank, layer.bases(products)),
        rss=float(residual @ residual), determinant=layer.determinant + 2.0 * float(np.log(s).sum()),
    )  # fmt: skip


def likely(scan: Scan, by_way: bool) -> Mask:
    """(R,) the sharings whose likelihood is near that of the best, or of the best of their way.

    It is enough to be so with or without the best candidate.
    """
    explains = sum_entries(scan.bank, scan.squares.T)
    top = explains.max(axis=0) if explains.size else np.zeros(len(scan.layers))
    rss = np.array([layer.rss for layer in scan.layers])
    ways = np.array([layer.sharing.way for layer in scan.layers])
    kept = np.zeros(len(scan.layers), bool)
    for value in (scan.log_likelihood, log_likelihood(scan, rss - top)):
        best = np.array([value[ways == way].max() if by_way else value.max() for way in ways])
        kept |= value > best - _NEAR
    return kept


def at_sharings(scan: Scan, keep: Mask) -> Scan:
    """The scan at some of its sharings."""
    return replace(scan, layers=tuple(la for la, k in zip(scan.layers, keep, strict=True) if k))


def log_likelihood(scan: Scan, rss: Array) -> Array:
    """Restricted log-likelihood with the scale profiled; rss (R, ...) -> (R, ...)."""
    determinant = np.array([layer.determinant for layer in scan.layers])
    shape = (-1,) + (1,) * (rss.ndim - 1)
    return np.asarray(-0.5 * scan.freedom * np.log(np.maximum(rss, TINY)) - 0.5 * determinant.reshape(shape))


def explained(scan: Scan) -> Array:
    """(R, S) sum of squares that each entry explains of the residual."""
    return sum_entries(scan.bank, scan.squares.T).T


def sum_entries(bank: Bank, squares: Array) -> Array:
    """Sums over the columns of each entry: (K, B) -> (S, B)."""
    return of_groups(squares, bank.start)


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
    unit_length, length = unit_columns(W[:, 1:])
    U, s, Vt = svd(unit_length)
    keep = s > RANK * s.max(initial=0.0)
    beta = Vt[keep].T @ ((U[:, keep].T @ W[:, 0]) / s[keep])
    residual = W[:, 0] - W[:, 1:] @ (beta / length)
    scale2 = float(residual @ residual) / max(len(y) - int(keep.sum()), 1)
    variance = np.einsum("kp,k->p", Vt[keep] ** 2, scale2 / s[keep] ** 2)
    lost = np.einsum("kp->p", Vt[~keep] ** 2) > _TOUCHED
    deviation = np.where(lost, np.inf, np.sqrt(variance))
    estimate = beta / length
    fitted = X @ estimate
    unit = np.concatenate([np.ones(A.shape[1]), *(scan.bank.scale[scan.bank.slice(e)] for e in entries)])
    return estimate / unit, deviation / length / unit, fitted
