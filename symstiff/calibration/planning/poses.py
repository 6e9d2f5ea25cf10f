"""A plan as the poses table that an experiment starts from."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.planning.choice import Plan
from symstiff.calibration.planning.frames import Geometry
from symstiff.calibration.tables.measurements import Measurements, measurements


def poses_table(plan: Plan, robot: Geometry) -> Measurements:
    """Return the plan as a measurement table without measured values: q, wrench, labels p1, p2, …."""
    units = ["m" if prismatic else "rad" for prismatic, *_ in robot.rows]
    return measurements(
        plan.q,
        plan.w,
        labels=[f"p{k + 1}" for k in range(len(plan))],
        pose=np.arange(len(plan)),
        joint_units=units,
    )
