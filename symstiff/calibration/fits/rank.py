"""The rank decision on real data: singular values, their gap, the noise, and what cannot be told apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from symstiff.arrays import Array
from symstiff.calibration.fits.compact import Compact

_NEGLIGIBLE = 1e-6  # of a scaled column: below it a coefficient of a coupling is rounding
_NOTHING = 1e-150  # singular value that stands for zero where all are: its inverse has a square


@dataclass(frozen=True)
class Combination:
    """kept + Σ coefficient·other: a sum that the data determine although its members alone they do not."""

    kept: str
    others: dict[str, float]
    value: float
    std: float

    def __str__(self) -> str:
        rest = "".join(f" {'-' if c < 0 else '+'} {abs(c):.4g}·{name}" for name, c in self.others.items())
        return f"{self.kept}{rest} = {self.value:.4g} ± {self.std:.2g}"


@dataclass(frozen=True, eq=False)
class RankDecision:
    """How many directions of the scaled, whitened matrix the data resolve, and why.

    singular_values: (P,) of the matrix with unit columns, zeros where rows are too few; rounding_threshold:
    below it a direction is arithmetic; noise_threshold: below it one standard deviation of the direction
    moves the prediction by more than the whole measured signal; null: (P, P − rank) unresolved directions in
    parameter units; affected: parameters that they make uncertain; silent: parameters that move no row.
    """

    singular_values: Array
    rank: int
    numerical_rank: int
    rounding_threshold: float
    noise_threshold: float
    null: Array
    affected: tuple[str, ...]
    silent: tuple[str, ...]

    @property
    def gap(self) -> float:
        """Last kept singular value over the first dropped one; inf where nothing is dropped."""
        s = self.singular_values
        if self.rank == len(s) or s[self.rank] == 0.0:
            return math.inf
        return float(s[self.rank - 1] / s[self.rank]) if self.rank else 0.0

    @property
    def condition(self) -> float:
        """Largest singular value over the smallest one kept."""
        s = self.singular_values
        return float(s[0] / s[self.rank - 1]) if self.rank else math.inf

    @property
    def full(self) -> bool:
        """Whether every direction is resolved."""
        return self.rank == len(self.singular_values)

    def __str__(self) -> str:
        s, total = self.singular_values, len(self.singular_values)
        text = f"rank {self.rank} of {total}"
        if self.rank:
            text += f": smallest kept singular value {s[self.rank - 1]:.3g}"
        if not self.full:
            text += f", largest dropped {s[self.rank]:.3g} (gap {self.gap:.3g})"
        text += f"; thresholds: rounding {self.rounding_threshold:.2g}, noise {self.noise_threshold:.2g}"
        return text + (f"; not determined: {', '.join(self.affected)}" if self.affected else "")

    def to_dict(self) -> dict[str, Any]:
        """A JSON-ready record."""
        return {
            "rank": self.rank,
            "parameters": len(self.singular_values),
            "numerical_rank": self.numerical_rank,
            "singular_values": [float(s) for s in self.singular_values],
            "gap": self.gap if math.isfinite(self.gap) else None,
            "rounding_threshold": self.rounding_threshold,
            "noise_threshold": self.noise_threshold,
            "affected": list(self.affected),
            "silent": list(self.silent),
        }


def decide_rank(
    form: Compact, s: Array, Vt: Array, names: Sequence[str], noise: float, silent: Sequence[str] = ()
) -> RankDecision:
    """Count the directions above both thresholds and list the parameters that the others make uncertain.

    s: (P,) singular values of form.R padded with zeros; Vt: (P, P); noise: standard deviation of a whitened
    row (1 where sigma is known). A direction whose standard deviation noise/s exceeds the whole signal is
    dropped: the data would accept any value of it that could have produced them.
    """
    total = len(s)
    rounding = max(form.rows, total) * np.finfo(float).eps * (float(s[0]) if total else 0.0)
    drowned = noise / form.signal if form.signal > 0 else 0.0
    numerical = int(np.sum(s > rounding))
    rank = int(np.sum(s > max(rounding, drowned)))
    known = np.sum((Vt[:rank] / s[:rank, None]) ** 2, axis=0)
    # A dropped direction matters to a parameter where it would at least double that parameter's variance.
    floor = max(rounding, _NOTHING)
    lost = np.sum((Vt[rank:] / np.maximum(s[rank:, None], floor)) ** 2, axis=0)
    affected = tuple(name for name, a, b in zip(names, lost, known, strict=True) if a > b)
    null = Vt[rank:].T / form.scale[:, None]
    return RankDecision(s, rank, numerical, rounding, drowned, null, affected, tuple(silent))


def resolved_root(form: Compact, s: Array, Vt: Array, rank: int) -> Array:
    """(P, r) matrix that makes the whitened observation matrix orthonormal: root·rootᵀ is the covariance.

    s, Vt: singular values and right vectors of form.R.
    """
    return np.asarray((Vt[:rank].T / s[:rank]) / form.scale[:, None])


def combinations(
    decision: RankDecision, names: Sequence[str], scale: Array, values: Array, covariance: Array
) -> tuple[Combination, ...]:
    """The sums that stay determined where single parameters are not (seed eq. 21, on this data set).

    scale: (P,) column norms; values: (P,), covariance: (P, P) of the resolved part. One parameter a dropped
    direction is expressed by the kept ones; parameters that no dropped direction touches do not appear.
    """
    if decision.full:
        return ()
    null = decision.null * scale[:, None]
    _, _, order = scipy.linalg.qr(null.T, mode="economic", pivoting=True)
    gone = order[: null.shape[1]]
    moves = np.linalg.solve(null[gone].T, null.T).T  # (P, d): what each eliminated one drags along
    found = []
    for kept in (i for i in range(len(names)) if i not in set(gone.tolist())):
        row = {int(e): -moves[kept, d] for d, e in enumerate(gone) if abs(moves[kept, d]) > _NEGLIGIBLE}
        if not row:
            continue
        weights = np.zeros(len(names))
        weights[kept] = 1.0
        for e, coefficient in row.items():
            weights[e] = coefficient * scale[e] / scale[kept]
        std = math.sqrt(max(float(weights @ covariance @ weights), 0.0))
        others = {names[e]: float(weights[e]) for e in sorted(row)}
        found.append(Combination(names[kept], others, float(weights @ values), std))
    return tuple(found)
