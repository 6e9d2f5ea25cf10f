"""Robot files that are taken as they are, with a doubt: angles that are nearly right, joints without a place."""

from __future__ import annotations

import math

import pytest

from symstiff.reduction import reduce
from symstiff.reduction.remarks import reduction_remarks
from symstiff.robot import from_table, load
from symstiff.robot.table import to_table


@pytest.mark.parametrize("small", [6.123233995736766e-17, -1e-12])
def test_an_angle_that_is_zero_but_for_rounding_is_zero(small):
    """As other programs write the cosine of a quarter turn: parallel axes stay parallel."""
    table = to_table(load("ur10"))
    table["joint"][1]["alpha"] = small
    assert from_table(table, "ur10").joint[1].alpha == load("ur10").joint[1].alpha


def test_an_angle_near_zero_is_doubted():
    table = to_table(load("ur10"))
    table["joint"][1]["alpha"] = 1e-5
    remarks = reduction_remarks(reduce(from_table(table, "ur10"), "gravity"))
    assert any('alpha of joint 2: 1e-05 is not quite 0: write "0"' in r for r in remarks)
    assert not any("not quite" in r for r in reduction_remarks(reduce(load("ur10"), "gravity")))


@pytest.mark.parametrize("place", ["base", "tool"])
@pytest.mark.parametrize(("k", "turn"), [(0, "roll"), (1, "pitch"), (2, "yaw")])
def test_a_base_or_tool_nearly_square_to_the_world_is_doubted(place: str, k: int, turn: str) -> None:
    """As a wall-mounted arm: with 1.5708 for its roll the weight of a load has a share along the vertical axes."""

    def remarks(angle: object) -> list[str]:
        rpy: list[object] = [0, 0, 0]
        rpy[k] = angle
        table = to_table(load("planar2r"))
        table[place] = table.get(place, {}) | {"rpy": rpy}
        return reduction_remarks(reduce(from_table(table, "turned"), "gravity"))

    assert remarks(3.1416) == [
        f'{turn} in {place}.rpy: 3.1416 is not quite pi: write "pi" where that is meant'
    ]
    assert remarks("pi") == remarks(math.pi) == remarks(1.2) == []


@pytest.mark.parametrize(
    ("kind", "motion"), [("prismatic", "translation along"), ("revolute", "rotation about")]
)
def test_a_joint_that_a_template_cannot_hold_is_told_with_its_motion(kind, motion):
    link = {"template": "bend", "beam_axis": "x"}
    first = {"a": 0.5, "alpha": "pi/2", "d": 0.1, "link": link, "type": kind}
    first |= {"limits": [0, 1]} if kind == "prismatic" else {}
    pattern = ["......"] * 4 + ["....*.", ".....*" if kind == "prismatic" else "......"]
    table = {
        "format": 1, "name": "arm", "base": {"link": link}, "template": [{"name": "bend", "pattern": pattern}],
        "joint": [first, {"a": 0.4, "alpha": 0, "d": 0, "link": link}],
    }  # fmt: skip
    told = [r for r in reduction_remarks(reduce(from_table(table, "arm"))) if r.startswith("M3 gives c1")]
    assert len(told) == 1
    assert f"a {motion} that joint's axis" in told[0]
