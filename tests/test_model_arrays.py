"""StiffnessModel evaluated on arrays and values: what is taken, and one line for what is not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from symstiff.calibration.plan import Goal, Search, plan, workspace_for
from symstiff.effects.instance import EffectInstance
from symstiff.errors import UserError
from symstiff.model import StiffnessModel, joints_only
from symstiff.reduction import reduce
from symstiff.robot import load


def small() -> StiffnessModel:
    model = StiffnessModel.of(reduce(load("planar2r"), "wrench"))
    return model.with_values({n: 1e-7 * (k + 1) for k, n in enumerate(model.parameters)})


@pytest.mark.parametrize(
    ("q", "w", "expected"),
    [
        ([[0.1]], [[0] * 6], "q: expected an array of shape (N, 2), found (1, 1)"),
        ([0.1, 0.2, 0.3], [0] * 6, "q: expected an array of shape (N, 2), found (3,)"),
        ([[0.1, 0.2]], [[0] * 5], "w: expected an array of shape (N, 6), found (1, 5)"),
        ([[[0.1, 0.2]]], [[0] * 6], "q: expected an array of shape (N, 2), found (1, 1, 2)"),
        ([[0.1, 0.2]] * 3, [[0] * 6] * 2, "found 3 in q and 2 in w"),
        ([[0.1, 0.2], [0.1]], [[0] * 6], "q: expected numbers of shape (N, 2)"),
        ([["a", "b"]], [[0] * 6], "q: expected numbers of shape (N, 2)"),
        ([[0.1, 0.2]], None, "w: expected an array of shape (N, 6), found ()"),
        (np.array([[0.1, 0.2j]]), [0] * 6, "q: expected numbers of shape (N, 2): found complex ones"),
        (np.ma.array([[1, 2]], mask=[[False, True]]), [0] * 6, "q: row 0 holds what is no finite number"),
    ],
)
def test_arrays_of_another_shape_are_a_users_mistake(q: Any, w: Any, expected: str) -> None:
    model = small()
    for method in (model.deflection, model.observation):
        with pytest.raises(UserError) as caught:
            method(q, w)
        assert expected in str(caught.value)


def test_lists_and_single_rows_will_do_and_no_pose_is_no_mistake() -> None:
    model = small()
    one = model.deflection([0.1, 0.2], [1, 2, 3, 4, 5, 6])
    assert one.shape == (1, 6)
    np.testing.assert_array_equal(
        model.deflection([[0.1, 0.2]] * 3, [1, 2, 3, 4, 5, 6]), np.tile(one, (3, 1))
    )
    assert model.observation([0.1, 0.2], [[1, 2, 3, 4, 5, 6]] * 2).shape == (2, 6, len(model.parameters))
    assert model.deflection(np.empty((0, 2)), [0] * 6).shape == (0, 6)


def test_a_column_of_another_length_than_the_poses_is_refused() -> None:
    model = small().with_effect(EffectInstance("thermal_drift", {"link": 1}, {"time": 100.0}))
    q, w = [[0.1, 0.2]] * 3, [0] * 6
    assert model.deflection(q, w, context={"time": 5.0}).shape == (3, 6)
    with pytest.raises(UserError, match=r"context: time: expected an array of shape \(3,\), found \(2,\)"):
        model.deflection(q, w, context={"time": [1.0, 2.0]})
    with pytest.raises(UserError, match="needs the column time"):
        model.observation(q, w)


def test_a_branch_beyond_the_loop_is_refused_as_by_generated_code() -> None:
    loop = small().with_effect(EffectInstance("hysteresis", {"joint": 1}, {"width": 20.0}))
    curved = small().with_effect(EffectInstance("hysteresis", {"joint": 1}, {"knee": 20.0}))
    q, w = [[0.1, 0.2]] * 2, [1.0] * 6
    assert loop.deflection(q, w, context={"branch": [0.5, -1.0]}).shape == (2, 6)
    for call in (loop.deflection, loop.compile().deflection):
        with pytest.raises(UserError, match=r"context: branch: row 1 holds 2: its size is <= 1"):
            call(q, w, context={"branch": [1.0, 2.0]})
    with pytest.raises(UserError, match=r"context: turn: row 0 holds 0\.5: its size is >= 1"):
        curved.deflection(q, w, context={"turn": 0.5})


def test_maps_and_plans_of_a_model_with_a_clock_take_the_time() -> None:
    model = small().with_effect(EffectInstance("thermal_drift", {"link": 1}, {"time": 100.0}))
    model = model.with_values({n: 1e-4 for n in model.parameters if n.startswith("thermal")})
    early, late = (
        workspace_for(model, [0] * 6, (1, 2), (3, 3), context={"time": t}).magnitude for t in (10.0, 50.0)
    )
    np.testing.assert_allclose(late, 5 * early, rtol=1e-12)
    chosen = plan(model, Goal(8), search=Search(100), context={"time": 50.0})
    assert chosen.q.shape == (8, 2)
    for call in (lambda: workspace_for(model, [0] * 6, (1, 2)), lambda: plan(model, Goal(8))):
        with pytest.raises(UserError, match=r"give context=\{'time': …\}"):
            call()


def test_values_of_parameters_that_a_model_does_not_have_are_refused() -> None:
    model = small()
    q, w = [[0.1, 0.2]], [0] * 6
    for spoilt in (
        lambda: model.deflection(q, w, values={"k2_67": 1.0}),
        lambda: model.observation(q, w, values={"k2_67": 1.0}),
        lambda: model.with_values({"k2_67": 1.0}),
        lambda: model.with_values({}, {"k2_67": 1.0}),
        lambda: model.vector({"k2_67": 1.0}),
        lambda: StiffnessModel.of(reduce(load("planar2r"), "wrench"), {"k2_67": 1.0}),
    ):
        with pytest.raises(
            UserError, match="planar2r: the model has no parameter 'k2_67': did you mean 'k2_66'"
        ):
            spoilt()


def test_of_two_clocks_the_first_effects_is_the_models() -> None:
    early, late = (
        EffectInstance("thermal_drift", {"link": k}, {"time": 600.0, "start": start})
        for k, start in ((1, 100.0), (2, 5000.0))
    )
    assert small().with_effects([early, late]).rest == {"time": 100.0}
    assert small().with_effects([late, early]).rest == {"time": 5000.0}


def test_an_entry_of_a_link_that_two_effects_bring_gives_way_once() -> None:
    robot = load("kuka_kr270")
    base, link = (EffectInstance(name, {"link": 0}) for name in ("base_compliance", "link_compliance"))
    q, w = [[0.1, -1.0, 1.2, 0.3, 0.5, -0.2]], [[300.0, -200.0, -2500.0, 50.0, 20.0, 10.0]]
    values = {"k0_55": 1e-7, "k0_26": 3e-8, "c2": 2e-7}
    once = joints_only(robot).with_effects([base]).deflection(q, w, values=values)
    np.testing.assert_allclose(
        joints_only(robot).with_effects([base, link]).deflection(q, w, values=values), once, rtol=1e-12
    )
    np.testing.assert_allclose(
        joints_only(robot).with_effects([link]).deflection(q, w, values=values), once, rtol=1e-12
    )


@pytest.mark.parametrize("wrong", [np.nan, [0.0, np.inf]])
def test_a_time_that_is_no_number_is_refused_where_the_model_follows_it(wrong: Any) -> None:
    drift = EffectInstance("thermal_drift", {"measurement": "frame"}, {"T": 3600.0})
    plain = StiffnessModel.of(reduce(load("planar2r"), "gravity"))
    model = plain.with_effect(drift)
    q, w = np.zeros((2, 2)), np.array([[0.0, 0, -10.0, 0, 0, 0]])
    for way in (model.deflection, model.observation):
        with pytest.raises(UserError, match=r"context: time: row [01] holds what is no finite number"):
            way(q, w, context={"time": wrong})
    assert np.isfinite(model.deflection(q, w, context={"time": 5.0, "temperature": wrong})).all()
