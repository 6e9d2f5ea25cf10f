"""Choice of measurement poses: candidates, criteria, exchange, refinement, workspace maps."""

from symstiff.calibration.planning.candidates import Space
from symstiff.calibration.planning.choice import Goal, Plan, Search, plan_poses
from symstiff.calibration.planning.frames import Geometry, geometry
from symstiff.calibration.planning.loads import Load
from symstiff.calibration.planning.measurement import Measurement, measurement_of
from symstiff.calibration.planning.parallel import map_blocks
from symstiff.calibration.planning.poses import poses_table
from symstiff.calibration.planning.region import Box, HalfSpace, Region, above_floor
from symstiff.calibration.planning.workspace import WorkspaceMap, workspace_map

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
    "WorkspaceMap",
    "above_floor",
    "geometry",
    "map_blocks",
    "measurement_of",
    "plan_poses",
    "poses_table",
    "workspace_map",
]
