"""Closed forms for reading, and what objects show in a notebook."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import sympy as sp

import symstiff
from symstiff import ElasticChain, StiffnessModel, load, observation_matrix, reduce, virtual_jacobian
from symstiff.effects.arm import own_load
from symstiff.effects.instance import EffectInstance
from symstiff.model import joints_only
from symstiff.reduction.physical import Parameter
from symstiff.robot import from_table
from symstiff.robot.table import to_table
from symstiff.symbolic.numeric import kinematics
from symstiff.symbolic.program import Emit, Program, Vector
from symstiff.symbolic.programs import observation_program
from symstiff.symbolic.reading import _with_functions, original_terms, written_out
from symstiff.symbolic.terms import actuated_joint, tau
from tests.diagnosis_data import HARDENING, ROBOT, measured

ROBOTS = ("planar2r", "scara", "kuka_kr270")


def _at(matrix, values):
    return np.array(sp.lambdify(list(values), matrix, "numpy")(*values.values()), dtype=float)


def _configuration(chain, seed=2):
    rng = np.random.default_rng(seed)
    q = {sp.Symbol(f"q_{i}", real=True): v for i, v in enumerate(rng.uniform(-1, 1, chain.dof), start=1)}
    return q, rng.normal(size=6)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_jacobian_written_out_is_the_numeric_one(name):
    chain = ElasticChain(load(name))
    q, _ = _configuration(chain)
    seen = _at(virtual_jacobian(chain), q)
    np.testing.assert_allclose(seen, kinematics(chain.robot, [list(q.values())]).J_theta[0], atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_the_observation_matrix_by_columns_is_what_the_program_lets_be_temporaries(name):
    chain = ElasticChain(load(name))
    q, wrench = _configuration(chain)
    stage = reduce(chain.robot).stages[3]
    by_columns = _at(observation_matrix(chain, wrench, stage.terms), q)
    program = written_out(observation_program(chain, stage.terms, stage.names))["A"]
    w = {sp.Symbol(f"w_{c}", real=True): v for c, v in enumerate(wrench, start=1)}
    np.testing.assert_allclose(_at(program, q | w), by_columns, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_original_terms_are_those_of_the_reductions_first_stage(name):
    chain = ElasticChain(load(name))
    assert original_terms(chain) == reduce(chain.robot).stages[0].terms


def test_every_step_multiplies_the_observation_matrix_by_its_binary_map():
    chain = ElasticChain(load("planar2r"), symbolic=True)
    force = (*sp.symbols("f_x f_y", real=True), 0, 0, 0, 0)
    stages = reduce(chain.robot, "force").stages
    for before, after in pairwise(stages):
        A, reduced = (observation_matrix(chain, force, s.terms) for s in (before, after))
        difference = A * sp.Matrix(after.matrix.tolist()) - reduced
        assert difference.applyfunc(sp.expand).is_zero_matrix


def test_lengths_of_a_symbolic_chain_stay_symbols():
    chain = ElasticChain(load("planar2r"), symbolic=True)
    assert set(map(str, virtual_jacobian(chain).free_symbols)) == {"a_1", "a_2", "q_1", "q_2"}


def test_objects_show_tables_with_what_matters():
    robot = load("kuka_kr270")
    reduction = reduce(robot, "gravity", "pose")
    model = StiffnessModel.of(reduction)
    assert "3.02e-07 rad/(N·m)" in robot._repr_html_()
    assert "rotation about z of frame 3" in ElasticChain(robot)._repr_html_()
    assert "elimination of what has no influence (G1 1, G2 10, G3 45)" in reduction._repr_html_()
    assert "equals" not in reduction.stages[1]._repr_html_()
    assert "compliance matrices are symmetric" in reduction.stages[1]._repr_html_()
    assert "link 1: rotation about 3 by moment about 3" in model._repr_html_()
    assert repr(reduction) == "Reduction(kuka_kr270, gravity, pose: 258 to 26 parameters)"
    assert repr(reduction.stages[3]) == "Stage(M3: 56 parameters)"
    assert repr(model) == "StiffnessModel(kuka_kr270: 26 parameters)"


def test_tables_escape_what_a_robot_file_says():
    robot = load("planar2r").model_copy(update={"source": "<script>alert(1)</script>"})
    assert "<script>" not in robot._repr_html_()


def test_a_robot_shows_itself_in_a_line() -> None:
    assert repr(load("scara")) == str(load("scara")) == "Robot(scara: 4 joints RRPR)"


def test_importing_symstiff_imports_no_symbolic_or_numeric_library():
    code = (
        "import sys, symstiff; print([m for m in ('sympy', 'numpy', 'casadi', 'pandas') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_exported_name_is_found_and_others_are_not():
    for name in symstiff._HOME:
        assert callable(getattr(symstiff, name))
        assert name in dir(symstiff)
    assert {name for name in dir(symstiff) if name[0] != "_"} == set(symstiff.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        symstiff.nothing  # noqa: B018


def test_a_beam_along_a_direction_is_shown_with_its_numbers() -> None:
    table = to_table(load("scara"))
    table["joint"][1]["link"] = {"beam_axis": [0.35, 0.0, 0.675]}
    page = ElasticChain(from_table(table))._repr_html_()
    assert "(0.4603, 0, 0.8878)" in page


def test_a_coupling_says_which_motion_comes_from_which_load():
    assert Parameter("k2_26", 2, 2, 6).meaning == (
        "link 2: translation along 2 by moment about 3 (and its mirror)"
    )
    assert Parameter("k0_35", 0, 3, 5).meaning == (
        "link 0 (pedestal): translation along 3 by moment about 2 (and its mirror)"
    )
    assert Parameter("k1_44", 1, 4, 4).meaning == "link 1: rotation about 1 by moment about 1"


def _turned_arm():
    """The planar arm out of its plane and with an odd zero of joint 2: constants, and an angle of its own."""
    table = to_table(load("planar2r"))
    table["joint"][0]["alpha"] = "pi/4"
    table["joint"][1]["theta"] = 0.3
    return from_table(table, "turned")


_LETTER = re.compile(r"(?:\\mathrm\{\w+\}|\\\w+|[A-Za-z]+)_\{[^{}]*\}")


@pytest.mark.parametrize("kind", ["observation_program", "deflection_program"])
def test_a_program_in_latex_defines_every_letter_once_and_before_its_use(kind, monkeypatch):
    monkeypatch.setattr("symstiff.symbolic.latex._LINES", 10**6)
    program = getattr(joints_only(_turned_arm()), kind)
    text = program._repr_latex_().removeprefix(r"$$\begin{aligned}").removesuffix(r"\end{aligned}$$")
    known = {f"{s.name[0]}_{{{s.name[1:].strip('_')}}}" for v in program.inputs for s in v.symbols}
    assert "q_{1}" in known
    for line in text.split(r"\\"):
        left, right = line.split(" &= ")
        assert left not in known
        assert set(_LETTER.findall(right)) <= known
        known.add(left)
    assert {r"\mathrm{const}_{0}", r"\mathrm{c}_{2}", r"\varphi_{2}"} <= known


def test_outputs_in_latex_have_rows_and_columns_from_one():
    x = sp.Symbol("x")
    statements = (Emit("A", 0, x), Emit("A", 5, -x), Emit("dt", 1, x))
    program = Program("made_up", (Vector("x", (x,)),), (), statements, (("A", (2, 3)), ("dt", (2,))))
    assert r"A_{1,1} &= x\\A_{2,3} &= - x\\dt_{2} &= x" in program._repr_latex_()


def test_laws_in_latex_keep_their_indices_apart():
    text = StiffnessModel.of(reduce(load("planar2r"), "force", "position"))._repr_latex_()
    assert r"\Delta\theta_{\mathrm{link1,3}} &= k_{1,35}\,\tau_{\mathrm{link1,5}}" in text
    assert re.search(r"_\{[^}]* ", text) is None


def grown_model() -> StiffnessModel:
    model = StiffnessModel.of(reduce(load("ur10"), "gravity", "position"))
    for effect, where, shape in (
        ("hysteresis", {"joint": 2}, {"width": 5.0, "weights": 1.0}),
        ("nonlinear_stiffness", {"joint": 2}, {"weights": 1.0}),
        ("thermal_drift", {"link": 2}, {"time": 1800.0}),
        ("large_deflection", {"robot": "all"}, {}),
    ):
        model = model.with_effect(EffectInstance(effect, where, shape))
    return model


def test_laws_of_a_grown_model_name_effects_and_write_the_links_weight_once_below_them():
    text = grown_model()._repr_latex_()
    lines = text.split(r"\\")
    hysteresis = r"\mathrm{branch}\,\mathrm{hysteresis}_{\mathrm{2,width}}\,\tanh{\left(\frac{f_{1}}{5}"
    assert sum(hysteresis in line for line in lines) == 1
    assert r"\mathrm{thermal\ drift}_{\mathrm{2,x}}\,\mathrm{time}}{1800}" in text
    weight = [line for line in lines if line.startswith("f_{")]
    assert len(weight) == 1
    assert weight[0].startswith(r"f_{1}(q) &= - 2.6645\,\sin{\left(q_{2} + q_{3} + q_{4} \right)}")
    assert lines[-1].startswith(r"\Delta t &\;\text{also by large deflection}")


def test_functions_of_a_law_written_out_again_are_the_law():
    weight = own_load(load("ur10"), 2, {"weights": 1.0})
    law = sp.tanh(tau(actuated_joint(2)) + weight) * sp.Symbol("branch") - sp.Abs(weight) * weight
    functions: dict[sp.Expr, sp.Symbol] = {}
    short = _with_functions(law, functions)
    assert len(functions) == 1
    at = {s: 0.3 * k + 0.2 for k, s in enumerate(sorted(law.free_symbols, key=str))}
    again = short.xreplace({f: known for known, f in functions.items()})
    assert float((again - law).xreplace(at)) == pytest.approx(0.0, abs=1e-12)
    assert short.free_symbols.isdisjoint(weight.free_symbols)


def test_a_grown_models_table_tells_what_its_shapes_mean_and_what_it_asks():
    html = grown_model()._repr_html_()
    assert "hysteresis at joint 2: turning over within ± 5 N·m; links&#x27; weight counted" in html
    assert "needs branch and time of every row" in html or "needs time and branch of every row" in html
    assert "nonlinear stiffness at joint 2: of load^3" in html
    assert ">effect<" not in html


def test_results_say_in_a_line_what_they_are(tmp_path):
    model = StiffnessModel.of(reduce(load("planar2r"), "force", "position"))
    model = model.with_values(dict.fromkeys(model.parameters, 1e-6))
    made = symstiff.generate(model, tmp_path / "code", compile_c=False)
    worst = f"{made.verification.max_relative_error:.1g}"
    assert repr(made).endswith(
        f"code': {len(model.parameters)} compliances, not compiled, relative error {worst})"
    )
    found = symstiff.compensate(model, [[0.1, 1.2]] * 2, [[10.0, 20, 0, 0, 0, 0], [1e6, 0, 0, 0, 0, 0]])
    before, after = (
        1e3 * np.sqrt(np.mean(np.sum(e[:, :3] ** 2, axis=1))) for e in (found.before, found.after)
    )
    assert (
        repr(found) == f"Compensated(2 rows, 1 as they were: {before:.3g} to {after:.3g} mm rms by the model)"
    )
    fit = symstiff.identify(load(ROBOT), measured(HARDENING))
    assert repr(fit.fit).startswith(
        f"Estimate({len(fit.fit.names)} parameters, {len(fit.fit.residuals)} readings, s0² = "
    )
    assert repr(fit.training).startswith("ResidualTable(positional ")
    truth = symstiff.truth_from_table({"format": 1, "robot": "planar2r", "noise": {"sigma_mm": 0.03}})
    assert repr(truth) == "Truth(planar2r: noise 0.03 mm)"


def test_tables_fits_plans_and_findings_show_a_line_and_a_table():
    robot, table = load(ROBOT), measured(HARDENING)
    fit = symstiff.identify(robot, table)
    plan = symstiff.plan(fit.model, symstiff.Goal(6), search=symstiff.calibration.plan.Search(200, 1))
    finding = symstiff.diagnose(symstiff.Task(robot, table))
    line = f"deflection: {len(table)} rows, {len(table.labels)} poses, 2 joints, points p1 p2 p3"
    assert repr(table) == f"Measurements({line})"
    size = 1e3 * np.sqrt(np.mean(np.sum(np.asarray(table.values)[:, :3] ** 2, axis=1)))
    assert repr(fit).startswith(f"Identification({ROBOT}: {len(fit.fit.names)} parameters, {size:.3f} to ")
    assert repr(plan) == f"Plan({ROBOT}, criterion D: 6 poses for {len(fit.fit.names)} parameters)"
    assert repr(finding).startswith(f"Finding({ROBOT}, named: nonlinear stiffness at joint ")
    assert f"{fit.fit.values[0]:.4g}" in fit._repr_html_()
    assert "nonlinear stiffness" in finding._repr_html_()
    assert fit.fit.names[-1] in plan._repr_html_()
    assert f"and {len(table) - 8} more" in table._repr_html_()
    assert all(len(repr(x)) < 300 and "\n" not in repr(x) for x in (table, fit, plan, finding))
    markup = replace(table, labels=("<script>", *table.labels[1:]))
    assert "<script>" not in markup._repr_html_()
