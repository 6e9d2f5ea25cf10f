"""The self-test does not ask for an answer that rounding decides."""

from __future__ import annotations

from pathlib import Path

import pytest

from symstiff.codegen.compiler import find_compiler
from symstiff.codegen.functions import Functions
from symstiff.codegen.generate import generate
from symstiff.codegen.options import Options
from symstiff.codegen.reference import cases, plausible_values
from symstiff.effects import EffectInstance
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load


def narrow_loop() -> StiffnessModel:
    """A planar arm whose gear lags so steeply near zero load that the compliance there has almost no inverse."""
    model = StiffnessModel.of(reduce(load("planar2r"), "force", "position"))
    shape = {"width": 1.12, "load": 55.8, "power": 0.0}
    return model.with_effect(EffectInstance("hysteresis", {"joint": 2}, shape))


def test_a_compliance_that_rounding_makes_singular_is_no_test_of_the_stiffness() -> None:
    model = narrow_loop()
    found = cases(Functions(model), plausible_values(model))
    assert [(c.K, c.condition) for c in found] == [(None, -1.0)] * 3


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
def test_such_a_model_passes_its_self_test(tmp_path: Path) -> None:
    made = generate(narrow_loop(), tmp_path / "code", Options(targets=("c",)))
    assert made.verification.compiled
    assert made.verification.max_relative_error < 1e-9
