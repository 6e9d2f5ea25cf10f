"""A small elastic chain for the tests of planning: it shares nothing with the kernel of the package."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

BEAM = ((1, 1), (2, 2), (3, 3), (4, 4), (5, 5), (6, 6), (2, 6), (3, 5))


@dataclass(frozen=True)
class ChainObservation:
    """Observation matrices (N, 6, P) of a standard DH chain; springs of link i in DH-frame axes.

    rows: (theta, d, a, alpha); base z and tool xyz [m]; terms: (link, a, b), or (joint, 0, 0).
    """

    rows: tuple[tuple[float, float, float, float], ...]
    base_z: float
    tool: tuple[float, float, float]
    terms: tuple[tuple[int, int, int], ...]

    def frames(self, q: np.ndarray) -> list[np.ndarray]:
        """Poses (N, 4, 4) of frames 0 to n and the tool."""
        count = len(q)
        T = np.tile(np.eye(4), (count, 1, 1))
        T[:, 2, 3] = self.base_z
        found = [T]
        for (theta, d, a, alpha), angle in zip(self.rows, q.T, strict=True):
            c, s = np.cos(theta + angle), np.sin(theta + angle)
            ca, sa = np.cos(alpha), np.sin(alpha)
            step = np.zeros((count, 4, 4))
            step[:, 0] = np.stack([c, -s * ca, s * sa, a * c], axis=1)
            step[:, 1] = np.stack([s, c * ca, -c * sa, a * s], axis=1)
            step[:, 2] = [0, sa, ca, d]
            step[:, 3] = [0, 0, 0, 1]
            found.append(found[-1] @ step)
        tool = np.eye(4)
        tool[:3, 3] = self.tool
        return [*found, found[-1] @ tool]

    def __call__(self, q: np.ndarray, w: np.ndarray) -> np.ndarray:
        frames = self.frames(q)
        tip = frames[-1][:, :3, 3]

        def column(link: int, axis: int) -> np.ndarray:
            T = frames[link - 1] if axis == 0 else frames[link]
            along = T[:, :3, 2] if axis == 0 else T[:, :3, (axis - 1) % 3]
            if axis in (1, 2, 3):
                return np.hstack([along, np.zeros_like(along)])
            return np.hstack([np.cross(along, tip - T[:, :3, 3]), along])

        columns = []
        for link, a, b in self.terms:
            first, second = column(link, a), column(link, b)
            load_a, load_b = np.sum(first * w, axis=1), np.sum(second * w, axis=1)
            one = first * load_b[:, None]
            columns.append(one if a == b else one + second * load_a[:, None])
        return np.stack(columns, axis=2)

    def identifiable(self, w: np.ndarray, seed: int = 0, count: int = 400) -> ChainObservation:
        """Keep a largest independent set of terms under one wrench (6,): pivoted QR of random poses."""
        q = np.random.default_rng(seed).uniform(-3, 3, (count, len(self.rows)))
        matrix = self(q, np.tile(w, (count, 1))).reshape(-1, len(self.terms))
        size = np.linalg.norm(matrix, axis=0)
        matrix = np.where(size > 1e-9 * size.max(), matrix / np.maximum(size, 1e-300), 0.0)
        _, triangle, order = scipy.linalg.qr(matrix, mode="economic", pivoting=True)
        diagonal = np.abs(np.diag(triangle))
        keep = sorted(order[diagonal > 1e-9 * diagonal[0]])
        return ChainObservation(self.rows, self.base_z, self.tool, tuple(self.terms[k] for k in keep))

    @property
    def names(self) -> tuple[str, ...]:
        """One name a term."""
        return tuple(f"c{i}" if a == 0 else f"k{i}_{a}{b}" for i, a, b in self.terms)


HALF = np.pi / 2
SIX_AXES = ChainObservation(
    rows=(
        (0, 0, 0.35, -HALF),
        (0, 0, 1.25, 0),
        (0, 0, -0.055, -HALF),
        (0, 1.1, 0, HALF),
        (0, 0, 0, -HALF),
        (0, 0.23, 0, 0),
    ),
    base_z=0.75,
    tool=(0.05, 0.1, 0.3),
    terms=(
        *((i, a, b) for i in range(7) for a, b in BEAM),
        *((j, 0, 0) for j in range(1, 7)),
    ),
)
