"""A link that weighs more than its file tells, at its centre of mass or at its frame: one size instead of four."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.registry import find
from symstiff.model import joints_only
from symstiff.report.naming import shape_text
from symstiff.robot import Robot, from_table, load
from symstiff.robot.table import to_table
from tests.test_assemble import of

CENTRED, AT_FRAME = {"centred": 1.0}, {"at_frame": 1.0}


def positions(robot: Robot, mass: float, com: tuple[float, ...], poses: int = 45) -> Measurements:
    """What a tracker with 0.01 mm noise reads of an arm whose third link is that much heavier."""
    rng = np.random.default_rng(8)
    q = np.array([[rng.uniform(*joint.range) for joint in robot.joint] for _ in range(poses)])
    table = measurements(
        np.repeat(q, 3, axis=0), np.zeros((3 * poses, 6)), pose=np.repeat(np.arange(poses), 3), kind="absolute",
        points=("p1", "p2", "p3"), point=np.tile([0, 1, 2], poses),
    )  # fmt: skip
    heavier = Effect("link_weight", {"link": 3}, "", {"mass": mass, "com": list(com)})
    return simulate(
        Truth(
            robot,
            {n: c for n, c in nominal_truth(robot).items() if n[0] == "c"},
            (heavier,) if mass else (),
            Noise((0.01,) * 3),
        ),
        table,
        2,
    )


def test_the_mass_alone_is_one_direction_of_mass_and_first_moment() -> None:
    robot = load("ur10")
    found = assemble(joints_only(robot), positions(robot, 0.0, (0.0, 0.0, 0.0)))
    for link in range(2, 7):  # link 1 turns about the vertical
        com = robot.links[link].com
        at = {"link": link}
        candidate = of(found, "link_weight", at)
        assert candidate.shapes == ({}, CENTRED, AT_FRAME)
        four, *ones = (candidate.block(s) for s in candidate.shapes)
        for one, place in zip(ones, (com, (0.0, 0.0, 0.0)), strict=True):
            assert one.shape[1] == 1
            assert one[:, 0] == pytest.approx(four @ [1.0, *place], rel=1e-6, abs=1e-9 * np.abs(four).max())


def test_a_link_of_which_the_file_tells_no_mass_has_no_centre_of_mass() -> None:
    table = to_table(load("ur10"))
    del table["joint"][2]["link"]["mass"]
    robot, scales = from_table(table, "heavier"), None
    shapes = [find("link_weight").shapes(robot, {"link": i}, scales) for i in (2, 3)]  # type: ignore[arg-type]
    assert shapes == [({}, CENTRED, AT_FRAME), ({},)]


@pytest.mark.slow
@pytest.mark.parametrize("where", ["told", "elsewhere"])
def test_the_link_that_is_heavier_is_named(where: str) -> None:
    """By its mass alone where that does; a mass that sits elsewhere is told with its first moment."""
    robot = load("ur10")
    com = robot.links[3].com if where == "told" else (-0.25, 0.15, 0.2)
    found = diagnose(Task(robot, positions(robot, 4.0, com), "joints"))
    assert (found.verdict, [(e.effect, dict(e.where)) for e in found.named]) == (
        "named", [("link_weight", {"link": 3})],
    )  # fmt: skip
    (effect,) = found.named
    assert dict(effect.shape) == (CENTRED if where == "told" else {})
    mass = effect.parameters["link_weight_3_m"]
    if where == "told":
        assert mass.value == pytest.approx(4.0, abs=3 * mass.std)
        assert "its centre of mass where the robot file tells it" in shape_text(found, effect)
