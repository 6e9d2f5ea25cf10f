"""The examples of a generated folder, in its README and main.c, compile and run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from symstiff.codegen.emit import emit_c
from symstiff.codegen.functions import Functions
from symstiff.codegen.names import measured_between
from symstiff.codegen.options import Options
from symstiff.codegen.targets import TARGETS
from symstiff.effects.instance import EffectInstance
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load
from tests.generated_c import STRICT, compiler, model, poses, run

ROBOT = "ur10"
MOMENT = {"time": 100.0, "temperature": 25.0, "branch": -1.0}
EFFECTS = (
    EffectInstance("hysteresis", {"joint": 3}, {"width": 20.0, "load": 500.0, "power": 0.5}),
    EffectInstance("thermal_drift", {"link": 3}, {"time": 480.0}),
)


@pytest.mark.parametrize("known", [0, 1, 2])
def test_the_casadi_example_names_what_the_model_has_to_know_of_the_moment(tmp_path, known):
    pytest.importorskip("casadi")
    m = model(ROBOT)
    for effect in EFFECTS[:known]:
        m = m.with_effect(effect)
    m = m.with_values(dict(m.values) | {e.name: e.typical for e in m.effect_parameters})
    options = Options(targets=("c", "casadi"))
    for target in options.targets:
        write_tree(tmp_path, TARGETS[target].emitter()(Functions(m), options))
    text = (tmp_path / "README.md").read_text()
    code = text.split("```python")[1].split("```")[0].replace('load("', f'load("{tmp_path}/')
    q, w = poses(ROBOT, 1)
    scope = {"p": m.vector(), "q": q[0], "w": w[0], **MOMENT}
    exec(compile(code, "README.md", "exec"), scope)
    wanted = m.deflection(q, w, context={k: np.array([v]) for k, v in MOMENT.items()})[0]
    np.testing.assert_allclose(np.array(scope["dt"]).ravel(), wanted, rtol=1e-9, atol=1e-15)
    assert len(scope.get("context", ())) == known


@pytest.mark.parametrize("loads", ["gravity", "force", "wrench"])
def test_loads_that_the_code_is_not_for_are_told_where_it_is_called(loads: str) -> None:
    written = emit_c(Functions(StiffnessModel.of(reduce(load("planar2r"), loads))), Options(targets=("c",)))
    told = f"pass only those of the class *{loads}*" in written["README.md"].decode()
    assert told == (loads != "wrench")


def test_every_file_of_a_target_is_told() -> None:
    f = Functions(StiffnessModel.of(reduce(load("planar2r"))))
    options = Options(targets=tuple(TARGETS))
    readme, plain = (emit_c(f, o)["README.md"].decode() for o in (options, Options()))
    for name in ("cpp", "python", "fmi2", "fmi3", "st", "params", "rls"):
        for file in TARGETS[name].emitter()(f, options):
            told = file if name not in ("params", "rls") else file.replace(".h", ".c")
            assert f"`{told}`" in readme
            assert f"`{told}`" not in plain


def moving() -> StiffnessModel:
    """A model of a gear that lags and a link that grows, from second 50 of the clock on."""
    grows = EffectInstance("thermal_drift", {"link": 3}, {"time": 480.0, "start": 50.0})
    m = model(ROBOT).with_effects((EFFECTS[0], grows))
    return m.with_values(dict(m.values) | {e.name: e.typical for e in m.effect_parameters})


def test_the_example_in_c_sets_what_holds_at_a_call(tmp_path: Path) -> None:
    write_tree(tmp_path, emit_c(Functions(moving()), Options(targets=("c",))))
    header, readme = ((tmp_path / name).read_text() for name in (f"{ROBOT}.h", "README.md"))
    assert "UR10_TIME_MIN 50.0" in header
    assert "UR10_TIME_MAX 530.0" in header
    told = "double q[6], double w[6], double time_now, double branch_now"
    include, call = readme.split("```c\n")[1].split("```")[0].split("\n", 1)
    (tmp_path / "call.c").write_text(
        f"{include}\nint call({told});\nint call({told})\n{{\n{call}return status;\n}}\n"
    )
    run(compiler(), *STRICT, "-I.", "-c", "call.c", cwd=tmp_path)
    run(compiler(), *STRICT, "-I.", f"{ROBOT}.c", "main.c", "-o", "use", "-lm", cwd=tmp_path)
    shown = re.search(r"deflection \[mm\]: (.*)", run("./use", cwd=tmp_path))
    text = (tmp_path / "main.c").read_text()
    shown_as = (re.search(rf"{name} = \{{(.*?)\}}", text)[1] for name in (r"q\[.*\]", r"w\[6\]"))
    q, w = (np.array([[float(x) for x in numbers.split(",")]]) for numbers in shown_as)
    late = {"time": np.array([530.0]), "branch": np.array([1.0])}
    wanted = moving().deflection(q, w, context=late)[0, :3]
    np.testing.assert_allclose(np.array(shown[1].split(), float), 1e3 * wanted, atol=1e-4)


def test_paragraphs_and_tables_of_the_readme_stand_apart() -> None:
    position = StiffnessModel.of(reduce(load(ROBOT), "wrench", "position"))
    for m in (model(ROBOT), model(ROBOT, "wrench"), moving(), position):
        text = emit_c(Functions(m), Options(targets=("c",)))["README.md"].decode()
        lines = text.splitlines()
        starts = [k for k, line in enumerate(lines) if line.startswith("|---")]
        assert starts
        assert all(lines[k - 2] == "" for k in starts)
        assert "\n\n\n\n" not in text
        for begin in ("What holds at the call", "The parameters were reduced", "Loads of another class"):
            assert f"\n{begin}" not in text or f"\n\n{begin}" in text


def test_the_range_to_be_held_is_that_in_which_all_effects_were_measured() -> None:
    early = EffectInstance("thermal_drift", {"link": 1}, {"time": 480.0, "start": 50.0})
    late = EffectInstance("thermal_drift", {"link": 2}, {"time": 3600.0})
    apart = EffectInstance("thermal_drift", {"link": 2}, {"time": 60.0, "start": 9000.0})
    assert measured_between(model("scara").with_effects((early, late))) == {"time": (50.0, 530.0)}
    assert measured_between(model("scara").with_effects((early, apart))) == {}
    warm = EffectInstance("thermal_drift", {"link": 2}, {"temperature": 8.0, "reference": 22.0})
    assert measured_between(model("scara").with_effects((early, warm))) == {
        "time": (50.0, 530.0),
        "temperature": (22.0, 30.0),
    }


@pytest.mark.parametrize(
    ("shapes", "told"),
    [
        (({},), ("SCARA_TIME_MIN 0.0\n", "SCARA_TIME_MAX 3600.0\n", "measured from SCARA_TIME_MIN to _MAX")),
        (({"start": 50.0, "T": 100.0},), ("SCARA_TIME_MIN 50.0\n", "SCARA_TIME_MAX 3650.0\n")),
        (({"temperature": 8.0},), ("SCARA_TEMPERATURE_MIN 20.0\n", "SCARA_TEMPERATURE_MAX 28.0\n")),
        (({}, {"time": 60.0, "start": 9000.0}), ("Of time the effects tell none, or none that is the same",)),
        ((), ()),
    ],
)
def test_every_law_that_follows_a_clock_tells_its_range_or_that_it_has_none(
    shapes: tuple, told: tuple
) -> None:
    drifts = [EffectInstance("thermal_drift", {"link": k}, shape) for k, shape in enumerate(shapes, 1)]
    header = emit_c(Functions(model("scara").with_effects(drifts)), Options(targets=("c",)))[
        "scara.h"
    ].decode()
    assert all(text in header for text in told)
    assert ("Their laws go on beyond" in header) == bool(shapes)


LIMITS = """
#include "{robot}.h"
#include <stdio.h>

int main(void)
{{
    static const {real} low[{n}] = {upper}_Q_MIN;
    static const {real} high[{n}] = {upper}_Q_MAX;
    static const int known[6] = {upper}_W_KNOWN;
    int i;
    for (i = 0; i < {n}; ++i) {{
        printf("%.9g %.9g ", (double)low[i], (double)high[i]);
    }}
    for (i = 0; i < 6; ++i) {{
        printf("%d ", known[i]);
    }}
    return 0;
}}
"""


@pytest.mark.parametrize(
    ("robot", "precision", "loads", "known"),
    [
        ("scara", "double", "gravity", [0, 0, 1, 0, 0, 0]),
        ("planar2r", "float", "force", [1, 1, 1, 0, 0, 0]),
        ("planar2r", "double", "wrench", [1, 1, 1, 1, 1, 1]),
    ],
)
def test_a_controller_finds_joint_limits_and_what_loads_the_model_knows(
    tmp_path: Path, robot: str, precision: str, loads: str, known: list[int]
) -> None:
    m = model(robot, loads)
    write_tree(tmp_path, emit_c(Functions(m), Options(targets=("c",), precision=precision)))
    names = {"robot": robot, "upper": robot.upper(), "real": precision, "n": m.robot.dof}
    (tmp_path / "limits.c").write_text(LIMITS.format(**names))
    run(compiler(), *STRICT, "-I.", "limits.c", "-o", "limits", cwd=tmp_path)
    shown = [float(x) for x in run("./limits", cwd=tmp_path).split()]
    limits = [x for j in m.robot.joint for x in j.range]
    np.testing.assert_allclose(shown, [*limits, *known], rtol=1e-6)


def test_a_controller_finds_what_the_values_were_identified_from() -> None:
    m, between = model("planar2r", "force"), (-0.25, 0.5)
    names = ("q1", "q2", "fx", "fy", "fz", "mx", "my", "mz")
    seen = m.with_seen(dict.fromkeys(names, between) | {"time": (3.0, 9.0)})
    header, plain, half = (
        emit_c(Functions(x), Options(targets=("c",)))["planar2r.h"].decode()
        for x in (seen, m, m.with_seen({"q1": between}))
    )
    assert "#define PLANAR2R_Q_SEEN_MIN {-0.25, -0.25}\n#define PLANAR2R_Q_SEEN_MAX {0.5, 0.5}\n" in header
    assert "PLANAR2R_W_SEEN_MAX {0.5, 0.5, 0.5, 0.5, 0.5, 0.5}" in header
    assert "_SEEN_" not in plain + half
    assert measured_between(seen) == {"time": (3.0, 9.0)}


@pytest.mark.parametrize("precision", ["double", "float"])
def test_a_smaller_correction_may_be_asked_for(tmp_path: Path, precision: str) -> None:
    write_tree(tmp_path, emit_c(Functions(model("scara")), Options(targets=("c",), precision=precision)))
    run(
        compiler(),
        *STRICT,
        "-DSCARA_MAX_CORRECTION=1e-9",
        "-I.",
        "scara.c",
        "main.c",
        "-o",
        "use",
        "-lm",
        cwd=tmp_path,
    )
    assert "compensate: error -5" in run("./use", cwd=tmp_path)
