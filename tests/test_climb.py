"""When the complete model takes the place of the joints-only one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.discrepancy.climb import leaves_less
from symstiff.discrepancy.finding import Task
from symstiff.discrepancy.localise import FittedDevice
from symstiff.discrepancy.result import Diagnosis, Name, Quantity, Rms
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load
from tests.diagnosis_data import ROBOT, measured

ROWS = 400


@pytest.fixture(scope="module")
def some() -> Diagnosis:
    return diagnose(Task(load(ROBOT), measured())).last


@pytest.mark.parametrize(
    ("wider", "better"),
    [
        (Rms(1.0, 1.0, 1.2, 1.0, 0.9), True),
        (Rms(1.0, 1.0, 5.0, 1.0, 0.9), False),
        (Rms(1.0, 1.0, None, None, 0.9), True),
        (Rms(3.0, 1.0, 1.2, 1.0, 0.9), False),
    ],
)
def test_a_model_that_left_out_poses_refute_does_not_take_over(
    some: Diagnosis, wider: Rms, better: bool
) -> None:
    """Four poses fit all links and predict none."""
    narrow = replace(some, verdict="unexplained", rms=Rms(2.0, 2.0, 2.1, 2.1, 0.9))
    axes = np.zeros(ROWS, dtype=np.intp)
    assert leaves_less(replace(some, rms=wider), narrow, axes) is better


@pytest.mark.parametrize(("explained", "better"), [(0.3, False), (0.05, True)])
def test_a_law_of_the_device_is_a_simpler_account_than_all_links(
    some: Diagnosis, explained: float, better: bool
) -> None:
    """Fourteen parameters that explain a quarter of 400 squares, and one that explains more of them, or little."""
    noise = some.noise.by_component()[0]
    step, left = some.growth[0], np.full(ROWS, noise)
    law = FittedDevice("measuring device", (("scale error", 80.0, 5.0, "ppm"),), explained)
    narrow = replace(
        some,
        verdict="unexplained",
        device_law=law,
        growth=(replace(step, residual=left, model_std=np.ones(2)),),
        rms=Rms(2.0, 2.0, 2.1, 2.1, 0.9),
    )
    whole = replace(step, residual=left * np.sqrt(0.75), model_std=np.ones(16))
    wide = replace(some, growth=(whole,), rms=Rms(1.0, 1.0, 1.2, 1.0, 0.9))
    assert leaves_less(wide, narrow, np.zeros(ROWS, dtype=np.intp)) is better


@pytest.mark.parametrize(
    ("explained", "held_out", "better"),
    [(0.0, 0.9, False), (14.0, 0.9, False), (60.0, 0.9, True), (60.0, 1.1, False)],
)
def test_links_that_were_named_give_way_to_what_is_significantly_more(
    some: Diagnosis, explained: float, held_out: float, better: bool
) -> None:
    """Ten parameters more explain χ² of 10 ± 4.5 by chance, and of 60 with 4e-9."""
    noise = some.noise.by_component()[0]
    left = np.full(ROWS, noise)
    less = left * np.sqrt(1.0 - explained / ROWS)
    sizes = {f"k1_{k}{k}": Quantity(1e-7, 1e-8, "rad/(N*m)") for k in range(1, 5)}
    step = some.growth[0]
    name = Name("link_compliance", {"link": 1})
    few = replace(step, residual=left, model_std=np.ones(2), effects=((name, sizes),), gained=4)
    whole = replace(step, residual=less, model_std=np.ones(16), effects=())
    narrow = replace(
        some,
        verdict="named",
        growth=(replace(step, model_std=np.ones(2)), few),
        rms=Rms(2.0, 1.0, 2.1, 1.0, 0.9),
    )
    wide = replace(some, growth=(whole,), rms=Rms(1.0, 1.0, held_out, held_out, 0.9))
    assert leaves_less(wide, narrow, np.zeros(ROWS, dtype=np.intp)) is better
