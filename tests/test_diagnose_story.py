"""The seed's own story out of the data: joints, then links, then the gravity compensator (J1 → C1 → C2)."""

from __future__ import annotations

from dataclasses import replace

import pytest

from symstiff.calibration.plan import Goal, Load, Search
from symstiff.calibration.plan import plan as choose_poses
from symstiff.calibration.planning import Region, above_floor
from symstiff.calibration.seed_tables import FORCE, LEVELS, MARKERS, REACH, ROBOT, truth
from symstiff.calibration.simulation.experiment import simulate
from symstiff.calibration.simulation.truth import Noise
from symstiff.calibration.tables.poses import with_markers
from symstiff.discrepancy.climb import that_has
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.report.verdict import verdict_table
from symstiff.robot import load


@pytest.fixture(scope="module")
def found() -> Finding:
    """The seed's virtual robot, 20 of its poses, and a tracker good to 0.01 mm."""
    robot = load(ROBOT)
    plan = choose_poses(
        StiffnessModel.of(reduce(robot, "gravity", "pose")),
        Goal(20, "D"),
        Load("gravity", FORCE),
        MARKERS,
        (30e-6, 100e-6),
        Region((), (above_floor(0.3),), REACH),
        levels={2: LEVELS},
        search=Search(candidates=4000, starts=3, seed=1, refine=False),
    )
    quiet = replace(truth(), noise=Noise(sigma_mm=(0.01, 0.01, 0.01)))
    table = simulate(quiet, with_markers(plan.q, plan.w, MARKERS), 1)
    return diagnose(Task(robot, table, "joints"))


def test_links_then_the_compensator_come_out_of_the_data(found: Finding) -> None:
    assert found.verdict == "named"
    places = [(e.effect, dict(e.where)) for e in found.named]
    assert ("gravity_compensator", {"joint": 2}) in places
    links = [where["link"] for effect, where in places if effect == "link_compliance"]
    assert links == sorted(set(links))
    assert len(links) >= 5
    assert places.index(("gravity_compensator", {"joint": 2})) > max(
        k for k, (effect, _) in enumerate(places) if effect == "link_compliance"
    )


def test_every_step_shrinks_the_gap_until_the_noise_is_left(found: Finding) -> None:
    sizes = [float((s.residual**2).mean()) ** 0.5 for s in found.steps]
    assert sizes == sorted(sizes, reverse=True)
    assert found.steps[0].parameters == 5
    assert found.steps[1].parameters == 26
    assert found.rms.held_out_after is not None
    assert found.rms.held_out_after < 1.5e-5
    assert found.rms.held_out_before is not None
    assert found.rms.held_out_before > 2e-4


def test_the_closed_share_of_the_gap_is_counted_from_the_start_model(found: Finding) -> None:
    """From the joints to what is named, in the rooms' figures, the page and verdict.json alike."""
    told = verdict_table(found)
    mm = told["rms_mm"]
    gap = mm["held_out_before"] - mm["noise"]
    assert told["closure"] == pytest.approx((mm["held_out_before"] - mm["held_out_after"]) / gap)
    assert told["closure"] > 0.97
    assert told["confirmed"] is True


def test_the_remark_says_that_the_complete_model_took_over(found: Finding) -> None:
    assert any("complete model" in remark for remark in found.remarks)


def test_what_the_complete_model_keeps_are_sums_whose_sign_is_no_reason_for_doubt(found: Finding) -> None:
    sizes = [(n, e) for f in found.named if f.effect == "link_compliance" for n, e in f.parameters.items()]
    assert any(n[-1] == n[-2] and e.value + e.std < 0 for n, e in sizes)
    assert not any("link compliance" in remark and "is physical" in remark for remark in found.remarks)


@pytest.mark.parametrize(
    ("link", "parameters", "effect"),
    [
        (0, ("k0_33", "k0_44"), "link_compliance"),
        (3, ("k3_22",), "link_compliance"),
        (0, ("k0_33", "k0_12"), "base_compliance"),
        (6, ("k6_33", "k6_12"), "tool_compliance"),
        (3, ("k3_22", "k9_22"), ""),
    ],
)
def test_a_link_of_the_complete_model_is_called_by_the_effect_that_has_its_parameters(
    link: int, parameters: tuple[str, ...], effect: str
) -> None:
    """Whatever leads on the joints-only model: a base block may, and the base is no place for the other links."""
    assert that_has(load("ur10"), {"link": link}, parameters) == effect
