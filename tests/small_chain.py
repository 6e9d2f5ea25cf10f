"""A numeric elastic chain for tests: columns by cross products, nothing from the package."""

from __future__ import annotations

import numpy as np

# (a, alpha, d) of a heavy six-axis arm; the rotation that brings the beam axis first in each DH frame.
ROWS = [
    (0.35, -np.pi / 2, 0.0),
    (1.25, 0.0, 0.0),
    (-0.055, -np.pi / 2, 0.0),
    (0.0, np.pi / 2, 1.1),
    (0.0, -np.pi / 2, 0.0),
    (0.0, 0.0, 0.23),
]
FIRST_AXIS = [0, 0, 0, 2, 1, 2, 2]
BEAM = ["11", "22", "33", "44", "55", "66", "26", "35"]


def names(links: range = range(7), joints: range = range(1, 7)) -> list[str]:
    return [f"k{i}_{ab}" for i in links for ab in BEAM] + [f"c{j}" for j in joints]


def _dh(a: float, alpha: float, d: float, theta: float) -> np.ndarray:
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
    )


def columns(q: np.ndarray) -> dict[tuple[str, int], np.ndarray]:
    """(6, 6) twist of the tool per spring of link i, (6, 1) per joint j."""
    frames = [np.eye(4)]
    frames[0][2, 3] = 0.75
    for row, angle in zip(ROWS, q, strict=True):
        frames.append(frames[-1] @ _dh(*row, angle))
    tip = (frames[-1] @ np.array([0.05, 0.1, 0.3, 1.0]))[:3]
    found = {}
    for i, T in enumerate(frames):
        E = np.roll(T[:3, :3], -FIRST_AXIS[i], axis=1)
        lever = np.cross(E, (tip - T[:3, 3])[:, None], axis=0)
        found["link", i] = np.block([[E, lever], [np.zeros((3, 3)), E]])
        if i:
            z, p = frames[i - 1][:3, 2], frames[i - 1][:3, 3]
            found["joint", i] = np.concatenate([np.cross(z, tip - p), z])[:, None]
    return found


def observation(q: np.ndarray, w: np.ndarray, parameters: list[str]) -> np.ndarray:
    """(6·N, P) observation matrix, pose by pose."""
    rows = []
    for pose, wrench in zip(q, w, strict=True):
        J = columns(pose)
        A = np.empty((6, len(parameters)))
        for p, name in enumerate(parameters):
            if name[0] == "c":
                j = J["joint", int(name[1:])]
                A[:, p] = (j @ j.T) @ wrench
            else:
                body, ab = name[1:].split("_")
                a, b = int(ab[0]) - 1, int(ab[1]) - 1
                L = J["link", int(body)]
                load = L.T @ wrench
                A[:, p] = L[:, a] * load[b] + (L[:, b] * load[a] if a != b else 0.0)
        rows.append(A)
    return np.vstack(rows)


def sample(count: int, seed: int, gravity: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles (N, 6) and wrenches (N, 6): 2.5 kN down, or any force and moment."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.0, 2.0, (count, 6))
    w = rng.normal(size=(count, 6)) * np.array([1000.0] * 3 + [400.0] * 3)
    return q, np.tile([0.0, 0.0, -2500.0, 0.0, 0.0, 0.0], (count, 1)) if gravity else w


def truth(parameters: list[str], seed: int = 0) -> np.ndarray:
    """Admissible values: cantilevers of plausible sizes with shear, and joint compliances of the field."""
    rng = np.random.default_rng(seed)
    joint = {1: 0.7e-6, 2: 0.302e-6, 3: 0.406e-6, 4: 3.002e-6, 5: 3.303e-6, 6: 2.365e-6}
    beams: dict[str, dict[str, float]] = {}
    for i in range(7):
        length, y, z = rng.uniform(0.2, 1.2), *rng.uniform(0.3e-7, 2e-7, 2)
        beams[str(i)] = {
            "11": length * 2e-10,
            "22": length**2 / 3 * y * 1.2,
            "33": length**2 / 3 * z * 1.3,
            "44": 1e-7 * rng.uniform(0.5, 1.5),
            "55": z,
            "66": y,
            "26": length / 2 * y,
            "35": -length / 2 * z,
        }
    return np.array(
        [
            joint[int(n[1:])] if n[0] == "c" else beams[n[1:].split("_")[0]][n.split("_")[1]]
            for n in parameters
        ]
    )


def reduction(
    parameters: list[str], scale: np.ndarray, gravity: bool = False
) -> tuple[np.ndarray, list[int]]:
    """(r, n) mapping to a kept set of columns, and their indices, from the null space of many random rows."""
    A = observation(*sample(60, 99, gravity), parameters) * scale
    sizes = np.linalg.norm(A, axis=0)
    A = np.where(sizes > 1e-12 * sizes.max(), A / sizes.clip(1e-300), 0.0)
    pivots: list[int] = []
    basis = np.zeros((len(A), 0))
    for p in range(A.shape[1]):
        rest = A[:, p] - basis @ (basis.T @ A[:, p])
        rest -= basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > 1e-7:
            pivots.append(p)
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
    raw = observation(*sample(60, 99, gravity), parameters) * scale
    P = np.linalg.lstsq(raw[:, pivots], raw, rcond=None)[0] / scale * scale[pivots][:, None]
    P[np.abs(P * scale / scale[pivots][:, None]) < 1e-9] = 0.0
    return P, pivots
