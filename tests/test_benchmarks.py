"""The benchmarks run: every installed engine solves the same task, and the growth is drawn; no time is asserted."""

from __future__ import annotations

import importlib.util
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks import bench_growth, bench_peers, geometry
from tests.benchmarks.case import Case

ENGINES = ("wrenfold", "pinocchio")


@pytest.fixture(scope="module")
def result() -> bench_peers.Result:
    for tool in ("gcc", "g++"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is missing")
    return bench_peers.run("kuka_kr270", repeat=1)


def test_all_engines_agree_on_the_kr_270_before_they_are_timed(result: bench_peers.Result) -> None:
    assert result.parameters == 56
    names = {line.name for line in result.lines}
    assert {"symstiff", "CasADi A·π + cse", "CasADi ΣJ·k·JᵀW + cse", "CasADi geometric + cse"} <= names
    assert all(line.error < 1e-10 for line in result.lines)
    assert all(line.least_ns > 0 for line in result.lines)


def test_operations_of_the_peers_are_those_of_their_instruction_lists(result: bench_peers.Result) -> None:
    by_name = {(line.quantity, line.name): line for line in result.lines}
    assert by_name["deflection", "CasADi A·π + cse"].total <= 1175
    assert by_name["deflection", "CasADi ΣJ·k·JᵀW + cse"].total <= 864
    assert by_name["deflection", "symstiff"].total <= 440
    assert by_name["observation", "symstiff"].total <= 640


@pytest.mark.parametrize("engine", ENGINES)
def test_a_peer_takes_part_where_it_is_installed(result: bench_peers.Result, engine: str) -> None:
    if importlib.util.find_spec(engine) is None:
        assert engine in result.missing
        pytest.skip(f"{engine} is not installed: left out of the comparison")
    assert any(line.name.lower().startswith(engine) for line in result.lines)


def test_the_table_shows_every_engine_and_every_promise(result: bench_peers.Result) -> None:
    text = bench_peers.table(result)
    assert all(line.name in text for line in result.lines)
    assert text.count("wanted") == len(result.targets) == 3


def test_a_wrong_value_is_noticed() -> None:
    reference = np.random.default_rng(0).normal(size=(5, 6, 4))
    wrong = reference.copy()
    wrong[2, 4, 1] += 1e-6
    assert bench_peers.error(reference, reference) == 0
    assert bench_peers.error(wrong, reference) > bench_peers.AGREEMENT
    wrong[2, 4, 1] = np.nan
    assert not bench_peers.error(wrong, reference) < bench_peers.AGREEMENT


def test_casadi_operations_leave_out_inputs_outputs_and_constants() -> None:
    import casadi as ca

    from tests.benchmarks.peers_casadi import operations

    x = ca.SX.sym("x", 2)
    counts = operations(ca.Function("f", [x], [-(3 * x[0] + ca.sin(x[1])), x[1] ** 2]))
    assert counts == {"add": 1, "mul": 2, "neg": 1, "trig": 1, "other": 0}


@pytest.mark.parametrize("robot", ["puma560", "scara"])
def test_the_peers_formulas_hold_on_other_robots(robot: str) -> None:
    casadi = pytest.importorskip("casadi")
    case = Case.of(robot)
    from symstiff.model import StiffnessModel
    from tests.benchmarks import peers_casadi

    model = StiffnessModel(case.robot, case.parameters)
    q, w = case.inputs[:3, : case.dof], case.inputs[:3, case.dof :]
    own = model.deflection(q, w, values=dict(zip(model.parameters, case.values, strict=True)))
    symbols = [casadi.SX.sym("q", case.dof), casadi.SX.sym("w", 6), casadi.SX.sym("k", len(case.entries))]
    q_, w_, k = symbols
    graphs = [peers_casadi.total(case, q_, w_, k, style) for style in geometry.STYLES]
    graphs += [
        peers_casadi.product(case, q_, w_, k, geometry.Style()),
        peers_casadi.derivatives(case, q_, w_, k)[0],
    ]
    for graph in graphs:
        function = casadi.Function("f", symbols, [graph])
        values = [function(a, b, case.values).full().ravel() for a, b in zip(q, w, strict=True)]
        assert bench_peers.error(np.array(values), own) < bench_peers.AGREEMENT


@pytest.mark.slow
def test_growth_is_measured_and_drawn_the_same_way_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pictures = [tmp_path / "growth.svg", tmp_path / "again.svg"]
    arguments = [
        "bench_growth",
        "--joints",
        "2",
        "3",
        "-o",
        str(pictures[0]),
        "--json",
        str(tmp_path / "g.json"),
    ]
    monkeypatch.setattr(sys, "argv", arguments)
    bench_growth.main()
    found = [bench_growth.Growth(**g) for g in json.loads((tmp_path / "g.json").read_text())]
    assert [g.joints for g in found] == [2, 3]
    assert found[0].kept < found[1].kept
    assert capsys.readouterr().out.strip() == bench_growth.table(found)
    bench_growth.plot(found, pictures[1])
    assert pictures[0].read_bytes() == pictures[1].read_bytes()
