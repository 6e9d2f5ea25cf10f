"""The self-test does not ask for an answer that rounding decides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.functions import Functions
from symstiff.codegen.generate import generate
from symstiff.codegen.options import Options
from symstiff.codegen.reference import cases, configurations, plausible_values
from symstiff.compensation import compensate, compensate_online
from symstiff.effects import EffectInstance
from symstiff.model import StiffnessModel, joints_only
from symstiff.reduction import reduce
from symstiff.robot import Robot, load
from symstiff.robot.loading import parse


def narrow_loop() -> StiffnessModel:
    """A planar arm whose gear lags so steeply near zero load that the compliance there has almost no inverse."""
    model = StiffnessModel.of(reduce(load("planar2r"), "force", "position"))
    shape = {"width": 0.01, "load": 55.8, "power": 0.0}
    return model.with_effect(EffectInstance("hysteresis", {"joint": 2}, shape))


def test_a_compliance_that_rounding_makes_singular_is_no_test_of_the_stiffness() -> None:
    model = narrow_loop()
    found = cases(Functions(model), plausible_values(model))
    assert [(c.K, c.condition) for c in found] == [(None, -1.0)] * len(found)


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_such_a_model_passes_its_self_test(tmp_path: Path) -> None:
    made = generate(narrow_loop(), tmp_path / "code", Options(targets=("c",)))
    assert made.verification.compiled
    assert made.verification.max_relative_error < 1e-9


def arm(name: str, rows: list[tuple[float, str, float]], tool: str) -> Robot:
    """A revolute arm of DH rows (a, alpha, d)."""
    joints = "".join(
        f'[[joint]]\na = {a}\nalpha = "{alpha}"\nd = {d}\n[joint.link]\nbeam_axis = "x"\n'
        for a, alpha, d in rows
    )
    text = f'format = 1\nname = "{name}"\n{joints}[tool]\nxyz = {tool}\n'
    return parse(text.encode(), name)


PLANAR_4R = [(0.5, "0", 0), (0.4, "0", 0), (0.3, "0", 0), (0.2, "0", 0)]
FOUR_PARALLEL = [
    (0.5, "0", 0.1), (0.4, "0", 0), (0.3, "0", 0), (0.2, "pi/2", 0), (0.1, "pi/2", 0.1), (0.1, "0", 0.05)
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize(
    ("rows", "tool"), [(PLANAR_4R, "[0, 0, 0]"), (FOUR_PARALLEL, "[0.05, 0.1, 0.3]")], ids=["4R", "6R"]
)
def test_generated_code_compensates_nowhere_where_a_robot_never_has_the_rank_of_its_joints(
    rows: list[tuple[float, str, float]], tool: str, precision: str, tmp_path: Path
) -> None:
    model = StiffnessModel.of(reduce(arm("dull", rows, tool), "wrench"))
    values = plausible_values(model)
    found = cases(Functions(model), values)
    assert [(c.compensation, [float(x) for x in c.q_cmd]) for c in found] == [(-3, list(c.q)) for c in found]
    made = generate(
        model,
        tmp_path / "code",
        Options(precision=precision, targets=("c",)),
        compile_c=find_compiler() is not None,
    )
    if made.verification.compiled:
        assert made.verification.max_relative_error < (1e-12 if precision == "double" else 2e-5)
    q, w = np.array([c.q for c in found]), np.array([c.w for c in found])
    corrected = compensate(model.with_values(values), q, w)  # off-line the arm does what it can
    assert corrected.solved.mean() > 0.5
    np.testing.assert_array_equal(corrected.q_cmd[~corrected.solved], q[~corrected.solved])
    np.testing.assert_array_equal(compensate_online(model.with_values(values), q, w), q)


@pytest.mark.parametrize("seed", [3, 23])
def test_a_stiffness_that_single_precision_cannot_tell_is_no_reference_for_it(seed: int) -> None:
    """Two joints in a plane: what the links give one way is over ten thousand times what they give another."""
    model = StiffnessModel.of(reduce(load("planar2r"), "force", "position"))
    functions, values = Functions(model), plausible_values(model)
    double, single = (cases(functions, values, 20, seed, s) for s in (False, True))
    assert all(c.K is None or c.condition < 1.01e4 for c in single)
    assert any(
        a.K is not None and b.K is None and b.condition == -1.0 for a, b in zip(double, single, strict=True)
    )


@pytest.mark.filterwarnings("error")
def test_a_robot_without_reach_is_tested_where_its_tool_turns() -> None:
    robot = arm("zero", [(0, "0", 0), (0, "0", 0)], "[0, 0, 0]")
    assert robot.reach == 0
    functions = Functions(StiffnessModel.of(reduce(robot, "wrench", "pose")))
    assert len({q for q, _ in configurations(functions, 3)}) == 3


RAIL = """
format = 1
name = "rail5"
[[joint]]
type = "prismatic"
a = 0.15
alpha = "-pi/2"
d = 0.2
limits = [0, 0.8]
[[joint]]
a = 0.5
alpha = 0
d = 0.05
[[joint]]
a = 0.06
alpha = "pi/2"
d = 0
[[joint]]
a = 0
alpha = "-pi/2"
d = 0.4
[[joint]]
a = 0
alpha = 0
d = 0.1
[tool]
xyz = [0.03, 0.05, 0.12]
rpy = [0.1, 0, 0.2]
"""


def of_joints(robot: Robot, effect: str, joint: int, shape: dict[str, float]) -> StiffnessModel:
    """Compliant joints, and a law of one of them."""
    model = joints_only(robot)
    model = model.with_values({n: 1e-6 * k for k, n in enumerate(model.parameters, start=1)})
    return model.with_effect(EffectInstance(effect, {"joint": joint}, shape))


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("joint", [3, 4, 5])
def test_five_joints_give_no_stiffness_in_single_precision_either(joint: int, tmp_path: Path) -> None:
    model = of_joints(parse(RAIL.encode()), "backlash", joint, {"width": 10.0})
    found = cases(Functions(model), plausible_values(model), single=True)
    assert [(c.K, c.condition) for c in found] == [(None, 0.0)] * len(found)
    made = generate(model, tmp_path / "code", Options(precision="float", targets=("c",)))
    assert made.verification.selftest is not None


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_turns_that_cancel_each_other_are_held_to_what_rounding_leaves_of_them(tmp_path: Path) -> None:
    """A SCARA's axes are parallel: its one rotation is the difference of what joints turn."""
    model = of_joints(load("scara"), "hysteresis", 4, {"width": 10.0})
    found = cases(Functions(model), plausible_values(model), single=True)
    assert max(c.sizes[1] / max(abs(float(x)) for x in c.dt[3:]) for c in found) > 10
    made = generate(model, tmp_path / "code", Options(precision="float", targets=("c",)))
    assert made.verification.selftest is not None
