"""Where a robot's tool centre point stands in its file, and the same robot with it elsewhere."""

from __future__ import annotations

from symstiff.robot.loading import from_table
from symstiff.robot.schema import Robot
from symstiff.robot.table import to_table

Xyz = tuple[float, float, float]


def tool_of(robot: Robot) -> Xyz:
    """``xyz`` of [tool], m."""
    x, y, z = (float(value) for value in robot.tool.xyz)
    return x, y, z


def with_tool(robot: Robot, xyz: Xyz) -> Robot:
    """The robot with another ``xyz`` of [tool], m."""
    table = to_table(robot)
    table["tool"] = {**table.get("tool", {}), "xyz": list(xyz)}
    return from_table(table, robot.name)
