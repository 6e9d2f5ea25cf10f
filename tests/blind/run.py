"""Runs the workflow on tables alone, and others' ways on the same data; scores, prints, keeps JSON."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from symstiff.calibration.fits.decomposition import column_space
from symstiff.discrepancy.bridge.assemble import Assembly, assemble
from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.findings.result import Found
from symstiff.discrepancy.problem import Problem
from symstiff.discrepancy.search.verdict import AMBIGUOUS, NAMED, NOTHING
from symstiff.discrepancy.statistics.prepare import prepare
from symstiff.discrepancy.workflow import diagnose
from symstiff.threads import one_thread
from tests.blind.apart import apart, limit
from tests.blind.baselines import aic, bic, cross_validation, lasso
from tests.blind.generate import Case, Options, case
from tests.blind.score import bars, outcome, points, same, share

BASELINES = ("BIC", "AIC", "lasso", "cross-validation")


def benchmark(
    numbers: Sequence[int], options: Options, jobs: int = 1, others: bool = True,
    tell: Callable[[str], None] = lambda line: None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Diagnose every case; the same numbers and options give the same results."""
    work = partial(one, options=options, others=others)
    rows = []
    if jobs == 1:
        found = map(work, numbers)
        for row in found:
            rows.append(row)
            tell(line(row))
        return rows
    with ProcessPoolExecutor(jobs) as pool:
        for row in pool.map(work, numbers):
            rows.append(row)
            tell(line(row))
    return rows


def one(number: int, options: Options, others: bool = True) -> dict[str, Any]:
    """One case: generate, diagnose the table, score."""
    with one_thread():
        return _one(number, options, others)


def _one(number: int, options: Options, others: bool) -> dict[str, Any]:
    hidden = case(number, options)
    start = time.perf_counter()
    finding = blind(hidden)
    seconds = time.perf_counter() - start
    assembly = assemble(hidden.model, hidden.table)
    # groups are of links that grow: data tell apart those that bend
    bending = any(s.startswith("bending") for s in hidden.label.story)
    groups = {c.key: c.group for c in assembly.candidates if c.group and not bending}
    label = hidden.label
    sets = _sets(finding, hidden)
    verdict = NOTHING if finding.verdict in (NAMED, AMBIGUOUS) and not any(sets) else finding.verdict
    row: dict[str, Any] = {
        "number": number, "kind": label.kind, "robot": label.robot, "story": list(label.story),
        "truth": [list(t) for t in label.truth], "wanted": label.wanted,
        "noncentrality": list(label.noncentrality), "geometry": label.geometry, "design": label.design,
        "stated": label.stated, "verdict": verdict, "reason": finding.reason,
        "named": [[[e, dict(w)] for e, w in s] for s in sets],
        "outcome": outcome(verdict, sets, label.truth, groups),
        "spoke": verdict not in (NOTHING, "untestable"),
        "noticed": finding.first.noise.misstated,
        "settling": [joint.joint for joint in finding.last.noise.settling],
        "confidences": _confidences(finding, hidden, groups),
        "p_values": [e.p_value for e in finding.named], "rms": asdict(finding.rms),
        "again": finding.last.held_out.again if finding.last.held_out is not None else None,
        "closure": _closure(hidden, assembly, finding), "seconds": seconds,
        "apart": apart(hidden, assembly, groups), "limit": limit(hidden, assembly, groups),
        "needed": _needed(finding, label.truth, groups),
    }  # fmt: skip
    if others:
        row["others"] = _others(assembly, label.truth, groups)
    return row


def blind(hidden: Case) -> Finding:
    """The whole workflow, which sees the table, the robot and the start model."""
    if not any("left out" in s for s in hidden.label.story) or hidden.label.kind == "untestable":
        return diagnose(Task(hidden.model.robot, hidden.table))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "start.toml"
        hidden.model.save(path)
        return diagnose(Task(hidden.model.robot, hidden.table, str(path)))


def _sets(finding: Finding, hidden: Case) -> list[list[tuple[str, Any]]]:
    """The admissible sets, without frames that are off as a nuisance."""
    numbers = sorted({e.set_number for e in finding.effects})
    found = [(e.set_number, (e.effect, e.where)) for e in finding.effects if not _nuisance(e, hidden)]
    return [[name for k, name in found if k == n] for n in numbers]


def _nuisance(effect: Found, hidden: Case) -> bool:
    return any((effect.effect, effect.where) == (e.effect, e.where) for e in hidden.model.effects)


def _confidences(finding: Finding, hidden: Case, groups: Any) -> list[tuple[float, bool]]:
    if finding.verdict != NAMED:
        return []
    truth = hidden.label.truth
    return [
        (float(e.confidence), any(same((e.effect, e.where), t, groups) for t in truth))
        for e in finding.named
        if not _nuisance(e, hidden)
    ]


def _needed(finding: Finding, truth: Any, groups: Any) -> float | None:
    """Noncentrality from which, by the diagnosis's own account, the hidden effect would be seen in 80 % of cases."""
    found = [
        c.needed
        for c in finding.first.candidates
        if c.testable and any(same((c.effect, c.where), t, groups) for t in truth)
    ]
    return min(found, default=None)


def _left(problem: Problem, *further: np.ndarray, of: np.ndarray | None = None) -> float:
    """Standard deviation of the data, or of a signal, after the model and further columns, freedom counted."""
    basis = column_space(np.column_stack([problem.A, *further]), 1e-8)
    y = problem.y if of is None else of
    residual = y - basis @ (basis.T @ y)
    return float(np.sqrt(residual @ residual / (problem.rows - basis.shape[1])))


def _closure(hidden: Case, assembly: Assembly, finding: Finding) -> float | None:
    """How much of the gap the named set closes, as a share of what knowing the true shape would close."""
    if not hidden.label.truth or max(hidden.label.noncentrality, default=0.0) < 20:
        return None
    problem, view = assembly.problem, assembly.situation.view
    signal = hidden.signal[view.state, view.component]
    if not np.any(signal):
        return None
    before, best = _left(problem), _left(problem, signal)
    if before - best < 0.02 * before:
        return None
    columns = []
    for effect in finding.named:
        found = [
            c for c in assembly.candidates
            if not c.unavailable and same((c.effect, c.where), (effect.effect, effect.where), {})
            and dict(effect.shape) in [dict(s) for s in c.shapes]
        ]  # fmt: skip
        if not found:
            return None
        columns.append(found[0].columns(effect.shape))
    return (before - _left(problem, *columns)) / (before - best)


def _others(assembly: Assembly, truth: Any, groups: Any) -> dict[str, Any]:
    problem = assembly.problem
    ready = prepare(problem, assembly.candidates)
    scan = ready.scan
    ways: dict[str, Callable[[], tuple[int, ...]]] = {
        "BIC": lambda: bic(scan), "AIC": lambda: aic(scan), "lasso": lambda: lasso(scan, problem),
        "cross-validation": lambda: cross_validation(scan, problem),
    }  # fmt: skip
    found = {}
    for name, way in ways.items():
        chosen = [ready.bank.candidates[k] for k in way()]
        named = [(c.effect, c.where) for c in chosen]
        right = bool(truth) and len(named) == len(truth)
        right = right and all(any(same(t, e, groups) for e in named) for t in truth)
        found[name] = {"named": len(named), "right": right}
    return found


def line(row: dict[str, Any]) -> str:
    """One case in one line."""
    names = " | ".join(" + ".join(f"{e}@{w}" for e, w in s) for s in row["named"][:2])
    truth = " + ".join(f"{e}@{w}" for e, w in row["truth"]) or "-"
    d = row["design"]
    return (
        f"{row['number']:4d} {row['kind']:10s} {row['robot'][:8]:8s} lam {row['wanted']:5.0f} dof {d['freedom']:4d} "
        f"{row['outcome']:6s} {row['verdict']:18s} {row['seconds']:5.1f} s  "
        f"{'/'.join(row['story'])}: {truth} -> {names}"
    )


def report(rows: Sequence[dict[str, Any]]) -> str:
    """The table of bars, and of others on the same data."""
    text = [f"{'':58s} {'n':>4s} {'share':>7s}   95 % interval"]
    for name, b in bars(rows).items():
        value = "-" if b["share"] is None else f"{b['share']:.3f}"
        text.append(f"{name:58s} {b['n']:4d} {value:>7s}   {b['low']:.3f} - {b['high']:.3f}")
    if seconds := [r["seconds"] for r in rows]:
        text.append(f"\nseconds a diagnosis: median {np.median(seconds):.1f}, most {max(seconds):.1f}")
    rows = [r for r in rows if "others" in r]
    if rows:
        text.append(
            f"\n{'on the same data':30s} {'false alarms':>14s} {'right name':>12s} {'named outside':>14s}"
        )
        strong = [r for r in rows if r["kind"] == "one" and r["wanted"] >= 25]
        for way in BASELINES:
            text.append(_compared(way, rows, strong, way))
        text.append(_compared("symstiff", rows, strong, None))
    return "\n".join(text)


def _compared(title: str, rows: Sequence[Any], strong: Sequence[Any], way: str | None) -> str:
    def spoke(r: Any) -> float:
        return float(r["spoke"] if way is None else r["others"][way]["named"] > 0)

    def right(r: Any) -> float:
        return points(r) if way is None else float(r["others"][way]["right"])

    def misnamed(r: Any) -> float:
        return float(r["verdict"] in ("named", "ambiguous") if way is None else r["others"][way]["named"] > 0)

    parts = (
        share(rows, lambda r: r["kind"] == "nothing", spoke),
        share(strong, lambda r: True, right),
        share(rows, lambda r: r["kind"] == "outside", misnamed),
    )
    shown = ["-" if p["share"] is None else f"{p['share']:.2f}" for p in parts]
    return f"{title:30s} {shown[0]:>14s} {shown[1]:>12s} {shown[2]:>14s}"


def keep(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Write cases and bars as JSON."""
    path.write_text(json.dumps({"bars": bars(rows), "cases": list(rows)}, indent=1, default=str) + "\n")
