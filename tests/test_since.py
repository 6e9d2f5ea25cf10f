"""What became of a start model since it was made: what its own values leave, and which sizes changed."""

from __future__ import annotations

import numpy as np
import pytest

from symstiff.calibration.rows import predict
from symstiff.calibration.simulation import Effect, nominal_truth
from symstiff.discrepancy.bridge.growth import fit
from symstiff.discrepancy.findings.since import as_told, of_values, since
from symstiff.effects import EffectInstance
from symstiff.model import StiffnessModel, joints_only
from symstiff.reduction.reduce import reduce
from tests.test_outgrown import LASH, ROBOT, campaign, lash, start


@pytest.mark.parametrize(
    ("now", "said"),
    [((lash(gap=9e-4),), "its size has changed"), ((), "nothing is left of it"), ((lash(),), None)],
    ids=["larger", "gone", "as it was"],
)
def test_sizes_that_do_not_hold_any_more_are_remarked(now: tuple[Effect, ...], said: str | None) -> None:
    told = start(LASH, {"backlash_3_gap": 5e-4}, 1e-5)
    remarks = since(told, fit(told, campaign(*now)).model)
    assert len(remarks) == (said is not None)
    if said:
        assert remarks[0].startswith(f"backlash at joint 3: {said}")
        assert "backlash_3_gap 0.500 ± 0.010 mrad, now" in remarks[0]


@pytest.mark.parametrize("kind", ["deflection", "absolute"])
def test_a_start_model_is_told_by_what_its_own_values_leave(kind: str) -> None:
    """The values of the truth leave the noise; a joint twice as stiff leaves what it gives way less."""
    model = joints_only(ROBOT)
    joints = {p: nominal_truth(ROBOT)[p] for p in model.parameters}
    softer = dict(joints, c2=2.0 * joints["c2"])
    table = campaign(kind=kind)
    fitted = fit(model.with_values(joints), table)
    assert as_told(model.with_values(joints), fitted) == pytest.approx(3e-5, rel=0.15)
    wrong = as_told(model.with_values(softer), fitted)
    if kind == "deflection":
        left = (table.values - predict(model.with_values(softer), table))[:, :3]
        assert wrong == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-3)
    assert wrong > 1e-4
    assert of_values(wrong, fitted)[0].startswith(
        "with its own values the start model, and code that was made"
    )
    assert of_values(3e-5, fitted) == []


def test_a_start_model_with_deviations_and_no_values_is_told_nothing_of() -> None:
    told = start(LASH).with_values({}, {"backlash_3_gap": 1e-5})
    assert since(told, fit(told, campaign(lash())).model) == []


def test_a_size_of_which_the_start_model_does_not_tell_how_sure_it_is_is_not_remarked() -> None:
    told = start(LASH, {"backlash_3_gap": 5e-4})
    bare = told.with_values(told.values)
    assert since(bare, fit(bare, campaign()).model) == []


def test_a_compliance_that_changed_may_be_one_that_was_eliminated() -> None:
    """The base's block shares compliances with the reduced model, where they bear their part of others."""
    complete = StiffnessModel.of(reduce(ROBOT)).with_effect(EffectInstance("base_compliance", {"link": 0}))
    shared = next(
        p.name for p in complete.realisations[0].parameters if p.name in complete.stiffness_parameters
    )
    before, after = (
        complete.with_values({**complete.values, shared: v}, {shared: 1e-9}) for v in (1e-8, 9e-8)
    )
    (remark,) = since(before, after)
    assert "its size, or that of compliances that it stands for, has changed" in remark
