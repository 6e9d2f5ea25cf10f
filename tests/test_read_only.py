"""What models, reductions, effects and tables share stays as it is: changing it in place is refused."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from symstiff.calibration.simulation import Truth, nominal_truth
from symstiff.calibration.tables.measurements import measurements
from symstiff.effects.instance import EffectInstance
from symstiff.effects.registry import catalogue
from symstiff.model import StiffnessModel
from symstiff.reduction import reduce
from symstiff.robot import load

ROBOT = load("planar2r")
REDUCTION = reduce(ROBOT, "gravity", fixed={1: 0})
MODEL = StiffnessModel.of(REDUCTION)


@pytest.mark.parametrize(
    "shared",
    [
        lambda: EffectInstance("backlash", {"joint": 1}).where,
        lambda: MODEL.units,
        lambda: MODEL.steps,
        lambda: REDUCTION.partition.couplings,
        lambda: next(iter(REDUCTION.partition.couplings.values())),
        lambda: REDUCTION.stages[2].stands_for,
        lambda: REDUCTION.stages[2].reasons,
        lambda: REDUCTION.experiment.fixed,
        lambda: REDUCTION.standing,
        lambda: Truth(ROBOT, nominal_truth(ROBOT)).compliance,
    ],
)
def test_dictionaries(shared: Callable[[], Any]) -> None:
    values = shared()
    before = dict(values)
    with pytest.raises(TypeError, match="read-only"):
        values[next(iter(before), "other")] = 2
    with pytest.raises(TypeError, match="read-only"):
        values.clear()
    assert values == before
    again = pickle.loads(pickle.dumps(values))
    assert again == before
    assert type(again) is type(values)


def test_the_catalogue() -> None:
    with pytest.raises(TypeError, match="read-only"):
        catalogue().pop("backlash")  # type: ignore[attr-defined]


def test_the_projection_of_a_reduction() -> None:
    with pytest.raises(ValueError, match="read-only"):
        REDUCTION.projection[:] *= 2


def test_a_callers_dictionary_is_not_the_values_own() -> None:
    where = {"joint": 1}
    instance = EffectInstance("backlash", where)
    where["joint"] = 2
    assert instance.where == {"joint": 1}


def test_a_table_of_a_read_only_view_keeps_its_numbers() -> None:
    base = np.zeros((3, 2))
    view = base.view()
    view.flags.writeable = False
    sizes = np.ones((3, 6))
    loads = sizes.view()
    loads.flags.writeable = False
    table = measurements(view, loads)
    base[:], sizes[:] = 1.0, 2.0
    assert not table.q.any()
    assert (table.w == 1.0).all()


@pytest.mark.parametrize(
    "change",
    [
        lambda x: x.append(6),
        lambda x: x.__setitem__(0, 5),
        lambda x: x.sort(reverse=True),
        lambda x: x.__iadd__([1]),
        lambda x: x.clear(),
    ],
)
def test_the_place_of_an_effect(change: Callable[[Any], Any]) -> None:
    effect = EffectInstance("wrist_coupling", {"joints": [4, 5]})
    with pytest.raises(TypeError, match="read-only"):
        change(effect.where["joints"])
    assert effect.where == {"joints": [4, 5]}
    for same in (copy.deepcopy(effect), pickle.loads(pickle.dumps(effect))):
        assert same == effect
        assert hash(same) == hash(effect)
    assert json.dumps(effect.where) == '{"joints": [4, 5]}'
