"""What is told of the smallest size that is seen, held against the search's own scores of simulated data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from symstiff.calibration.experiment.situation import look
from symstiff.calibration.tables.measurements import measurements
from symstiff.discrepancy.bridge.candidates import scales_of
from symstiff.discrepancy.findings.finding import Task
from symstiff.discrepancy.statistics.evidence import evidence
from symstiff.discrepancy.statistics.null import critical, null, simulated_scores
from symstiff.discrepancy.statistics.power import visible
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.workflow import diagnose
from symstiff.robot import load
from symstiff.symbolic.terms import actuated_joint
from tests.blind.generate import Options, case
from tests.test_discrepancy_engine import arm, measured

DRAWS = 120


@pytest.mark.parametrize(("poses", "seed"), [(12, 1), (24, 2)])
def test_effects_of_the_size_that_is_told_are_seen_in_most_of_the_cases(poses: int, seed: int) -> None:
    a = arm(poses)
    ready = prepare(measured(a.problem, 0.0, seed), a.candidates)
    scan, bank = ready.scan, ready.bank
    named = [c for c in range(len(bank.candidates)) if not bank.generic[c]]
    threshold = critical(null(scan, 400, 1).named, 0.025)
    entries = [int(evidence(scan).best_entry[c]) for c in named]
    noise = np.random.default_rng(5).standard_normal((a.problem.rows, DRAWS))
    noise = noise * np.sqrt(scan.best.rss / scan.freedom)
    seen = []
    for c, e, found in zip(named, entries, visible(scan, entries, threshold), strict=True):
        for k, size in enumerate(found.sizes):
            if np.isfinite(size):
                column = int(bank.start[e]) + k
                signal = bank.columns[:, column] * bank.scale[column] * size / scan.noise.spread
                seen.append(np.mean(simulated_scores(scan, noise + signal[:, None])[c] > threshold))
                half = simulated_scores(scan, noise + 0.5 * signal[:, None])[c] > threshold
                assert np.mean(half) < 0.45
    assert len(seen) >= 10
    assert np.mean(seen) == pytest.approx(0.8, abs=0.12)
    assert min(seen) > 0.5


def test_what_the_model_holds_is_never_seen() -> None:
    a = arm(12)
    problem = measured(a.problem, 0.0, 1)
    ready = prepare(problem, a.candidates)
    entry = int(ready.bank.first_entry[0])
    inside = ready.bank.columns[:, ready.bank.slice(entry)]
    ready = prepare(replace(problem, A=np.hstack([problem.A, inside])), a.candidates)
    assert np.all(np.isinf(visible(ready.scan, [entry], 0.0)[0].sizes))


@pytest.mark.slow
def test_a_smallest_size_is_told_that_a_robot_can_have() -> None:
    """In the likeliest shape of a gap the assumed arm may be so heavy that no load crosses it."""
    hidden = case(0, Options(seed=77, classes=("nothing",), shares=(1.0,), poses=(15,), markers=(1,)))
    found = diagnose(Task(hidden.model.robot, hidden.table)).last.candidates
    gaps = [c for c in found if c.effect == "backlash" and c.testable]
    assert len(gaps) > 2
    for c in gaps:
        assert all(size.value < 0.1 for size in c.smallest_detectable.values()), c.where


def test_a_load_that_is_rounding_scales_no_shape() -> None:
    """Forces at the tool's point on the last axis do not turn it."""
    rng = np.random.default_rng(0)
    forces = np.hstack([rng.uniform(-50, 50, (25, 3)), np.zeros((25, 3))])
    view = look(load("franka_panda"), measurements(rng.uniform(-1, 1, (25, 7)), forces))
    load_of = scales_of(view).load
    assert 0.0 < np.abs(view.tau[:, view.index[actuated_joint(7)]]).max() < 1e-9
    assert load_of[actuated_joint(7)] == 0.0 < load_of[actuated_joint(2)]
