"""Joints under each other's load, links that follow another joint's angle: columns against the simulator, verdicts."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import Laws, Situation, look
from symstiff.calibration.simulation import Effect, Truth, clean_response
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.laws.posture import posture_laws
from symstiff.discrepancy.problem import DeviceLaw
from symstiff.discrepancy.workflow import diagnose
from symstiff.effects.instance import EffectInstance
from symstiff.report.words import sentence
from symstiff.robot import load
from tests.test_assemble import design, truth_of
from tests.test_drawing import poses, true_laws
from tests.test_sensors import read


def laws_and_change(name: str, *effects: Effect) -> tuple[list[DeviceLaw], np.ndarray]:
    """The laws at the true compliances, and what effects change (M,) by the simulator."""
    table, (terms, values) = poses(name), true_laws(name)
    view = look(load(name), table)
    context = {"points": table.points, "point": table.point}
    truths = Truth(load(name), values), Truth(load(name), values, effects)
    before, after = (clean_response(truth, table.q, table.w, context) for truth in truths)
    change = (after - before)[view.state, view.component]
    return list(posture_laws(Situation(view, Laws(view, terms, values)))), change


def left(block: np.ndarray, change: np.ndarray) -> float:
    """Share of a change that columns do not explain."""
    fitted = block @ np.linalg.lstsq(block, change, rcond=None)[0]
    return float(np.linalg.norm(change - fitted) / np.linalg.norm(change))


@pytest.mark.parametrize(("link", "joint", "order"), [(2, 3, 1), (3, 5, 2), (0, 2, 1)])
def test_a_link_that_follows_an_angle_is_what_the_simulator_shows(link: int, joint: int, order: int) -> None:
    values = {"fraction": 0.02, "joint": float(joint), "order": float(order), "phase": 0.4}
    effect = Effect("configuration_dependent_link", {"link": link}, "sine", values)
    laws, change = laws_and_change("ur10", effect)
    own = [
        x.values for x in laws if x.place == f"link {link}" and x.title == f"compliance that follows q{joint}"
    ]
    assert left(own[order - 1], change) < 0.02
    assert left(own[2 - order], change) > 0.3


@pytest.mark.parametrize("pair", [(2, 3), (1, 4), (3, 6)])
def test_joints_under_each_others_load_are_what_the_simulator_shows(pair: tuple[int, int]) -> None:
    effect = Effect("wrist_coupling", {"joints": list(pair)}, "linear", {"c": 1e-8})
    laws, change = laws_and_change("ur10", effect)
    (own,) = (x.values for x in laws if x.place == f"joints {pair[0]} and {pair[1]}")
    assert np.linalg.norm(1e-8 * own[:, 0] - change) < 0.02 * np.linalg.norm(change)


def test_what_wrist_joints_share_is_in_the_catalogue() -> None:
    laws, _ = laws_and_change("ur10", Effect("wrist_coupling", {"joints": [5, 6]}, "linear", {"c": 1e-8}))
    assert not {"joints 4 and 5", "joints 4 and 6", "joints 5 and 6"} & {x.place for x in laws}


@pytest.mark.slow
def test_a_link_that_follows_an_angle_is_no_asymmetry() -> None:
    values = {"fraction": 0.5, "joint": 3.0, "order": 2.0, "phase": 0.4}
    effect = Effect("configuration_dependent_link", {"link": 2}, "sine", values)
    found = diagnose(
        Task(load("ur10"), read(design("ur10", "deflection", poses=30), truth_of("ur10", effect), 8))
    )
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place.startswith("link")
    assert law.terms[0][0] == "compliance that follows q3: sin(2*q3)"
    assert "a compliance that follows q3 (sin(2·q3) " in sentence(found)


@pytest.mark.slow
def test_a_belt_between_two_joints_is_told_with_both() -> None:
    effect = Effect("wrist_coupling", {"joints": [2, 4]}, "linear", {"c": 2e-6})
    found = diagnose(
        Task(load("ur10"), read(design("ur10", "deflection", poses=30), truth_of("ur10", effect), 8))
    )
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "joints 2 and 4"
    assert law.terms[0][1] == pytest.approx(2e-6, abs=4 * law.terms[0][2])
    assert "the evidence is strongest at joints 2 and 4" in sentence(found)


def test_a_frame_that_is_off_is_no_spring_that_follows_an_angle() -> None:
    """Links that are rigid, whose frames are off, give way under no load; beside a spring nothing is added to it."""
    off = EffectInstance("geometric_error", {"link": 2}).realise(load("ur10"))
    frames = {p.name: 1e-3 for p in off.parameters}
    view, (terms, values) = look(load("ur10"), poses("ur10")), true_laws("ur10")
    rigid = posture_laws(Situation(view, Laws(view, tuple(off.terms), frames)))
    assert not [x for x in rigid if x.place.startswith("link") and "follows" in x.title]
    springs = list(posture_laws(Situation(view, Laws(view, terms, values))))
    beside = list(posture_laws(Situation(view, Laws(view, (*terms, *off.terms), values | frames))))
    for one, other in zip(springs, beside, strict=True):
        assert other.values == pytest.approx(one.values, abs=1e-15)
