"""The example in the README of a generated folder runs as it stands."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.codegen.emit import emit_c
from symstiff.codegen.functions import Functions
from symstiff.codegen.options import Options
from symstiff.codegen.targets import TARGETS
from symstiff.effects.instance import EffectInstance
from symstiff.files import write_tree
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load
from tests.generated_c import model, poses

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
