"""What a scan would say with some entries in the model, from inner products with the bases that it has.

A search asks this of many sets, and the noise is learned so. New bases cost a pass over all columns each, and room for
as many; here only their products with the few added directions are formed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from symstiff.discrepancy.bank import mixes
from symstiff.discrepancy.problem import Array
from symstiff.discrepancy.scan import (
    Evidence,
    Layer,
    Mask,
    Scan,
    at_sharings,
    by_direction,
    directions,
    evidence,
    of_squares,
)
from symstiff.threads import in_threads


@dataclass(frozen=True, eq=False)
class Beside:
    """A scan with some entries in the model."""

    scan: Scan
    """Its residuals, ranks and likelihoods are those with the entries; its bases are not."""
    squares: Array
    """(R, K) what each direction explains of the residual there."""

    @property
    def evidence(self) -> Evidence:
        """The evidence of everything else."""
        return of_squares(self.scan, self.squares)

    def at(self, keep: Mask) -> Beside:
        """The same at some of the sharings."""
        return Beside(at_sharings(self.scan, keep), self.squares[keep])


def beside(scan: Scan, entries: tuple[int, ...]) -> Beside:
    """A scan with some entries in the model: what the extended scan would say."""
    if not entries:
        return Beside(scan, by_direction(scan))
    found = in_threads(lambda layer: _after(scan, layer, entries), scan.layers)
    layers, squares, gained = zip(*found, strict=True)
    return Beside(Scan(scan.bank, scan.noise, layers, scan.freedom - gained[-1]), np.stack(squares))


def _after(scan: Scan, layer: Layer, entries: tuple[int, ...]) -> tuple[Layer, Array, int]:
    """A layer after some entries, the squares that each direction explains there, and the directions that they add."""
    U, s = directions(scan, layer, entries)
    y = layer.y - U @ (U.T @ layer.y)
    mix = mixes(scan.bank, layer.alive, layer.variance, U.T @ layer.Q)
    squares = mix((layer.Q.T @ y)[None])[0] ** 2
    determinant = layer.determinant + 2.0 * float(np.log(s).sum())
    after = replace(
        layer, y=y, variance=mix.variance, rank=mix.rank, rss=float(y @ y), determinant=determinant
    )
    return after, squares, len(s)


def evidence_beside(scan: Scan, entries: tuple[int, ...]) -> Evidence:
    """The evidence of everything else once some entries have joined the model: that of the extended scan."""
    return beside(scan, entries).evidence if entries else evidence(scan)
