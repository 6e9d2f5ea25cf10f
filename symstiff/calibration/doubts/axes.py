"""A hint for swapped or negated axes: would another assignment of the measured axes fit far better?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from symstiff.arrays import TINY, Array
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.calibration.tables.measurements import Measurements
from symstiff.errors import UserError
from symstiff.reduction.svd import svd
from symstiff.robot.schema import Robot

_FAR_BETTER = 0.25  # of the unexplained part that is left as measured
WORTH_A_WORD = 0.05
"""Part of the squares that a model leaves below which nobody asks how the data are told."""
_SAME = 1.02  # two assignments this close in what they leave are not told apart
_LETTERS = "xyz"
AGAINST = "the deflections point against their loads, which no robot gives way to"
_NEARLY_ALL, _FEWEST = 0.95, 6
"""Share of the rows under forces alone, of so many, whose forces have to do negative work."""
_NEAR = 0.2
"""Distance from the tool centre point, in reaches, from which a marker may move against the load."""


@dataclass(frozen=True, eq=False)
class AxisHint:
    """Another assignment of axes that fits far better.

    signed: (3, 3) signed permutation, true = signed @ given; unexplained, best: share of the squared deflection
    left as given and after the change; rivals: how many others do as well.
    """

    signed: Array
    unexplained: float
    best: float
    rivals: int

    @property
    def reversed(self) -> bool:
        """Whether everything measured points the other way."""
        return bool(np.all(self.signed == -np.eye(3)))

    def __str__(self) -> str:
        if self.reversed:
            return (
                f"{AGAINST}: the sign of the loads is another one, or unloaded positions were taken minus loaded "
                "ones"
            )
        text = (
            f"the deflection axes look swapped: {assignment(self.signed)} would leave {self.best:.1%} "
            f"of the squared deflection unexplained instead of {self.unexplained:.1%}"
        )
        more = f" ({self.rivals} other assignments do as well: more load directions would tell them apart)"
        return text + (more if self.rivals else "")


def against_loads(robot: Robot, table: Measurements) -> str:
    """The signs to look at, such as "dz or fz", where forces do negative work on the points that they move; else empty.

    Of rows under forces alone, read along all axes that these have at points near the tool centre point: there F·d is
    twice the energy of the springs, up to what the noise and the way to a marker make of it.
    """
    force, moved = table.w[:, :3], table.values[:, :3]
    alone = (force != 0).any(axis=1) & ~table.w[:, 3:].any(axis=1)
    alone &= np.all(table.measured[:, :3] | (force == 0), axis=1)
    places = np.array([robot.marker_position(name) for name in ("tcp", *table.points)], dtype=float)
    away = np.linalg.norm(places[1:] - places[0], axis=1)
    alone &= away[table.point] < _NEAR * robot.reach
    work = np.where(force[alone] != 0, force[alone] * moved[alone], 0.0)
    total = work.sum(axis=1)
    if len(total) < _FEWEST or np.mean(total < 0) < _NEARLY_ALL:
        return ""
    return " or ".join(f"d{x} or f{x}" for x, own in zip(_LETTERS, work.sum(axis=0), strict=True) if own < 0)


def signed_permutations() -> tuple[Array, ...]:
    """The 48 signed 3 × 3 permutations, those that change least first."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            found.append(matrix)
    return tuple(sorted(found, key=lambda m: float(np.sum(np.abs(m - np.eye(3))))))


def assignment(signed: Array) -> str:
    """A signed permutation in words, such as "x = −y, y = x, z = z"."""
    parts = []
    for letter, row in zip(_LETTERS, signed, strict=True):
        source = int(np.argmax(np.abs(row)))
        parts.append(f"{letter} = {'-' if row[source] < 0 else ''}{_LETTERS[source]}")
    return ", ".join(parts)


def axis_hint_refit(
    A: Array,
    measured: Array,
    sigma: Array | None = None,
    positive: Sequence[bool] | None = None,
    force: Array | None = None,
) -> AxisHint | None:
    """Identify anew with each of 48 assignments and compare what the fits leave.

    A: (3N, P) observation matrix of the translations, row 3i + axis; measured: (N, 3) in m; sigma: (3,).
    positive: (P,) which parameters cannot be negative (diagonal terms, joints): negating all three axes only
    negates the parameters, so of such a pair the one with fewer negative ones counts. force: (N, 3) in N; an assignment
    under which these forces do positive work, Σ F·d, stands even so: it is another robot's, not a mirrored one.
    """
    measured = _triples(measured)
    if np.shape(A)[0] != measured.size:
        raise UserError(
            f"observation matrix has {np.shape(A)[0]} rows for {measured.size} measured components"
        )
    weight = np.ones(3) if sigma is None else 1.0 / np.asarray(sigma, dtype=float)
    whitened = np.asarray(A, dtype=float) * np.tile(weight, len(measured))[:, None]
    Q, s, Vt = svd(unit_columns(whitened)[0])
    rank = int(np.sum(s > s[0] * max(whitened.shape) * np.finfo(float).eps))
    changes = signed_permutations()
    targets = np.stack([((measured @ S.T) * weight).ravel() for S in changes], axis=1)  # (3N, 48)
    inside = Q[:, :rank].T @ targets
    left = 1.0 - np.sum(inside**2, axis=0) / np.maximum(np.sum(targets**2, axis=0), TINY)
    if positive is not None:
        values = Vt[:rank].T @ (inside / s[:rank, None])
        signed = values[np.asarray(positive, dtype=bool)]
        mirrored = np.sum(np.minimum(signed, 0.0) ** 2, axis=0) > 0.5 * np.sum(signed**2, axis=0)
        if force is not None:
            mirrored &= np.array([np.sum(force * (measured @ S.T)) < 0 for S in changes])
        left = np.where(mirrored, 1.0, left)
    return _judge([max(float(value), 0.0) for value in left])


def _judge(left: Sequence[float]) -> AxisHint | None:
    """The best change if it is far better than none; `left` in the order of `signed_permutations`.

    Of those that do as well the one that reverses everything, if it is among them, else the one that changes least.
    """
    best = int(np.argmin(left))
    close = [i for i, value in enumerate(left) if value <= left[best] * _SAME + 1e-9]
    if 0 in close or left[0] < WORTH_A_WORD or left[best] > _FAR_BETTER * left[0]:
        return None
    changes = signed_permutations()
    found = next((i for i in close if np.all(changes[i] == -np.eye(3))), close[0])
    return AxisHint(changes[found], left[0], left[found], len(close) - 1)


def _triples(values: Array) -> Array:
    values = np.asarray(values, dtype=float)
    if values.ndim != 2 or values.shape[1] != 3 or not np.isfinite(values).all():
        raise UserError(f"axes are compared on complete (N, 3) translations, found shape {values.shape}")
    return values
