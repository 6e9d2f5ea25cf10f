"""Attitudes in absolute data: rotation vectors, whose components' sigma is not that of a turn of the tool."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from symstiff.calibration.experiment.placement import turns_of
from symstiff.calibration.identify import identify
from symstiff.calibration.measurements import measurements
from symstiff.calibration.simulation import Noise, Truth, nominal_truth, simulate
from symstiff.robot import load


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-6, 0.0, 2e-6), (0.4, -1.1, 0.3), (1.8, 2.2, -1.0)])
def test_a_small_change_of_a_rotation_vector_is_the_turn_that_is_told(vector: tuple[float, ...]) -> None:
    v, step = np.array(vector), 1e-6
    ends = [Rotation.from_rotvec(v + side * step * np.eye(3)) for side in (1.0, -1.0)]
    columns = ((ends[0] * ends[1].inv()).as_rotvec() / (2 * step)).T
    assert turns_of(v[None])[0] == pytest.approx(columns, abs=1e-7)


def test_truthful_sigmas_of_attitudes_leave_a_variance_of_one() -> None:
    robot, found = load("ur10"), []
    low, high = np.array([j.range for j in robot.joint]).T
    for seed in range(6):
        rng = np.random.default_rng(seed)
        q = np.repeat(rng.uniform(np.maximum(low, -2.5), np.minimum(high, 2.5), (40, 6)), 2, axis=0)
        force = 80.0 * rng.normal(size=(40, 3)) / np.sqrt(3)
        w = np.array([np.r_[f * level, 0, 0, 0] for f in force for level in (0.0, 1.0)])
        design = measurements(
            q, w, pose=np.repeat(np.arange(40), 2), kind="absolute", joint_units=["rad"] * 6
        )
        truth = Truth(
            robot,
            nominal_truth(robot),
            (),
            Noise((0.02,) * 3, (0.02,) * 3),
            kind="absolute",
            components="pose",
        )
        found.append(identify(robot, simulate(truth, design, seed)).fit.s0_squared)
    assert np.mean(found) == pytest.approx(1.0, abs=0.06)
