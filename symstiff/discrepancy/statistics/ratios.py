"""The size of the error that a pose's rows share, between those of the grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from symstiff.arrays import TINY, Array
from symstiff.calibration.fits.decomposition import column_space
from symstiff.discrepancy.noise.scales import Noise
from symstiff.discrepancy.noise.sharing import Sharing

_CLOSE = 0.03
"""Step of a ratio's logarithm that changes nothing."""


def with_likeliest(noise: Noise, y: Array, X: Array) -> Noise:
    """The noise with the likeliest size of every way of sharing in the place of the nearest one that is looked at.

    y (M,) by columns X (M, P), in the data's unit; sizes beyond those that are looked at are left.
    """
    basis = column_space(X / noise.spread[:, None])
    rows = noise.apply(noise.own(-0.5), np.column_stack([basis, y / noise.spread]))
    sharings = list(noise.sharings)
    for way in dict.fromkeys(s.way for s in sharings if s.ratio > 0):
        own = [k for k, s in enumerate(sharings) if s.way == way and s.ratio > 0]
        told = np.log([sharings[k].ratio for k in own])
        best = _likeliest(noise, way, rows, float(told.min()), float(told.max()))
        sharings[own[int(np.argmin(np.abs(told - best)))]] = Sharing(way, float(np.exp(best)))
    return replace(noise, sharings=tuple(sharings))


def _likeliest(noise: Noise, way: str, rows: Array, low: float, high: float) -> float:
    """Logarithm of a ratio between two at which model and data (M, P + 1) have the largest restricted likelihood."""
    if high - low < _CLOSE:
        return low

    def cost(log_ratio: float) -> float:
        sharing = Sharing(way, float(np.exp(log_ratio)))
        triangle = np.linalg.qr(noise.apply(noise.shared(sharing, -0.5), rows), mode="r")
        size = np.log(np.maximum(np.abs(np.diag(triangle)), TINY))
        freedom = rows.shape[0] - rows.shape[1] + 1
        return float(freedom * size[-1] + size[:-1].sum() + 0.5 * noise.log_determinant(sharing))

    return float(minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": _CLOSE}).x)
