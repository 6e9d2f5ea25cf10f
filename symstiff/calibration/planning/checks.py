"""What makes a plan impossible, said before the search: too few poses, parameters that nothing moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from symstiff.calibration.planning.candidates import Space
from symstiff.display import counted
from symstiff.errors import UserError

_SAMPLE = 4000  # candidates whose rows decide the rank
_RANK = 1e-7  # singular value, of the largest one, below which a direction counts as not excited: variances are of
# squares, and hold no smaller one


def check_counts(poses: int, candidates: int, parameters: int, rows: int, space: Space) -> None:
    """Refuse a number of poses that cannot give enough equations, or cannot show every level."""
    fewest = -(-parameters // rows)
    if poses < fewest:
        raise UserError(
            f"{counted(poses, 'pose')} for {parameters} parameters, {rows} equations at most from each: plan at least "
            f"{counted(fewest, 'pose')}, better {2 * fewest}"
        )
    if candidates < max(10 * poses, 100):
        raise UserError(
            f"candidates: {candidates} are too few for {poses} poses: draw at least {max(10 * poses, 100)}"
        )
    for joint, count in space.levels.items():
        if count > poses:
            raise UserError(
                f"{counted(poses, 'pose')} cannot show {count} values of q{joint}: plan at least {count} poses"
            )


def check_rank(
    rows: np.ndarray, parameters: Sequence[str], levels: Mapping[int, int] | None = None
) -> np.ndarray:
    """Return the scale (P,) that gives whitened rows (m, N, P) columns of unit root mean square.

    ``levels``: joints that have few values, 1-based. Raises UserError naming the parameters that no candidate, hence
    no plan, can tell apart.
    """
    every = max(1, rows.shape[1] // _SAMPLE)
    sample = rows[:, ::every].reshape(-1, rows.shape[2])
    size = np.sqrt(np.mean(sample**2, axis=0))
    dead = [name for name, s in zip(parameters, size, strict=True) if s <= 1e-12 * size.max()]
    if dead:
        raise UserError(
            f"no candidate moves {_names(dead)}: leave them out of the model, "
            "or change the load or the fixed joints"
        )
    scaled = sample / size
    triangle = np.linalg.qr(scaled, mode="r")
    _, singular, right = np.linalg.svd(triangle)
    missing = singular < _RANK * singular[0]
    if missing.any():
        share = np.sqrt(np.sum(right[missing] ** 2, axis=0))
        mixed = [name for name, s in zip(parameters, share, strict=True) if s > 1e-6]
        few = f"give {', '.join(f'q{j}' for j in sorted(levels))} more values (--levels), " if levels else ""
        raise UserError(
            f"no plan tells {_names(mixed)} apart with these loads, points and joints "
            f"({counted(int(missing.sum()), 'combination')} unknown): {few}reduce the model for this load and "
            "measurement first (fewer than three points tell no pose: leave --measure out), or measure more points"
        )
    return np.asarray(1.0 / size)


def _names(names: Sequence[str]) -> str:
    shown = ", ".join(names[:8])
    return shown if len(names) <= 8 else f"{shown} and {len(names) - 8} more"
