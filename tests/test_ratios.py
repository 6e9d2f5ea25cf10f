"""What a pose's rows share is told as large as it is, not as the nearest size of a grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.noise import scales as noises
from symstiff.discrepancy.noise.sharing import AXES, JOINTS, Sharing, Split
from symstiff.discrepancy.statistics.bank import build
from symstiff.discrepancy.statistics.ratios import with_likeliest
from symstiff.discrepancy.statistics.scan import open_scan
from symstiff.discrepancy.workflow import diagnose, first_assembly
from symstiff.robot import load
from tests.diagnosis_data import ROBOT, measured
from tests.test_assemble import complete


@pytest.mark.parametrize("way", [AXES, JOINTS])
def test_no_size_between_is_likelier(way: str) -> None:
    """Against the likelihood of the scan at many sizes."""
    table = measured(poses=12)
    values = table.values.copy()
    values[:, :3] += 2.4e-5 * np.random.default_rng(3).normal(size=(12, 3))[table.pose]
    problem = first_assembly(complete(ROBOT), replace(table, values=values)).problem
    noise = noises.start(problem, Split())
    told = (Sharing(), *(Sharing(way, r) for r in (0.1, 1.0, 10.0)))
    found = with_likeliest(replace(noise, sharings=told), problem.y, problem.A)
    assert [s.way for s in found.sharings] == [AXES, way, way, way]
    (best,) = (s for s in found.sharings if s not in told)
    many = tuple(Sharing(way, float(r)) for r in np.geomspace(0.1, 10.0, 120))
    scan = open_scan(build(problem, (), ()), replace(noise, sharings=(*many, best)), problem.y, problem.A)
    assert scan.log_likelihood[-1] > scan.log_likelihood[:-1].max() - 0.01


@pytest.mark.slow
@pytest.mark.parametrize("shared", [1.1e-5, 1.5e-5, 2.6e-5, 3.5e-5])
def test_what_is_shared_is_as_large_as_it_was_drawn(shared: float) -> None:
    """Forty poses of twelve readings: both sizes are known to a few per cent."""
    table = measured(poses=40, levels=(0.25, 0.5, 1.0, -1.0))
    draw = np.random.default_rng(5).normal(size=(40, 3))
    values = table.values.copy()
    values[:, :3] += shared * (draw / np.sqrt(np.mean(draw**2)))[table.pose]
    noise = diagnose(Task(load(ROBOT), replace(table, values=values))).first.noise
    assert noise.approach == pytest.approx(shared, rel=0.12)
    assert noise.ratio == pytest.approx(1.0, abs=0.04)
    assert not noise.misstated
