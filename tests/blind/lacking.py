"""What a start model lacks that the robot has: rigid links, compliances left out."""

from __future__ import annotations

from symstiff.robot import Robot, from_table
from symstiff.robot.table import to_table
from tests.blind.stories import Where


def rigid_links(robot: Robot, only: int | None = None) -> Robot:
    """The robot with rigid links, or with one rigid link."""
    table = to_table(robot)
    places = [table.setdefault("base", {}), *table["joint"]]
    for i, place in enumerate(places):
        if only is None or i == only:
            place["link"] = {**place.get("link", {}), "template": "rigid"}
    return from_table(table)


def without(values: dict[str, float], where: Where) -> dict[str, float]:
    """The compliances without those of one joint or link."""
    if "joint" in where:
        return {n: v for n, v in values.items() if n != f"c{where['joint']}"}
    return {n: v for n, v in values.items() if not n.startswith(f"k{where['link']}_")}
