"""When the complete model takes the place of the joints-only one, and an arm whose frames are off that of the drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.simulation import Effect, Noise, Truth, nominal_truth, simulate
from symstiff.calibration.tables.measurements import measurements
from symstiff.discrepancy.climb import Wider, frames_of, links_leave_less
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.findings.result import Diagnosis, Name, Quantity, Rms
from symstiff.discrepancy.reasons import Why
from symstiff.discrepancy.search.localise import FittedDevice
from symstiff.discrepancy.workflow import diagnose
from symstiff.model import joints_only
from symstiff.report.folder import write_report
from symstiff.robot import load
from tests.diagnosis_data import ROBOT, measured
from tests.test_arm_as_it_is import NOISE, positions
from tests.test_assemble import design, truth_of
from tests.test_assemble import measured as arms

ROWS = 400


@pytest.fixture(scope="module")
def some() -> Diagnosis:
    return diagnose(Task(load(ROBOT), measured())).last


@pytest.mark.parametrize(
    ("wider", "better"),
    [
        (Rms(1.0, 1.0, 1.2, 1.0, 0.9), True),
        (Rms(1.0, 1.0, 5.0, 1.0, 0.9), False),
        (Rms(1.0, 1.0, None, None, 0.9), True),
        (Rms(3.0, 1.0, 1.2, 1.0, 0.9), False),
    ],
)
def test_a_model_that_left_out_poses_refute_does_not_take_over(
    some: Diagnosis, wider: Rms, better: bool
) -> None:
    """Four poses fit all links and predict none."""
    narrow = replace(some, verdict="unexplained", rms=Rms(2.0, 2.0, 2.1, 2.1, 0.9))
    axes = np.zeros(ROWS, dtype=np.intp)
    assert links_leave_less(replace(some, rms=wider), narrow, axes, ROWS) is better


@pytest.mark.parametrize(("explained", "better"), [(0.3, False), (0.05, True)])
def test_a_law_of_the_device_is_a_simpler_account_than_all_links(
    some: Diagnosis, explained: float, better: bool
) -> None:
    """Fourteen parameters that explain a quarter of 400 squares, and one that explains more of them, or little."""
    noise = some.noise.by_component()[0]
    step, left = some.growth[0], np.full(ROWS, noise)
    law = FittedDevice("measuring device", (("scale error", 80.0, 5.0, "ppm"),), explained)
    narrow = replace(
        some,
        verdict="unexplained",
        device_law=law,
        growth=(replace(step, residual=left, known=2),),
        rms=Rms(2.0, 2.0, 2.1, 2.1, 0.9),
    )
    whole = replace(step, residual=left * np.sqrt(0.75), known=16)
    wide = replace(some, growth=(whole,), rms=Rms(1.0, 1.0, 1.2, 1.0, 0.9))
    assert links_leave_less(wide, narrow, np.zeros(ROWS, dtype=np.intp), ROWS) is better


@pytest.mark.parametrize(
    ("explained", "held_out", "shared", "better"),
    [
        (0.0, 0.9, 0.0, False), (14.0, 0.9, 0.0, False), (60.0, 0.9, 0.0, True), (60.0, 1.1, 0.0, False),
        (60.0, 0.9, 0.5, False),  # what ten rows of a reading share may be 2.8 times as much
    ],
)  # fmt: skip
def test_links_that_were_named_give_way_to_what_is_significantly_more(
    some: Diagnosis, explained: float, held_out: float, shared: float, better: bool
) -> None:
    """Ten parameters more explain χ² of 10 ± 4.5 by chance, and of 60 with 4e-9."""
    noise = some.noise.by_component()[0]
    left = np.full(ROWS, noise)
    less = left * np.sqrt(1.0 - explained / ROWS)
    sizes = {f"k1_{k}{k}": Quantity(1e-7, 1e-8, "rad/(N*m)") for k in range(1, 5)}
    step = some.growth[0]
    name = Name("link_compliance", {"link": 1})
    few = replace(step, residual=left, known=6, effects=((name, sizes),), gained=4)
    whole = replace(step, residual=less, known=16, effects=())
    narrow = replace(
        some,
        verdict="named",
        growth=(replace(step, known=2), few),
        rms=Rms(2.0, 1.0, 2.1, 1.0, 0.9),
    )
    shares = replace(some.noise, approach=shared * some.noise.sigma)
    wide = replace(some, growth=(whole,), rms=Rms(1.0, 1.0, held_out, held_out, 0.9), noise=shares)
    assert links_leave_less(wide, narrow, np.zeros(ROWS, dtype=np.intp), ROWS // 10) is better


@pytest.mark.parametrize(
    ("left_by_frames", "law", "held_out", "better"),
    [(0.3, 0.0, 0.9, True), (0.9, 0.0, 0.9, False), (0.3, 0.6, 0.9, False), (0.3, 0.0, 1.1, False)],
)
def test_all_frames_have_to_explain_far_more_than_few_or_a_law_without_a_name(
    some: Diagnosis, left_by_frames: float, law: float, held_out: float, better: bool
) -> None:
    """400 rows: 20 constants more cost 20·log 400 = 120 by Schwarz, twice that is asked; 0.3 of the squares is 482."""
    step, left = some.growth[0], np.full(ROWS, some.noise.by_component()[0])
    fitted = FittedDevice("measuring device", (("scale error", 80.0, 5.0, "ppm"),), law)
    narrow = replace(
        some, verdict="unexplained", device_law=fitted, law=None, rms=Rms(2.0, 1.0, 2.1, 1.0, 0.9),
        growth=(replace(step, residual=left, known=6),),
    )  # fmt: skip
    whole = replace(step, residual=left * np.sqrt(left_by_frames), known=26)
    wide = replace(some, growth=(whole,), rms=Rms(1.0, 1.0, held_out, held_out, 0.9))
    robot = load("kuka_kr270")
    frames = Wider(joints_only(robot), "frames", Why.FRAMES, "", frames_of(robot), 2.0)
    assert [dict(e.where) for e in frames.parts] == [{"link": i} for i in range(1, 7)]
    assert frames.leaves_less(wide, narrow, np.zeros(ROWS, dtype=np.intp), np.arange(ROWS)) is better


@pytest.mark.parametrize(
    ("left_by_links", "prices", "named", "better"),
    [
        (0.3, 1.0, None, True),
        (0.8, 1.0, None, False),
        (0.8, 0.0, None, True),  # deflections, in which no geometry bends along
        (0.3, 1.0, 0.31, True),  # three links leave hardly more, and do not suffice
    ],
)
def test_all_links_join_absolute_positions_where_they_are_worth_their_price(
    some: Diagnosis, left_by_links: float, prices: float, named: float | None, better: bool
) -> None:
    """400 rows: 20 compliances more cost 20·log 400 = 120 by Schwarz; 0.3 of the squares is 482, 0.8 of them 89."""
    step, left = some.growth[0], np.full(ROWS, some.noise.by_component()[0])
    growth = (replace(step, residual=left, known=6),)
    if named is not None:
        growth += (replace(step, residual=left * np.sqrt(named), known=24),)
    narrow = replace(
        some, verdict="unexplained" if named is None else "named_insufficient", device_law=None, law=None,
        growth=growth, rms=Rms(2.0, 1.0, 2.1, 1.0, 0.9),
    )  # fmt: skip
    whole = replace(step, residual=left * np.sqrt(left_by_links), known=26)
    wide = replace(some, growth=(whole,), rms=Rms(1.0, 1.0, 0.9, 0.9, 0.9))
    links = Wider(joints_only(load("kuka_kr270")), "links", Why.LINKS, "", prices=prices)
    assert links.leaves_less(wide, narrow, np.zeros(ROWS, dtype=np.intp), np.arange(ROWS)) is better


@pytest.mark.parametrize(
    ("verdict", "few", "left", "better"),
    [
        ("named", 2, 0.5, True),
        ("nothing_missing", 2, 0.5, True),
        ("named", 1, 0.5, False),
        ("named_insufficient", 2, 0.5, False),
        ("named", 2, 0.97, False),
    ],
)
def test_all_frames_take_the_place_of_few_that_leave_no_room_for_what_is_missing_besides(
    some: Diagnosis, verdict: str, few: int, left: float, better: bool
) -> None:
    """Four parameters more at the end: 4·log 400 = 24, of 400·log(1/0.97) = 12 and 400·log 2 = 277."""
    robot = load("kuka_kr270")
    frames = Wider(joints_only(robot), "frames", Why.FRAMES, "", frames_of(robot), 2.0)
    step, left_now = some.growth[0], np.full(ROWS, some.noise.by_component()[0])
    last = replace(step, residual=left_now, known=16)
    leading = tuple((Name("geometric_error", {"link": i + 1}), {}, {}) for i in range(few))
    start = replace(step, residual=3 * left_now, known=6)
    narrow = replace(
        some, verdict="named_insufficient", device_law=None, law=None, growth=(start, last), leading=leading,
        rms=Rms(2.0, 1.0, 2.1, 1.0, 0.9),
    )  # fmt: skip
    first = replace(step, residual=left_now, known=18)
    end = replace(step, residual=left_now * np.sqrt(left), known=20)
    wide = replace(some, verdict=verdict, growth=(first, end), rms=Rms(1.0, 0.7, 1.0, 0.9, 0.9))
    axes = np.zeros(ROWS, dtype=np.intp)
    assert frames.leaves_less(wide, narrow, axes, np.arange(ROWS)) is better
    assert frames.leaves_less(wide, replace(narrow, verdict="named"), axes, np.arange(ROWS)) is better
    assert not frames.leaves_less(wide, replace(narrow, verdict="unexplained"), axes, np.arange(ROWS) // 2)
    assert not frames.leaves_less(
        wide, narrow, axes, np.arange(ROWS) // 40
    )  # ten readings, whatever the rows


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kuka_kr270", "ur10"])
def test_a_gap_is_named_behind_errors_of_all_frames(name: str, tmp_path: Path) -> None:
    """An arm that nobody calibrated, three tenths of a millimetre and of a milliradian off at every link."""
    robot, rng = load(name), np.random.default_rng(2)
    off = [
        Effect("geometric_error", {"link": i}, "constant", {"shift": (3e-4 * rng.normal(size=6)).tolist()})
        for i in range(1, robot.dof + 1)
    ]
    gap = Effect("backlash", {"joint": 2}, "tanh", {"gap": 8e-4})
    found = diagnose(Task(robot, positions(name, (*off, gap), 2, 60), "joints"))
    assert found.verdict == "named"
    places = [(e.effect, dict(e.where)) for e in found.named]
    assert places == [*(("geometric_error", {"link": i}) for i in range(1, 7)), ("backlash", {"joint": 2})]
    assert found.model.values["backlash_2_gap"] == pytest.approx(8e-4, abs=6e-5)
    assert [s.title for s in found.steps[:2]] == ["start model", "frames of all links"]
    assert found.rms.after < 1.1 * NOISE
    assert 0.8 < found.last.noise.ratio < 1.2  # type: ignore[operator]
    write_report(found, tmp_path / "report")
    page = (tmp_path / "report" / "report.html").read_text()
    assert "Zero, as these data do not tell them from the others" in page
    assert "geometric_error_1_x</code>" in page


@pytest.mark.slow
def test_links_that_give_way_are_found_from_the_joints_in_loaded_positions() -> None:
    """Three of them leave hardly more than all seven do, and are no arm."""
    table = arms(truth_of("ur10"), design("ur10", "absolute", 24, (0.0, 0.5, 1.0, 0.8)))
    noise = 2e-5 * np.random.default_rng(1).normal(size=table.values.shape)
    table = replace(table, values=table.values + noise, sigma=np.full(table.values.shape, 2e-5))
    found = diagnose(Task(load("ur10"), table, "joints"))
    assert found.verdict == "named"
    assert {e.effect for e in found.effects} == {"link_compliance"}
    assert len(found.effects) > 4


@pytest.mark.slow
def test_elastic_links_are_found_beside_what_else_is_missing() -> None:
    """Beside rigid links nothing accounts for the data; a joint's offset leads, and no link."""
    robot, rng = load("ur10"), np.random.default_rng(4)
    limits = np.array([j.range for j in robot.joint]) / 2
    bare = measurements(rng.uniform(*limits.T, (40, robot.dof)), kind="absolute")
    softer = Effect("nonlinear_stiffness", {"joint": 2}, "tanh", {"a": 1.5e-3, "tau0": 100.0})
    offset = Effect("joint_offset", {"joint": 3}, "constant", {"offset": 1e-3})
    truth = Truth(robot, nominal_truth(robot), (softer, offset), Noise((0.02,) * 3))
    found = diagnose(Task(robot, simulate(truth, bare, 4), "joints"))
    assert found.verdict == "named"
    others = {(e.effect, *e.where.values()) for e in found.named if e.effect != "link_compliance"}
    assert others == {("nonlinear_stiffness", 2), ("joint_offset", 3)}
    assert [s.title for s in found.steps][:2] == ["start model", "complete model (all links elastic)"]
