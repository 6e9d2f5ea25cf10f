"""What is left after compensation: MAX and RMS by axis and position, histograms, held-out poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from symstiff.arrays import Array, Index, numbered
from symstiff.calibration.tables.measurements import COMPONENTS
from symstiff.errors import UserError


@dataclass(frozen=True)
class Size:
    """Largest and root-mean-square magnitude of one kind of residual, m or rad."""

    max: float
    rms: float


@dataclass(frozen=True)
class ResidualTable:
    """Sizes by axis and of whole positions and rotations (keys: x … rz, positional, rotational).

    ``geometry``: of absolute positions, what errors of geometry and placement alone leave; ``before`` is then what the
    rigid robot leaves, placed as well as it can be.
    """

    before: dict[str, Size]
    after: dict[str, Size]
    geometry: dict[str, Size] | None = None

    def __repr__(self) -> str:
        sizes = [
            f"{part} {1e3 * self.before[part].rms:.3f} to {1e3 * self.after[part].rms:.3f} {unit} rms"
            for part, unit in (("positional", "mm"), ("rotational", "mrad"))
            if part in self.before
        ]
        return f"ResidualTable({', '.join(sizes) or 'nothing'})"

    @property
    def compensated(self) -> float:
        """Share of the positional RMS that the model removes (seed: 0.95); nan without positions.

        And for absolute ones, where most of what is removed is geometry and placement: they are no part of the model.
        """
        if (
            self.geometry is not None
            or "positional" not in self.before
            or self.before["positional"].rms == 0.0
        ):
            return math.nan
        return 1.0 - self.after["positional"].rms / self.before["positional"].rms

    def to_dict(self) -> dict[str, Any]:
        """A JSON-ready record, in m and rad."""

        def sizes(table: dict[str, Size]) -> dict[str, dict[str, float]]:
            return {key: {"max": size.max, "rms": size.rms} for key, size in table.items()}

        share = self.compensated
        return {
            "before": sizes(self.before),
            **({} if self.geometry is None else {"geometry": sizes(self.geometry)}),
            "after": sizes(self.after),
            "compensated": share if math.isfinite(share) else None,
        }


def residual_table(measured: Array, predicted: Array) -> ResidualTable:
    """Compare deflections before and after compensation, as the seed's Table 2.

    measured, predicted: (N, 6) or (N, 3), a row per pose, load and point, in m and rad; NaN where not
    measured. A position counts where all three of its axes were measured.
    """
    measured, predicted = np.asarray(measured, dtype=float), np.asarray(predicted, dtype=float)
    if measured.shape != predicted.shape or measured.ndim != 2 or measured.shape[1] not in (3, 6):
        raise UserError(
            f"measured {measured.shape} and predicted {predicted.shape}: give (N, 3) or (N, 6) each"
        )
    return ResidualTable(sizes(measured), sizes(measured - predicted))


def sizes(values: Array) -> dict[str, Size]:
    """MAX and RMS by axis and of translations and rotations as a whole; values: (N, 3 or 6), NaN allowed."""
    found = {}
    for axis, column in zip(COMPONENTS, values.T, strict=False):
        if np.isfinite(column).any():
            found[axis] = _size(column)
    for name, part in (("positional", values[:, :3]), ("rotational", values[:, 3:])):
        norms = np.linalg.norm(part, axis=1) if part.shape[1] else np.full(0, math.nan)
        if np.isfinite(norms).any():
            found[name] = _size(norms)
    return found


def places(groups: Sequence[int] | Index, told: Array) -> Index:
    """(M,) place of each row's group by the least of what is told (M, K) of its rows: the same in any order of rows."""
    number = numbered(np.asarray(groups))
    least = np.full((int(number.max(initial=-1)) + 1, told.shape[1]), np.inf)
    np.fmin.at(least, number, told)
    place = np.empty(len(least), dtype=np.int_)
    place[np.lexsort(least.T)] = np.arange(len(least))
    return place[number]


def split(groups: Sequence[int] | Index, share: float = 0.2, seed: int = 0) -> tuple[Index, Index]:
    """Indices of rows to fit and rows to hold out, all rows of a pose together; groups: (M,) pose indices."""
    groups = np.asarray(groups)
    poses = np.unique(groups)
    if len(poses) < 2 or not 0.0 < share < 1.0:
        raise UserError(
            f"{len(poses)} pose(s), share {share:g}: holding out needs two poses and a share in (0, 1)"
        )
    count = min(max(round(share * len(poses)), 1), len(poses) - 1)
    out = np.random.default_rng(seed).permutation(poses)[:count]
    held = np.isin(groups, out)
    return np.flatnonzero(~held), np.flatnonzero(held)


def _size(values: Array) -> Size:
    values = values[np.isfinite(values)]
    return Size(float(np.max(np.abs(values))), float(np.sqrt(np.mean(values**2))))
