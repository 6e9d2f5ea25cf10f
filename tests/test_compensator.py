"""A gravity compensator whose anchors the robot file tells: its direction is kept unless the data speak against it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.kept import seen_in
from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.simulation.truth import Device
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.base import Scales
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import find
from symstiff.report.naming import shape_text
from symstiff.robot import load, parse
from symstiff.symbolic.terms import q
from tests.test_assemble import design, readings

ROBOT = "kuka_kr270"
FILE = math.atan2(0.1233, 0.68593)


def diagnosed(zero: float, noise: float, seed: int) -> Finding:
    """Diagnosis of data with a spring whose zero is not that of the file's q, by ``zero`` [rad]."""
    table = design(ROBOT, "deflection", poses=24)
    table = replace(table, w=4.0 * table.w)
    spring = Effect("gravity_compensator", {"joint": 2}, "spring", {"rate": 4.5e6, "zero": zero})
    values = readings(Truth(load(ROBOT), nominal_truth(load(ROBOT)), (spring,)), table)
    values[:, :3] += np.random.default_rng(seed).normal(size=(len(table), 3)) * noise
    values[:, 3:] = np.nan
    return diagnose(Task(load(ROBOT), replace(table, values=values)))


def _compensator(found: Finding) -> EffectInstance:
    (only,) = (e.instance for e in found.effects if e.effect == "gravity_compensator")
    return only


@pytest.mark.slow
def test_the_files_anchor_is_found_and_nothing_is_said_of_a_turn() -> None:
    found = diagnosed(0.0, 2e-5, 0)
    assert found.verdict == "named"
    assert "turned" not in _compensator(found).shape
    assert _compensator(found).shape["alpha"] == pytest.approx(FILE, abs=1e-8)
    assert not any("turned" in remark for remark in found.remarks)


@pytest.mark.slow
def test_a_spring_whose_zero_is_elsewhere_is_named_and_said_to_be_turned() -> None:
    found = diagnosed(2.0, 1e-5, 0)
    assert found.verdict == "named"
    assert _compensator(found).shape["turned"] == pytest.approx(-2.0, abs=math.radians(20))
    (remark,) = (r for r in found.remarks if "anchor were turned by" in r)
    assert remark.startswith("gravity compensator at joint 2: ")
    effect = next(e for e in found.effects if e.effect == "gravity_compensator")
    assert "anchor at 0.1779 rad, turned by -2.094 rad from there" in shape_text(found, effect)


def test_shapes_keep_what_the_file_tells_and_doubt_other_directions() -> None:
    """All directions but the file's share one part in four, the table of angles has what it has without a file."""
    robot, effect = load(ROBOT), find("gravity_compensator")
    shapes = effect.shapes(robot, {"joint": 2}, Scales(angles=((), (-1.0, 0.0))))
    springs = [s for s in shapes if "alpha" in s]
    (known,) = {(s["a"], s["L"], s["s0"], s["alpha"]) for s in springs}
    assert known == pytest.approx((math.hypot(0.68593, 0.1233), 0.18472, 0.458, FILE), abs=1e-8)
    assert all(abs(s.get("turned", 0.0)) <= math.pi for s in springs)
    told, turned = ([effect.odds(robot, s) for s in springs if ("turned" in s) == t] for t in (False, True))
    assert sum(told) / (sum(told) + sum(turned)) == pytest.approx(0.75)
    assert effect.odds(robot, shapes[-1]) / sum(told + turned) == pytest.approx(1 / len(springs))
    assert all(
        effect.odds(load("ur10"), s) == 1.0 for s in effect.shapes(load("ur10"), {"joint": 2}, Scales())
    )


def test_a_turned_anchor_is_one_at_the_sum_of_the_angles() -> None:
    robot, at = load(ROBOT), {"joint": 2}
    turned = EffectInstance("gravity_compensator", at, {"alpha": 0.4, "turned": 0.3})
    summed = EffectInstance("gravity_compensator", at, {"alpha": 0.7})
    (a,), (b,) = turned.realise(robot).terms, summed.realise(robot).terms
    assert float((a.factor - b.factor).subs(q(2), 0.37).subs("tau_joint2", 1.0)) == pytest.approx(
        0.0, abs=1e-12
    )
    assert turned.unread(robot) == ()


@pytest.mark.parametrize(("robot", "told"), [("ur10", True), (ROBOT, False)])
def test_where_the_file_tells_of_no_compensator_the_name_says_what_else_it_may_be(
    robot: str, told: bool
) -> None:
    shape = {"a": 1.0, "L": 0.3, "s0": 0.5, "alpha": 0.4}
    said = EffectInstance("gravity_compensator", {"joint": 2}, shape).assumptions(load(robot))
    assert any("the robot file tells of no compensator" in remark for remark in said) is told


SLIDE = '[[joint]]\ntype = "prismatic"\na = 0\nd = 0\nalpha = "pi/2"\ntheta = 0\nlimits = [0, 2]\n'
SHOULDER = '[[joint]]\na = 0\nalpha = "{}"\nd = 0.4\nlimits = [-2, 2]\n'
ARM = "[[joint]]\na = 0.6\nalpha = 0\nd = 0\nlimits = [-2, 2]\n"


@pytest.mark.parametrize(
    ("joints", "places"),
    [
        (SHOULDER.format("pi/2") + ARM + ARM, [{"joint": 2}]),
        (SLIDE + SHOULDER.format("pi/2") + ARM + ARM, [{"joint": 3}]),
        (SLIDE + SHOULDER.format("0") + ARM, []),  # axes that stay upright carry no weight
        (SHOULDER.format("pi/2") + SLIDE + ARM, []),
        (SLIDE + ARM, []),
    ],
)
def test_a_compensator_is_looked_for_at_the_second_joint_that_turns(
    joints: str, places: list[dict[str, int]]
) -> None:
    """An arm on a track has its shoulder at joint 3."""
    robot = parse(f'format = 1\nname = "arm"\n{joints}'.encode())
    assert [dict(place) for place in find("gravity_compensator").places(robot)] == places


WEIGHING = """a = 0.6
alpha = 0
d = 0
limits = [-2, 2]
link = {{ mass = {} }}
"""


@pytest.mark.parametrize(
    ("mass", "spring", "told"),
    [(80, "", True), (5, "", False), (80, "[gravity_compensator]\njoint = 2\n", False)],
)
def test_a_lighter_link_of_a_heavy_arm_may_be_a_compensator_that_nobody_told_of(
    mass: float, spring: str, told: bool
) -> None:
    joints = SHOULDER.format("pi/2") + ("[[joint]]\n" + WEIGHING.format(mass)) * 2
    robot = parse(f'format = 1\nname = "arm"\n{joints}{spring}'.encode())
    said = EffectInstance("link_weight", {"link": 2}, {"centred": 1.0}).assumptions(robot)
    assert any("enter its joint under [gravity_compensator]" in remark for remark in said) is told


def test_positions_have_a_form_for_the_springs_moment_where_the_file_tells_of_one() -> None:
    effect, absolute = find("gravity_compensator"), Scales(kind="absolute")
    for scales, robot, forms in ((absolute, ROBOT, 1), (Scales(), ROBOT, 0), (absolute, "ur10", 0)):
        shapes = effect.shapes(load(robot), {"joint": 2}, scales)
        assert sum("moment" in shape for shape in shapes) == forms


def test_the_moment_is_the_slope_of_the_springs_energy() -> None:
    """By differences of ½·(s − s₀)², s the distance of two points: nothing of the module's formula."""
    form = EffectInstance("gravity_compensator", {"joint": 2}, {"moment": 1.0})
    (term,) = form.realise(load(ROBOT)).terms
    angles = np.linspace(-2.0, 1.0, 7)

    def energy(angle: np.ndarray) -> np.ndarray:
        arm = 0.18472 * np.exp(1j * angle)
        return 0.5 * (np.abs(arm + 0.68593 + 0.1233j) - 0.458) ** 2

    h = 1e-5
    turn = np.linspace(-math.pi, math.pi, 7201)
    moment, largest = ((energy(x + h) - energy(x - h)) / (2 * h) for x in (angles, turn))
    law = np.array([float(term.factor.subs(q(2), x)) for x in angles])
    assert law == pytest.approx(-moment / np.abs(largest).max(), abs=1e-5)


def positions(poses: int, rate: float, seed: int) -> Measurements:
    """Positions of an arm whose zeros were set without its spring."""
    robot, rng = load(ROBOT), np.random.default_rng(seed)
    limits = np.array([j.range for j in robot.joint])
    q = np.repeat(rng.uniform(limits[:, 0], limits[:, 1], (poses, robot.dof)), 2, axis=0)
    w = np.zeros((2 * poses, 6))
    w[1::2, :3] = rng.normal(size=(poses, 3)) * 800.0
    plan = measurements(q, w, pose=np.repeat(np.arange(poses), 2), kind="absolute")
    spring = Effect("gravity_compensator", {"joint": 2}, "spring", {"rate": rate, "preload": 1.0})
    joints = {n: v for n, v in nominal_truth(robot).items() if n.startswith("c")}
    place = Device((3.0, 1.0, 0.5), (0.0, 0.0, 2.0))
    return simulate(Truth(robot, joints, (spring,), Noise((0.02,) * 3), device=place), plan, seed)


def test_a_springs_moment_is_named_in_positions_and_kept_by_deflections() -> None:
    rate, table = 6e4, positions(24, 6e4, 1)
    found = diagnose(Task(load(ROBOT), table, "joints"))
    (only,) = found.effects
    assert only.instance.shape["moment"] == 1.0
    assert "turned" not in only.instance.shape
    turn = np.linspace(-math.pi, math.pi, 7201)
    arm = 0.18472 * np.exp(1j * turn) + 0.68593 + 0.1233j
    largest = np.abs(np.gradient(0.5 * (np.abs(arm) - 0.458) ** 2, turn)).max()
    d = only.parameters["gravity_compensator_2_d"]
    assert d.value == pytest.approx(nominal_truth(load(ROBOT))["c2"] * rate * largest, abs=4 * d.std)
    deflections, remarks = seen_in(found.model, "deflection")
    assert deflections.effects == ()
    assert "gravity compensator (2): deflections do not show it" in remarks[0]
