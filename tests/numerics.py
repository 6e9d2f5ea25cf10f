"""A reduction's observation matrix by the definition, and its ranks and couplings by numbers."""

from __future__ import annotations

import numpy as np
from definition import observation, samples

from symstiff.reduction import Reduction


def columns(r: Reduction) -> np.ndarray:
    """π′'s observation matrix by the definition, aggregated, columns of unit length, compressed by QR."""
    return np.asarray(np.linalg.qr(scaled(raw_columns(r)), mode="r"))


def raw_columns(r: Reduction, poses: int = 24, seed: int = 1) -> np.ndarray:
    q, w = samples(r.robot, poses, seed, r.experiment.loads)
    for joint, value in r.experiment.fixed.items():
        q[:, joint - 1] = float(value)
    A = observation(r.robot, q, w, [p.name for p in r.full]).reshape(poses, 6, -1)
    return A[:, : 3 if r.experiment.measure == "position" else 6].reshape(-1, len(r.full))


def scaled(A: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(A, axis=0)
    return A / np.where(size > 1e-13 * size.max(), size, np.inf)


def rank(A: np.ndarray) -> int:
    if A.size == 0:
        return 0
    s = np.linalg.svd(A, compute_uv=False)
    return int((s > 1e-9 * max(s[0], 1e-300)).sum())


def assert_couplings_hold(r: Reduction) -> None:
    names, A = [p.name for p in r.full], raw_columns(r, poses=8, seed=6)
    eliminated = set(names) - set(r.parameters) - set(r.partition.g2)
    assert set(r.partition.couplings) == eliminated
    for e, row in r.partition.couplings.items():
        assert set(row) <= set(r.parameters)
        combined = sum(float(c) * A[:, names.index(k)] for k, c in row.items())
        np.testing.assert_allclose(combined, A[:, names.index(e)], atol=1e-9 * max(1, abs(A).max()))
