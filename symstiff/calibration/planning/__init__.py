"""Choice of measurement poses: candidates, criteria, exchange, refinement."""

from symstiff.calibration.planning.candidates import Space
from symstiff.calibration.planning.frames import Geometry, geometry
from symstiff.calibration.planning.loads import Load
from symstiff.calibration.planning.measurement import Measurement, measurement_of
from symstiff.calibration.planning.plan import Goal, Plan, Search, plan_poses
from symstiff.calibration.planning.poses import draw_plan, poses_table, save_figure, summary
from symstiff.calibration.planning.region import Box, HalfSpace, Region, above_floor

__all__ = [
    "Box",
    "Geometry",
    "Goal",
    "HalfSpace",
    "Load",
    "Measurement",
    "Plan",
    "Region",
    "Search",
    "Space",
    "above_floor",
    "draw_plan",
    "geometry",
    "measurement_of",
    "plan_poses",
    "poses_table",
    "save_figure",
    "summary",
]
