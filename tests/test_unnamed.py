"""What the catalogue does not hold: markers, devices and joints that remember are accused, not misnamed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.placement import placement_columns
from symstiff.calibration.experiment.situation import look
from symstiff.calibration.simulation.chain import chain_of, posture
from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.bridge.assemble import assemble
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.laws.unnamed import _lagging, every_law, laws_at
from symstiff.discrepancy.problem import ANGLE, CLOCK, HISTORY, Problem
from symstiff.discrepancy.search.localise import FittedLaw, _scales
from symstiff.discrepancy.workflow import diagnose
from symstiff.report import unnamed, words
from symstiff.robot import load
from symstiff.robot.schema import Marker
from tests.diagnosis_data import HARDENING, ROBOT, design, measured
from tests.test_assemble import complete, truth_of
from tests.test_assemble import design as experiment
from tests.test_assemble import measured as exact
from tests.test_discrepancy_engine import arm


def _diagnosed(table: Measurements) -> Finding:
    return diagnose(Task(load(ROBOT), table))


def _share(table: Measurements) -> np.ndarray:
    size = np.linalg.norm(table.w, axis=1)
    return np.asarray(size / size.max())


def test_a_marker_that_gives_way_is_accused_with_its_size() -> None:
    table = measured()
    values = table.values.copy()
    values[:, :3] += 1e-4 * (table.point == 1)[:, None] * _share(table)[:, None] * [1.0, -0.5, 0.2]
    found = _diagnosed(replace(table, values=values))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "marker p2"
    assert [value for _, value, _, _ in law.terms] == pytest.approx([1e-4, -0.5e-4, 0.2e-4], abs=1.5e-5)
    assert "marker p2" in words.sentence(found)
    assert "mm)" in unnamed.device_text(law)


@pytest.mark.slow
def test_a_force_sensor_that_reads_too_little_at_large_loads_is_accused() -> None:
    truth = design()
    share = np.linalg.norm(truth.w, axis=1) / np.linalg.norm(truth.w, axis=1).max()
    table = replace(measured(), w=truth.w / (1.0 + 0.2 * share)[:, None])
    found = _diagnosed(table)
    assert found.verdict == "unexplained"
    assert found.last.localisation is not None
    assert found.last.localisation.accused.startswith("force sensor")
    assert "%" in words.sentence(found)


def test_a_marker_that_sits_elsewhere_moves_with_the_tool() -> None:
    """Against the offset of a robot file that has the marker at the other place."""
    robot, table = load("ur10"), experiment("ur10", "absolute")
    found = assemble(complete("ur10"), exact(truth_of("ur10"), table), effects=())
    shift = np.array([2e-3, -1e-3, 3e-3])
    moved = [
        m
        if m.name != "p2"
        else Marker(name="p2", xyz=[str(float(x) + d) for x, d in zip(m.xyz, shift, strict=True)])
        for m in robot.marker
    ]
    other = robot.model_copy(update={"marker": tuple(moved)})
    expected = look(other, table).offset - look(robot, table).offset
    view = found.situation.view
    block = _law(found.problem, "marker p2", "shift in the tool's axes")
    assert block @ shift == pytest.approx(view.in_device(expected)[view.state, view.component], abs=1e-9)
    assert np.any(expected[table.point == 1])


def test_no_law_of_loads_says_anything_of_a_state_without_one() -> None:
    """Deflections are told from the sagged arm: what its weight does to a law is in both states."""
    table = experiment("ur10", "deflection")
    w = table.w.copy()
    w[table.pose == 0] = 0.0
    problem = assemble(complete("ur10"), exact(truth_of("ur10"), replace(table, w=w)), effects=()).problem
    assert problem.weight is not None
    assert np.any(problem.weight)
    still = problem.pose == 0
    for v in range(len(problem.virtual_joints)):
        for law in laws_at(problem, v):
            if not law.driven & {CLOCK, HISTORY} and (ANGLE not in law.driven or "tau" in law.title):
                assert np.all(law.values[still] == 0.0), law.title


def _law(problem: Problem, place: str, title: str) -> np.ndarray:
    return next(law.values for law in problem.devices if (law.place, law.title) == (place, title))


def test_a_device_that_reads_distances_too_long_is_accused_with_its_scale() -> None:
    """Against the positions of a device whose millimetre is 80 ppm short, of an arm that bends by millimetres."""
    table = experiment("ur10", "absolute")
    values = exact(truth_of("ur10"), table).values.copy()
    far = values.copy()
    far[:, :3] += [2.0, -1.0, 0.5]
    found = assemble(complete("ur10"), replace(exact(truth_of("ur10"), table), values=far), effects=())
    view = found.situation.view
    grown = 80e-6 * far[:, :3]
    assert 80.0 * _law(found.problem, "measuring device", "scale error")[:, 0] == pytest.approx(
        grown[view.state, view.component], abs=4e-7
    )
    angle = np.arctan2(far[:, 1], far[:, 0])
    turned = np.stack([np.cos(angle + 1e-6), np.sin(angle + 1e-6)], axis=1) * np.hypot(*far[:, :2].T)[:, None]
    moved = np.column_stack([turned, far[:, 2]]) - far[:, :3]
    waves = _law(found.problem, "measuring device", "azimuth error, 1 per turn")
    rows = angle[view.state]
    assert 1e-6 * (np.sin(rows) * waves[:, 0] + np.cos(rows) * waves[:, 1]) == pytest.approx(
        moved[view.state, view.component], abs=1e-8
    )


def test_a_law_of_the_device_holds_no_noise_of_its_readings() -> None:
    """A column of readings would explain their noise where the model has errors of all frames."""
    table = exact(truth_of("ur10"), experiment("ur10", "absolute"))
    rough = replace(
        table, values=table.values + 1e-3 * np.random.default_rng(1).normal(size=table.values.shape)
    )
    found = [assemble(complete("ur10"), t, effects=()) for t in (table, rough)]
    one, other = (_law(f.problem, "measuring device", "scale error")[:, 0] for f in found)
    moved = placement_columns(found[0].situation.view)  # noise moves the device as a whole
    left = one - other - moved @ np.linalg.lstsq(moved, one - other, rcond=None)[0]
    assert np.std(left) < 1e-3 * np.std(1e-6 * (rough.values - table.values)[:, :3])


def test_a_pull_towards_a_fixed_point_is_what_it_does_in_the_simulator() -> None:
    table, truth = experiment("ur10", "deflection"), truth_of("ur10")
    where = look(load("ur10"), table).found
    origin = where.T[:, :3, 3]
    sizes = np.array([2.0, 0.6, -0.8, 1.8])  # N/m, and N where the base's origin is
    beside = np.hstack([sizes[1:] - sizes[0] * origin, np.zeros_like(origin)])
    plain, pulled = exact(truth, table), exact(truth, replace(table, w=table.w + beside))
    found = assemble(complete("ur10"), plain, effects=())
    view = found.situation.view
    made = (pulled.values - plain.values)[view.state, view.component]
    expected = _law(found.problem, "force sensor", "pull towards a fixed point") @ sizes
    assert np.linalg.norm(expected - made) < 0.02 * np.linalg.norm(made)


def test_readings_that_hold_the_load_before_are_columns_of_what_it_made() -> None:
    """Against predictions at loads of which each holds a tenth of the one before."""
    table, truth = design(), complete(ROBOT)
    found = assemble(truth, measured(), effects=())
    assert np.any(_law(found.problem, "order of the loads", "late"))
    view = found.situation.view
    made = found.situation.view.read(
        np.einsum("nrv,nv->nr", view.at_point, found.situation.laws(view.tau + view.more))
    )
    late = 100.0 * _law(found.problem, "order of the loads", "late")[:, 0]  # a column is one per cent
    key = [tuple(k) for k in np.column_stack([table.pose, table.point])[view.state]]
    for row in range(0, len(late), 37):
        same = [
            r
            for r in range(len(late))
            if key[r] == key[row]
            and view.component[r] == view.component[row]
            and view.state[r] < view.state[row]
        ]
        before = made[same[-1]] if same else 0.0
        assert late[row] == pytest.approx(before - made[row], abs=1e-15)


def test_a_load_that_is_followed_late_rises_as_an_exponential() -> None:
    clock = np.linspace(0.0, 1.0, 400)
    assert _lagging(clock, np.ones(400), 0.2) == pytest.approx(1.0 - np.exp(-clock / 0.2), abs=1e-12)


def test_small_coefficients_are_not_rounded_away() -> None:
    law = FittedLaw("joint 1", "+2.25e-05*sin(q2) -7e-06*tau*cos(q2)", 10.0, 0.5, 0.4, np.zeros(1))
    text = unnamed.law_text(_diagnosed(measured()), law)
    assert "0.0225·sin(q2)" in text
    assert "0.007·t·cos(q2)" in text


def test_a_law_of_another_joints_load_tells_by_what_that_is_divided() -> None:
    scales = {"tau1": 37.5}
    law = FittedLaw("joint 2", "+2.25e-05*tau*|tau1|", 10.0, 0.5, 0.4, np.zeros(1), scales)
    assert unnamed.law_text(_diagnosed(measured()), law).endswith(
        "with t = τ/(10 N·m) and t1 = τ1/(37.5 N·m)"
    )
    problem = _diagnosed(measured()).assembly.problem
    first = problem.virtual_joints.index("joint 1")
    found = _scales(problem, problem.virtual_joints.index("joint 2"), "+1*tau*|tau1| -2*tau1 +3*tau")
    assert problem.tau is not None
    assert found == {"tau1": pytest.approx(np.max(np.abs(problem.tau[:, first])))}


def _tilted(table: Measurements, lift: float, size: float) -> np.ndarray:
    """(N, 3) shifts of the measured points where a foot at the base's origin lifts, by vectors alone."""
    seen = look(load(ROBOT), table)
    origin = seen.found.T[:, :3, 3]
    moment = (np.cross(origin, table.w[:, :3]) + table.w[:, 3:])[:, :2]
    length = np.linalg.norm(moment, axis=1)
    share = np.clip(length / length.max() - lift, 0.0, None) / (1.0 - lift)
    tilt = np.column_stack([moment / length[:, None] * share[:, None], np.zeros(len(length))])
    return np.asarray(np.cross(size * tilt, origin + seen.offset))


def test_a_foot_that_lifts_is_accused_with_its_tilt() -> None:
    table = measured()
    values = table.values.copy()
    values[:, :3] += _tilted(table, 0.5, 3e-4)
    found = _diagnosed(replace(table, values=values))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "foot of the base"
    assert law.terms[0][1] == pytest.approx(3e-4, rel=0.15)
    assert "the foot of the base, where a tilt beyond 50 % of the largest moment" in words.sentence(found)
    view = found.assembly.situation.view
    column = _law(found.assembly.problem, "foot of the base", "tilt beyond 50 % of the largest moment")[:, 0]
    assert column == pytest.approx(_tilted(table, 0.5, 1.0)[view.state, view.component], abs=1e-12)


@pytest.mark.slow
def test_a_flange_that_slips_the_way_of_the_force_is_accused_with_its_slip() -> None:
    table = measured()
    size = np.linalg.norm(table.w[:, :3], axis=1)
    values = table.values.copy()
    values[:, :3] += 1e-4 * (size > 0.6 * size.max())[:, None] * table.w[:, :3] / size[:, None]
    found = _diagnosed(replace(table, values=values))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "flange"
    assert law.terms[0][1] == pytest.approx(1e-4, abs=1.5e-5)
    assert "strongest at the flange, where a slip beyond 50 % of the largest force" in words.sentence(found)


def test_a_slip_is_read_in_the_axes_of_the_device() -> None:
    """Against the force in the axes of a device that stands turned about the vertical by a known angle."""
    table, truth = experiment("ur10", "absolute"), truth_of("ur10")
    yaw = truth.device.rpy[2]
    turn = np.array([[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    found = assemble(complete("ur10"), exact(truth, table), effects=())
    view = found.situation.view
    force = table.w[:, :3] @ turn.T
    size = np.linalg.norm(force, axis=1, keepdims=True)
    slipped = (size > 0.3 * size.max()) * force / size
    column = _law(found.problem, "flange", "slip beyond 30 % of the largest force")[:, 0]
    assert column == pytest.approx(slipped[view.state, view.component], abs=2e-3)
    block = _law(found.problem, "marker p2", "shift the way of the force").sum(axis=1)
    shifted = (table.point == 1)[:, None] * force / np.abs(table.w[:, :3]).max()
    assert block == pytest.approx(shifted[view.state, view.component], abs=2e-3)


@pytest.mark.slow
def test_a_marker_that_gives_way_along_the_force_is_accused() -> None:
    table = measured(poses=16)
    values = table.values.copy()
    values[:, :3] += 2e-6 * (table.point == 2)[:, None] * table.w[:, :3] * [1.0, 0.6, 0.0]
    found = _diagnosed(replace(table, values=values))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert (law.place, law.terms[0][0][:27]) == ("marker p3", "shift the way of the force:")


@pytest.mark.slow
@pytest.mark.parametrize("of_tool", [False, True])
def test_a_marker_whose_bracket_bends_across_the_force_is_accused(of_tool: bool) -> None:
    """In the base's axes, or in those of the flange that carries it."""
    table = measured(poses=16)
    chain = chain_of(load(ROBOT))
    turn = posture(chain, table.q, np.zeros((len(table), chain.size))).after[0][:, -1]
    turn = turn if of_tool else np.broadcast_to(np.eye(3), turn.shape)
    bracket = np.array([[0.0, 1.5e-6, 0.0], [0.0, 0.0, 0.0], [1e-6, 0.0, 0.0]])
    bent = np.einsum("nij,jk,nlk,nl->ni", turn, bracket, turn, table.w[:, :3])
    values = table.values.copy()
    values[:, :3] += (table.point == 1)[:, None] * bent
    found = _diagnosed(replace(table, values=values))
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "marker p2"
    sizes = {title.partition(": ")[2]: value for title, value, _, _ in law.terms}
    titles = {title.partition(": ")[0] for title, _, _, _ in law.terms}
    assert titles == {"shift by the force" + " in the tool's axes" * of_tool}
    force = np.abs(table.w[:, :3]).max()
    assert sizes["x by fy"] == pytest.approx(1.5e-6 * force, rel=0.25)
    assert sizes["z by fx"] == pytest.approx(1e-6 * force, rel=0.25)
    assert "x by fy" in unnamed.device_text(law)
    assert "y by fz" not in unnamed.device_text(law)


@pytest.mark.slow
def test_a_rig_that_rubs_is_accused_with_its_friction() -> None:
    told = measured(poses=20, levels=(0.3, 0.6, 1.0, 0.6, 0.3))
    branch = np.repeat([1.0, 1.0, 1.0, -1.0, -1.0] * 20, 3)
    table = replace(told, branch=branch, w=told.w / (1.0 - 0.1 * branch)[:, None])
    found = _diagnosed(table)
    assert found.verdict == "unexplained"
    law = found.last.device_law
    assert law is not None
    assert law.place == "force sensor"
    assert law.terms[0][:1] == ("gain*branch",)
    assert law.terms[0][1] == pytest.approx(-10.0, abs=2.0)
    assert "friction in the rig" in words.sentence(found)


def hardening() -> Problem:
    return assemble(complete(ROBOT), measured(HARDENING), effects=()).problem


def test_the_order_of_the_loads_is_a_law_where_there_are_three_of_them() -> None:
    """What creeps gives way more under the later ones, also where these are the larger ones."""
    for levels, there in (((0.3, 0.65, 1.0, 0.6, 0.3), True), ((0.2, 0.4, 0.6), True), ((1.0, 0.5), False)):
        problem = arm(levels=levels).problem
        laws = {law.text: law for law in every_law(problem, 1)}
        for text in ("tau*load_case", "tau*sqrt(load_case)"):
            assert ((text,) in laws) == there
    order = [law for law in every_law(arm().problem, 1) if law.text == ("tau*load_case",)]
    assert [law.driven for law in order] == [frozenset({HISTORY})]


@pytest.mark.parametrize(
    ("expression", "heavy"),
    [
        ("+2e-05*tau*cos(q2)", True), ("+1e-05*late(tau,0.3)", False), ("+1e-05*tau*time -3e-06*tau3", False),
        ("+1e-05*tau*exp(-((q2 - 0.3)/0.4)^2)", True), ("+1e-05*tau^3", True), ("-1e-05*sign(tau)", True),
        ("+1e-05*tau*|tau|", True), ("+1e-05*tau*tau3", True), ("+1e-05*beyond(tau,0.4)", True),
    ],
)  # fmt: skip
def test_a_law_of_the_clock_asks_for_no_masses(expression: str, heavy: bool) -> None:
    assert FittedLaw("joint 2", expression, 10.0, 0.5, 0.4, np.zeros(1)).may_hold_weight == heavy
