"""Force sensors that shear or leak, devices that turn meanwhile: columns against the simulator, verdicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import look
from symstiff.calibration.simulation import Truth
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.problem import DeviceLaw, Problem
from symstiff.discrepancy.workflow import diagnose
from symstiff.report.law_plots import draw_unnamed
from symstiff.report.words import sentence
from symstiff.robot import load
from tests.test_assemble import assemble, complete, design, measured, truth_of

PERCENT = 1e-2


def law(problem: Problem, title: str, *of: str) -> DeviceLaw:
    """The only law of that title with these columns."""
    (found,) = (
        x for x in problem.devices if x.title == title and tuple(p.name.partition(": ")[2] for p in x.parameters) == of
    )  # fmt: skip
    return found


def tool_axes(table: Measurements) -> np.ndarray:
    """(N, 3, 3) the last frame of the UR10, from its kinematics."""
    return np.asarray(look(load("ur10"), table).found.R[:, -1])


def sheared(table: Measurements, frame: np.ndarray, shear: np.ndarray) -> Measurements:
    """The table under forces that differ by ``shear`` (3, 3) in these axes from those that it tells."""
    local = np.einsum("nji,nj->ni", frame, table.w[:, :3])
    w = table.w.copy()
    w[:, :3] += np.einsum("nij,jk,nk->ni", frame, shear, local)
    return replace(table, w=w)


@pytest.mark.parametrize(
    ("tool", "title", "of", "entries"),
    [
        (True, "gain in the tool's axes", ("fx",), {(0, 0): 1.0}),
        (True, "gain in the tool's axes", ("fx and fz",), {(0, 2): 1.0, (2, 0): 1.0}),
        (False, "gain in the base's axes", ("fy and fz",), {(1, 2): 1.0, (2, 1): 1.0}),
        (
            True,
            "crosstalk of fy of the tool's axes",
            (
                "fy of the tool's axes in fx of the tool's axes",
                "fy of the tool's axes in fz of the tool's axes",
            ),
            {(2, 1): 1.0},
        ),
    ],
)
def test_a_sensors_shear_is_what_it_does_in_the_simulator(
    tool: bool, title: str, of: tuple[str, ...], entries: dict[tuple[int, int], float]
) -> None:
    table, truth = design("ur10", "deflection"), truth_of("ur10")
    frame = tool_axes(table) if tool else np.tile(np.eye(3), (len(table), 1, 1))
    shear = np.zeros((3, 3))
    for place, size in entries.items():
        shear[place] = size * PERCENT
    plain, made = measured(truth, table), measured(truth, sheared(table, frame, shear))
    found = assemble(complete("ur10"), plain, effects=())
    view = found.situation.view
    change = (made.values - plain.values)[view.state, view.component]
    column = law(found.problem, title, *of).values[:, -1]
    assert np.linalg.norm(column - change) < 0.02 * np.linalg.norm(change)


@pytest.mark.parametrize("kind", ["deflection", "absolute"])
def test_a_device_that_turned_during_the_session_is_what_the_readings_show(kind: str) -> None:
    table, truth = design("ur10", kind), truth_of("ur10")
    plain = measured(truth, table)
    begins = np.array([table.time[table.pose == p].min() for p in table.pose])
    late = (begins >= np.median(begins))[:, None]
    turned = plain.values.copy()
    turned[:, :3] += 1e-6 * late * np.cross([0.2, -0.5, 1.0], plain.values[:, :3])
    found = assemble(complete("ur10"), plain, effects=())
    view = found.situation.view
    change = (turned - plain.values)[view.state, view.component]
    laws = [x.values[:, -3:] for x in found.problem.devices if x.title == "turn from some time on"]
    left = min(np.linalg.norm(block @ [0.2e-6, -0.5e-6, 1e-6] - change) for block in laws)
    assert left < (0.02 if kind == "deflection" else 1e-3) * np.linalg.norm(change)


def read(table: Measurements, truth: Truth, seed: int) -> Measurements:
    """Readings with 0.02 mm of noise, as stated."""
    values = measured(truth, table).values.copy()
    values[:, 3:] = np.nan
    values[:, :3] += 2e-5 * np.random.default_rng(seed).normal(size=(len(table), 3))
    return replace(table, values=values, sigma=np.where(np.isfinite(values), 2e-5, np.nan))


@pytest.mark.slow
def test_a_flanges_load_cell_that_reads_one_axis_too_small_is_accused_in_its_own_axes() -> None:
    table = design("ur10", "deflection", poses=24)
    wrong = np.diag([0.12, 0.0, 0.0])
    seen = read(sheared(table, tool_axes(table), wrong), truth_of("ur10"), 5)
    found = diagnose(Task(load("ur10"), replace(seen, w=table.w)))
    assert found.verdict == "unexplained"
    device = found.last.device_law
    assert device is not None
    assert (device.place, device.terms[0][0]) == ("force sensor", "gain in the tool's axes: fx")
    assert device.terms[0][1] == pytest.approx(12.0, abs=4 * device.terms[0][2])


@pytest.mark.slow
@pytest.mark.parametrize("files", [(), ("first/a.csv", "second/b.csv")])
def test_a_device_that_turned_half_way_is_no_frame_that_is_misaligned(files: tuple[str, ...]) -> None:
    """Or that was turned before the second file: then that is told."""
    table = design("ur10", "deflection", poses=24)
    seen = read(table, truth_of("ur10"), 6)
    half = table.pose >= 12
    values = seen.values.copy()
    values[half, :3] += np.cross([0.0, 0.0, 0.12], values[half, :3])
    seen = replace(seen, values=values, files=files, file=half.astype(int) if files else seen.file)
    found = diagnose(Task(load("ur10"), seen))
    assert found.verdict == "unexplained"
    device = found.last.device_law
    assert device is not None
    assert device.place == "measuring device"
    since = "b.csv" if files else "50 % of the session"
    assert device.terms[0][0].startswith(f"turn from {since} on in")
    assert any("these are several files" in remark for remark in found.remarks) == bool(files)


def leaning(table: Measurements, lean: np.ndarray, towards: np.ndarray) -> Measurements:
    """The table under forces that lean by ``lean`` (3, 3) of their size a metre that the tool is off a point."""
    tip = look(load("ur10"), table).found.T[:, :3, 3]
    w = table.w.copy()
    w[:, :3] += np.linalg.norm(w[:, :3], axis=1)[:, None] * ((towards - tip) @ lean.T)
    return replace(table, w=w)


@pytest.mark.parametrize("rope", [True, False])
def test_a_load_that_leans_is_what_it_does_in_the_simulator(rope: bool) -> None:
    table, truth, at = design("ur10", "deflection"), truth_of("ur10"), np.array([0.3, -0.2, 3.0])
    lean = PERCENT * (np.eye(3) if rope else np.array([[1.0, -0.5, 0.0], [0.3, 0.8, 0.0], [0.0, 0.0, 0.0]]))
    plain, made = measured(truth, table), measured(truth, leaning(table, lean, at))
    found = assemble(complete("ur10"), plain, effects=())
    view = found.situation.view
    change = (made.values - plain.values)[view.state, view.component]
    of = (
        ("towards a point", "fx", "fy", "fz")
        if rope
        else ("fx by x", "fx by y", "fy by x", "fy by y", "fx", "fy")
    )
    sizes = [1.0, *at] if rope else [*(-lean[:2, :2] / PERCENT).ravel(), *(lean @ at)[:2] / PERCENT]
    column = law(found.problem, "lean of the load", *of).values @ sizes
    assert np.linalg.norm(column - change) < 0.03 * np.linalg.norm(change)


@pytest.mark.slow
def test_a_rope_from_a_fixed_point_is_accused_and_no_link_named_for_it() -> None:
    """Vertical loads that follow the tool sideways: base and links have many directions proportional to the load."""
    table = design("ur10", "deflection", poses=30)
    vertical = table.w * np.array([0, 0, 1.0, 0, 0, 0])
    table = replace(table, w=vertical)
    at, lean = np.array([0.2, 0.1, 0.0]), 0.06 * np.diag([1.0, 1.0, 0.0])
    seen = read(leaning(table, lean, at), truth_of("ur10"), 5)
    found = diagnose(Task(load("ur10"), replace(seen, w=vertical)))
    assert found.verdict == "unexplained"
    assert found.last.device_law is not None
    assert found.last.device_law.place == "force sensor"
    assert "a lean of the load" in sentence(found)
    picture = draw_unnamed(found)  # of a virtual joint that bears a load: vertical ones leave some without
    assert picture is not None
    problem = found.assembly.problem
    assert problem.tau is not None
    (shown,) = (
        k for k, name in enumerate(problem.virtual_joints) if f"Deflection of {name} that" in picture.caption
    )
    assert problem.tau[:, shown].any()
    assert not problem.tau.any(axis=0).all()
