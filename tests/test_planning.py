"""The choice of poses: refinement, constraints, parallel evaluation, tables and plots."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
from planning_chain import SIX_AXES, ChainObservation

from symstiff.calibration.planning import (
    Box,
    Geometry,
    Goal,
    Load,
    Measurement,
    Plan,
    Region,
    Search,
    Space,
    above_floor,
    geometry,
    measurement_of,
    plan_poses,
    poses_table,
    workspace_map,
)
from symstiff.calibration.planning.candidates import Evaluator, draw
from symstiff.calibration.planning.criteria import Criterion
from symstiff.calibration.planning.frames import origins
from symstiff.calibration.planning.measurement import whitened_rows
from symstiff.calibration.planning.refine import Problem, refine
from symstiff.calibration.planning.region import allowed
from symstiff.calibration.tables.table import write_table
from symstiff.errors import UserError
from symstiff.report.figures import draw_map, draw_plan, save_figure
from symstiff.robot import load

DOWN = np.array([0.0, 0.0, -2500.0, 0.0, 0.0, 0.0])
THREE_AXES = ChainObservation(
    rows=((0, 0.5, 0.1, -np.pi / 2), (0, 0, 0.6, 0), (0, 0, 0.5, 0)),
    base_z=0.0,
    tool=(0.05, 0.0, 0.02),
    terms=((1, 0, 0), (2, 0, 0), (3, 0, 0), (1, 4, 4), (3, 5, 5), (2, 5, 5)),
)
LIMITS = ((-2.0, 2.0), (-2.5, 0.5), (-2.0, 2.0))


def three_axes_geometry() -> Geometry:
    rows = tuple((False, theta, d, a, alpha) for theta, d, a, alpha in THREE_AXES.rows)
    return Geometry("three", (), rows, tuple(zip(("tx", "ty", "tz"), THREE_AXES.tool, strict=True)), LIMITS)


THREE = three_axes_geometry()
FORCES = Load("force", 500.0)


def small_plan(**options) -> Plan:
    settings_ = {"candidates": 300, "starts": 2, "refine": False, **options.pop("search", {})}
    space = Space(THREE, FORCES, **options.pop("space", {}))
    goal = Goal(5, **options.pop("goal", {}))
    return plan_poses(space, THREE_AXES, THREE_AXES.names, goal, search=Search(**settings_), **options)


@pytest.mark.parametrize("criterion", ["D", "A", "test"])
def test_a_plan_beats_random_poses_and_its_history_rises(criterion: str):
    tests = {"test_q": np.full((3, 3), 0.3), "test_w": np.tile(DOWN, (3, 1))} if criterion == "test" else {}
    plan = small_plan(goal={"criterion": criterion, **tests}, search={"refine": True})
    assert plan.over_random > 1.2
    assert plan.over_candidates >= 1.0
    assert np.all(np.diff(plan.history) >= 0)
    assert (plan.expected_error is None) == (criterion != "test")


def test_predicted_standard_deviations_are_those_of_simulated_estimates():
    plan = small_plan()
    A = THREE_AXES(plan.q, plan.w)
    weights = 1 / np.array([30e-6] * 3 + [100e-6] * 3)
    B = (A * weights[:, None]).reshape(-1, 6)
    noise = np.random.default_rng(0).normal(size=(4000, len(B)))
    estimates = noise @ np.linalg.pinv(B, rcond=1e-12).T
    assert np.allclose(estimates.std(axis=0), plan.std, rtol=0.06)


def test_the_same_seed_gives_the_same_plan_and_another_seed_other_candidates():
    first, again, other = small_plan(), small_plan(), small_plan(search={"seed": 1})
    assert np.array_equal(first.q, again.q)
    assert first.history == again.history
    assert not np.array_equal(first.q, other.q)


@pytest.mark.parametrize("symbolic", [False, True])
def test_poses_keep_limits_keep_out_fixed_joints_and_levels_through_refinement(symbolic: bool):
    box = Box((0.7, -0.5, 0.3), (1.1, 0.5, 0.6))
    region = Region((box,), (above_floor(0.05),), reach=(0.2, 1.2))
    space = {"region": region, "fixed": {1: 0.4}, "levels": {2: 3}}
    plan = small_plan(
        space=space,
        goal={"criterion": "D"},
        search={"refine": True, "candidates": 400},
        casadi_observation=casadi_three_axes if symbolic else None,
    )
    ends = origins(THREE, plan.q)
    along = np.linspace(0.0, 1.0, 41)[:, None, None, None]
    links = ends[:, :-1] + along * np.diff(ends, axis=1)
    within = (links > np.array(box.low) + 1e-6) & (links < np.array(box.high) - 1e-6)
    assert not np.all(within, axis=3).any()
    points = ends[:, 1:]
    inside = np.all((points > np.array(box.low) + 1e-6) & (points < np.array(box.high) - 1e-6), axis=2)
    assert not inside.any()
    assert points[..., 2].min() >= 0.05 - 1e-6
    assert np.all(plan.q[:, 0] == 0.4)
    assert len(np.unique(plan.q[:, 1])) == 3
    limits = np.array(LIMITS)
    assert np.all((plan.q >= limits[:, 0]) & (plan.q <= limits[:, 1]))
    assert np.allclose(np.linalg.norm(plan.w[:, :3], axis=1), 500.0)
    assert np.linalg.norm(points[:, -1], axis=1).max() <= 1.2 + 1e-6


@pytest.mark.parametrize("levels", [{}, {2: 3}])
def test_a_margin_is_kept_from_both_limits_through_refinement(levels: dict[int, int]):
    low, high = np.array(LIMITS).T
    for margin in (0.0, 0.04):
        space = {"region": Region(margin=margin), "levels": levels}
        q = small_plan(space=space, search={"refine": True, "candidates": 400}).q
        kept = np.minimum(q - low, high - q) / (high - low)
        assert kept.min() > margin - 1e-9
        assert (kept.min() < 0.03) == (margin == 0.0)
    with pytest.raises(UserError, match=r"margin 0\.5: a share of a joint's range"):
        Region(margin=0.5)


def casadi_three_axes(q, w):
    """The same small chain in CasADi: its columns by J_a (J_b·w)."""
    import casadi as ca

    T = ca.SX.eye(4)
    frames = [T]
    for k, (theta, d, a, alpha) in enumerate(THREE_AXES.rows):
        c, s, cos, sin = ca.cos(theta + q[k]), ca.sin(theta + q[k]), np.cos(alpha), np.sin(alpha)
        step = ca.vertcat(
            ca.horzcat(c, -s * cos, s * sin, a * c),
            ca.horzcat(s, c * cos, -c * sin, a * s),
            ca.horzcat(0, sin, cos, d),
            ca.horzcat(0, 0, 0, 1),
        )
        T = T @ step
        frames.append(T)
    tip = (T @ ca.vertcat(*THREE_AXES.tool, 1))[:3]

    def column(link: int, axis: int):
        frame = frames[link - 1] if axis == 0 else frames[link]
        along = frame[:3, 2] if axis == 0 else frame[:3, (axis - 1) % 3]
        return ca.vertcat(ca.cross(along, tip - frame[:3, 3]), along)

    columns = []
    for link, a, _ in THREE_AXES.terms:
        J = column(link, a)
        columns.append(J * ca.dot(J, w))
    return ca.horzcat(*columns)


@pytest.mark.parametrize("criterion", ["D", "A"])
def test_refinement_by_ipopt_and_by_gradients_both_improve_and_never_worsen(criterion: str):
    space = Space(THREE, FORCES)
    drawn = draw(space, 200, 3)
    chosen = replace(drawn, q=drawn.q[:5], w=drawn.w[:5], labels=drawn.labels[:5])
    evaluator = Evaluator(THREE_AXES, THREE, Measurement())
    scale = 1 / np.sqrt((evaluator(drawn.q, drawn.w) ** 2).mean(axis=(0, 1)))
    aim = Criterion("D") if criterion == "D" else Criterion("A", np.eye(6) / 6)
    problem = Problem(space, evaluator, scale, aim)
    before = problem.score(chosen.q, chosen.w)
    by_gradient = refine(problem, chosen)
    by_ipopt = refine(problem, chosen, casadi_three_axes)
    assert (by_gradient.method, by_ipopt.method) == ("l-bfgs-b", "ipopt")
    for found in (by_gradient, by_ipopt):
        assert found.score == problem.score(found.q, found.w)
        assert aim.efficiency(found.score, before, 6) > 1.3


def test_a_refinement_that_goes_wrong_is_discarded():
    space = Space(THREE, FORCES)
    drawn = draw(space, 200, 3)
    chosen = replace(drawn, q=drawn.q[:5], w=drawn.w[:5], labels=drawn.labels[:5])
    evaluator = Evaluator(THREE_AXES, THREE, Measurement())
    problem = Problem(space, evaluator, np.full(6, 1e-3), Criterion("D"))
    found = refine(problem, chosen, lambda q, w: 1.0 / (1e-9 + casadi_three_axes(q, w)))
    assert found.score >= problem.score(chosen.q, chosen.w)


def test_markers_give_the_information_of_all_their_rows():
    robot = load("kuka_kr270")
    measurement = measurement_of(robot, ("tcp", "p1", "p2", "p3"), sigma_t=20e-6)
    q = np.random.default_rng(0).uniform(-1, 1, (4, 6))
    A = SIX_AXES(q, np.tile(DOWN, (4, 1)))
    rows = whitened_rows(measurement, geometry(robot), q, A)
    assert rows.shape[0] == 6
    turn = [T[:, :3, :3] for T in SIX_AXES.frames(q)][6]
    for k in range(4):
        explicit = np.zeros((A.shape[2], A.shape[2]))
        for name in ("tcp", "p1", "p2", "p3"):
            local = np.array([float(c) for c in robot.marker_position(name)]) - np.array(SIX_AXES.tool)
            moved = A[k, :3] + np.cross(A[k, 3:].T, turn[k] @ local).T
            explicit += moved.T @ moved / 20e-6**2
        assert np.allclose(rows[:, k].T @ rows[:, k], explicit, rtol=1e-9, atol=1e-9 * explicit.max())


def test_frames_agree_with_an_independent_chain_of_matrices():
    q = np.random.default_rng(1).uniform(-3, 3, (20, 6))
    expected = np.stack([T[:, :3, 3] for T in SIX_AXES.frames(q)], axis=1)
    assert np.allclose(origins(geometry(load("kuka_kr270")), q), expected, atol=1e-12)


def test_wrench_and_force_candidates_have_the_stated_magnitude_in_all_directions():
    drawn = draw(Space(THREE, Load("wrench", 200.0, moment=30.0)), 2000, 0)
    assert np.allclose(np.linalg.norm(drawn.w[:, :3], axis=1), 200.0)
    assert np.allclose(np.linalg.norm(drawn.w[:, 3:], axis=1), 30.0)
    assert np.all(np.abs(drawn.w.mean(axis=0)) < [10, 10, 10, 1.5, 1.5, 1.5])
    cases = ((0.0, 0.0, -5.0, 0.0, 0.0, 0.0), (3.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    listed = draw(Space(THREE, Load("wrench", cases=cases)), 100, 0)
    assert {tuple(w) for w in listed.w} == set(cases)


def gram_deflection(q: np.ndarray, w: np.ndarray) -> np.ndarray:
    return THREE_AXES(q, w) @ np.array([1e-6, 2e-6, 3e-6, 1e-7, 1e-7, 2e-7])


@pytest.mark.parametrize(
    ("reach", "moment"), [(3.3, 50.0), (0.81, 50.0), (0.75, 50.0), (0.06, 4.0)]
)  # 0.5 m times 100 N, or 2/3 of 0.06 m
def test_the_moment_of_a_wrench_is_half_a_metre_times_the_force_but_no_more_than_an_arm_has_room_for(
    reach: float, moment: float
):
    assert Load("wrench", 100.0).on_arm(reach).magnitudes == pytest.approx((100.0, moment))
    assert Load("wrench", 100.0, 7.0).on_arm(reach).magnitudes == (100.0, 7.0)
    assert Load("force", 100.0).on_arm(reach) == Load("force", 100.0)


def test_what_cannot_be_planned_is_said_in_one_line():
    with pytest.raises(UserError, match=r"1 pose for 8 parameters, 6 equations at most from each"):
        plan_poses(Space(THREE, FORCES), THREE_AXES, tuple("abcdefgh"), Goal(1))
    gravity = Space(THREE, Load("gravity", 500.0))
    with pytest.raises(UserError, match=r"no candidate moves c1"):
        plan_poses(gravity, THREE_AXES, THREE_AXES.names, Goal(6), search=Search(300))
    twice = replace(THREE_AXES, terms=(*THREE_AXES.terms, (2, 6, 6)))
    with pytest.raises(UserError, match=r"no plan tells c3, k2_66 apart"):
        plan_poses(Space(THREE, FORCES), twice, twice.names, Goal(6), search=Search(300))
    walls = Region((Box((-9, -9, -9), (9, 9, 9)),))
    with pytest.raises(
        UserError, match=r"none of .* keeps the region: relax the keep-out boxes; a box that holds the base"
    ):
        small_plan(space={"region": walls})
    with pytest.raises(UserError, match=r"none of .* keeps the region: relax the floor$"):
        small_plan(space={"region": Region((), (above_floor(9.0),))})
    with pytest.raises(UserError, match=r"cannot show 9 values of q2"):
        small_plan(space={"levels": {2: 9}})
    with pytest.raises(UserError, match=r"outside its limits"):
        Space(THREE, fixed={1: 7.0})


@pytest.mark.parametrize("count", [2, 4, 6])
def test_few_values_of_a_joint_that_turns_round_are_not_half_a_turn_apart(count: int):
    """Even steps over one or two whole turns repeat themselves up to signs, and leave parameters unknown."""
    for limits in ((-np.pi, np.pi), (-2 * np.pi, 2 * np.pi)):
        around = replace(THREE, limits=(LIMITS[0], limits, LIMITS[2]))
        values = Space(around, FORCES, levels={2: count}).level_values(2)
        half_turns = np.subtract.outer(values, values)[~np.eye(count, dtype=bool)] / np.pi
        assert np.abs(half_turns - np.round(half_turns)).min() > 0.05
        cells = np.linspace(*limits, count + 1)
        assert np.all((values > cells[:-1]) & (values < cells[1:]))
    even = Space(THREE, FORCES, levels={2: count}).level_values(2)
    np.testing.assert_allclose(even, -2.5 + 3.0 * (np.arange(count) + 0.5) / count)


def test_two_values_of_a_joint_that_turns_round_make_a_plan_that_finds_every_parameter():
    from symstiff.calibration.plan import plan as choose_poses
    from symstiff.model import StiffnessModel
    from symstiff.reduction import reduce

    model = StiffnessModel.of(reduce(load("planar2r"), "wrench", "pose"))
    search = Search(candidates=200, starts=1, refine=False)
    plan = choose_poses(model, Goal(12), levels={2: 2}, search=search)
    assert len(np.unique(plan.q[:, 1])) == 2
    columns = model.observation(plan.q, plan.w).reshape(-1, len(model.parameters))
    assert np.linalg.matrix_rank(columns / np.linalg.norm(columns, axis=0), tol=1e-6) == columns.shape[1]
    with pytest.raises(UserError, match=r"give q2 more values \(--levels\)"):
        choose_poses(model, Goal(12), levels={2: 1}, search=search)


def test_the_poses_table_reads_back_as_the_plan(tmp_path):
    from symstiff.calibration.tables.table import read_poses

    plan = small_plan()
    path = tmp_path / "poses.csv"
    write_table(poses_table(plan, THREE), path, "deg")
    with path.open() as file:
        header = next(csv.reader(file))
    assert header == ["pose", "q1[deg]", "q2[deg]", "q3[deg]", "fx[N]", "fy[N]", "fz[N]"]
    table = read_poses(path)
    assert np.allclose(table.q, plan.q, atol=1e-12)
    assert np.allclose(table.w, plan.w, rtol=1e-12)
    assert [p.name for p in tmp_path.iterdir()] == ["poses.csv"]


def test_plots_of_plan_and_workspace_are_reproducible_files(tmp_path):
    plan = small_plan()
    for name in ("a.svg", "b.svg"):
        save_figure(draw_plan(plan, THREE), tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    region = Region(half_spaces=(above_floor(0.0),))
    result = workspace_map(gram_deflection, THREE, DOWN, (2, 3), (20, 30), at={1: 0.3}, region=region)
    low = result.tip[..., 2] < -1e-6
    assert np.isnan(result.magnitude[low]).all()
    kept = np.isfinite(result.magnitude)
    assert kept.any()
    assert np.allclose(result.stiffness[kept] * -result.deflection[kept][:, 2], 2500.0)
    save_figure(draw_map(result, "stiffness"), tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(UserError, match=r"\.png or \.svg"):
        save_figure(draw_map(result), tmp_path / "map.pdf")


def test_a_box_is_kept_clear_of_the_lines_between_joints():
    """The upper arm would pass through it with both ends outside."""
    box = Region((Box((0.2, -0.1, 0.2), (0.4, 0.1, 0.4)),))
    rng = np.random.default_rng(4)
    q = rng.uniform(*np.array(LIMITS).T, (4000, 3))
    points = origins(THREE, q)
    along = np.linspace(0.0, 1.0, 101)[:, None, None, None]
    links = points[:, :-1] + along * np.diff(points, axis=1)
    inside = np.all((links > [0.2, -0.1, 0.2]) & (links < [0.4, 0.1, 0.4]), axis=3).any(axis=(0, 2))
    ends_inside = np.all((points > [0.2, -0.1, 0.2]) & (points < [0.4, 0.1, 0.4]), axis=2).any(axis=1)
    kept = allowed(box, THREE, q)
    assert np.sum(inside & ~ends_inside) > 5
    assert not np.any(kept & inside)
    assert np.mean(kept[~inside]) > 0.98


def test_planned_poses_have_digits_that_can_be_entered():
    plan = small_plan(search={"refine": True})
    degrees = np.degrees(plan.q)
    assert np.allclose(degrees, np.round(degrees, 4), atol=1e-10)
    assert np.array_equal(plan.w, np.round(plan.w, 3))
    low, high = np.array(LIMITS).T
    assert np.all((plan.q >= low) & (plan.q <= high))
