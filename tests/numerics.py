"""A reduction's observation matrix by the definition, and its ranks and couplings by numbers."""

from __future__ import annotations

import numpy as np
from definition import observation, poses, samples

from symstiff.reduction import Reduction


def columns(r: Reduction) -> np.ndarray:
    """π′'s observation matrix by the definition, aggregated, columns of unit length, compressed by QR."""
    return np.asarray(np.linalg.qr(scaled(raw_columns(r)), mode="r"))


def raw_columns(r: Reduction, count: int = 24, seed: int = 1) -> np.ndarray:
    q, w = samples(r.robot, count, seed, r.experiment.loads)
    for joint, value in r.experiment.fixed.items():
        q[:, joint - 1] = float(value)
    A = observation(r.robot, q, w, [p.name for p in r.full]).reshape(count, 6, -1)
    if r.experiment.points:
        return np.vstack([_seen_at(r, q, A, point) for point in r.experiment.points])
    return A[:, : 3 if r.experiment.measure == "position" else 6].reshape(-1, len(r.full))


def _seen_at(r: Reduction, q: np.ndarray, A: np.ndarray, point: str) -> np.ndarray:
    """Translations of a marker beside a tool that is not turned: d + φ × R·(marker − tip)."""
    marker = next(m.xyz for m in r.robot.marker if m.name == point)
    beside = [float(x) - float(t) for x, t in zip(marker, r.robot.tool.xyz, strict=True)]
    lever = (poses(r.robot, q)[:, :3, :3] @ np.array(beside))[:, :, None]
    return (A[:, :3] + np.cross(A[:, 3:], lever, axis=1)).reshape(-1, len(r.full))


def scaled(A: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(A, axis=0)
    return A / np.where(size > 1e-13 * size.max(), size, np.inf)


def rank(A: np.ndarray) -> int:
    if A.size == 0:
        return 0
    s = np.linalg.svd(A, compute_uv=False)
    return int((s > 1e-9 * max(s[0], 1e-300)).sum())


def assert_couplings_hold(r: Reduction) -> None:
    names, A = [p.name for p in r.full], raw_columns(r, count=8, seed=6)
    eliminated = set(names) - set(r.parameters) - set(r.partition.g2)
    assert set(r.partition.couplings) == eliminated
    for e, row in r.partition.couplings.items():
        assert set(row) <= set(r.parameters)
        combined = sum(float(c) * A[:, names.index(k)] for k, c in row.items())
        np.testing.assert_allclose(combined, A[:, names.index(e)], atol=1e-9 * max(1, abs(A).max()))
