"""The same plan to the bit on one process, on several, on a Dask cluster; a cluster that is none is one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from symstiff.calibration.planning import (
    Measurement,
    Space,
    map_blocks,
    workspace_map,
)
from symstiff.calibration.planning.candidates import Evaluator, draw, evaluate
from symstiff.errors import UserError
from tests.test_planning import DOWN, FORCES, THREE, THREE_AXES, gram_deflection, small_plan


def slow_square(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return x @ x.T @ x + y


def test_two_processes_give_the_same_bits_as_one():
    rng = np.random.default_rng(0)
    blocks = [(rng.normal(size=(150, 150)), rng.normal(size=(150, 150))) for _ in range(5)]
    seen: list[float] = []
    alone = map_blocks(slow_square, blocks)
    shared = map_blocks(slow_square, blocks, workers=2, progress=lambda _, done: seen.append(done))
    assert all(np.array_equal(a, b) for a, b in zip(alone, shared, strict=True))
    assert seen == [0.2, 0.4, 0.6, 0.8, 1.0]


@pytest.mark.slow
def test_a_local_cluster_of_two_workers_gives_the_same_bits_as_this_process():
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    space = Space(THREE, FORCES)
    evaluator = Evaluator(THREE_AXES, THREE, Measurement())
    candidates = draw(space, 5000, 0)
    alone = evaluate(evaluator, candidates)
    flat = workspace_map(gram_deflection, THREE, DOWN, (2, 3), (60, 50))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        assert np.array_equal(evaluate(evaluator, candidates, cluster=address), alone)
        mapped = workspace_map(gram_deflection, THREE, DOWN, (2, 3), (60, 50), cluster=address)
        plan = small_plan(search={"cluster": address})
    assert np.array_equal(mapped.deflection, flat.deflection)
    assert np.array_equal(plan.q, small_plan().q)


def test_a_cluster_that_does_not_answer_is_one_line(monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("distributed", reason="Dask is not installed")
    monkeypatch.setattr("symstiff.calibration.planning.parallel._SECONDS_TO_CONNECT", 1)
    with pytest.raises(UserError, match="no Dask scheduler answers"):
        map_blocks(slow_square, [(np.eye(2), np.eye(2))], cluster="tcp://127.0.0.1:9")


def test_a_cluster_whose_address_is_none_leaves_no_traceback_behind(tmp_path: Path):
    pytest.importorskip("distributed", reason="Dask is not installed")
    command = ("plan", "planar2r", "--poses", "3", "--cluster", "foo", "-o", str(tmp_path / "x.csv"))
    done = subprocess.run(
        [sys.executable, "-m", "symstiff", *command], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert [line.startswith("symstiff: --cluster foo: no Dask") for line in done.stderr.splitlines()] == [
        True
    ]


def test_without_dask_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(UserError, match=r"pip install symstiff\[dask\]"):
        map_blocks(slow_square, [(np.eye(2), np.eye(2))], cluster="tcp://localhost:8786")
