"""Small virtual experiments on the planar arm: a few poses, several loads, three markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from symstiff.calibration.simulation.experiment import simulate
from symstiff.calibration.simulation.truth import truth_from_table
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.calibration.tables.table import write_table

ROBOT = "planar2r"
MARKERS = ("p1", "p2", "p3")
HARDENING = {"effect": "nonlinear_stiffness", "where": {"joint": 2}, "shape": "tanh", "a": 6e-4, "tau0": 20.0}


def design(
    poses: int = 10, levels: tuple[float, ...] = (0.25, 0.5, 1.0, -0.5, -1.0), force: float = 80.0
) -> Measurements:
    """Poses, each under one direction of force at several levels."""
    rng = np.random.default_rng(4)
    q = rng.uniform([-2.5, -2.2], [2.5, 2.2], (poses, 2))
    angle = rng.uniform(0, 2 * np.pi, poses)
    direction = np.stack([np.cos(angle), np.sin(angle), 0.6 * np.sign(rng.normal(size=poses))], axis=1)
    wrench = np.zeros((poses * len(levels), 6))
    wrench[:, :3] = force * np.repeat(direction, len(levels), axis=0) * np.tile(levels, poses)[:, None]
    rows = np.repeat(q, len(levels), axis=0)
    return measurements(
        np.repeat(rows, 3, axis=0),
        np.repeat(wrench, 3, axis=0),
        pose=np.repeat(np.arange(poses), 3 * len(levels)),
        points=MARKERS,
        point=np.tile([0, 1, 2], len(rows)),
    )


def measured(*effects: dict[str, object], stated: float = 1.0, seed: int = 3, **keys: object) -> Measurements:
    """What a tracker with 0.02 mm noise reads of the arm with some effects."""
    truth = truth_from_table(
        {
            "format": 1,
            "robot": ROBOT,
            "effect": list(effects),
            "noise": {"sigma_mm": 0.02, "stated": stated},
        }
    )
    return simulate(truth, design(**keys), seed)  # type: ignore[arg-type]


def saved(table: Measurements, path: Path) -> Path:
    """The table as a file."""
    write_table(table, path, "deg")
    return path
