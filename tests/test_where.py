"""The parts of a table in which the residual is told: by hand, and on the page."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from symstiff.discrepancy.findings.finding import Finding, Task
from symstiff.discrepancy.workflow import diagnose
from symstiff.report.html import render
from symstiff.report.where import parts
from symstiff.robot import load
from tests.diagnosis_data import ROBOT, measured


@cache
def found() -> Finding:
    """Of twelve poses, told in the order in which they were read."""
    table = measured()
    return diagnose(Task(load(ROBOT), replace(table, time=np.arange(len(table), dtype=float)), "joints"))


def by_hand(rows: np.ndarray, component: int | None = None) -> tuple[float, float]:
    """Root mean square of what some rows of the table leave over the noise, before and after."""
    finding = found()
    view, spread = finding.assembly.situation.view, finding.last.noise.by_component()
    own = rows[view.state] & (True if component is None else view.component == component)
    sizes = [(s.residual / spread[view.component])[own] for s in (finding.steps[0], finding.steps[-1])]
    before, after = (float(np.sqrt(np.mean(z**2))) for z in sizes)
    return before, after


def test_every_part_holds_its_readings() -> None:
    table, told = found().table, {p.name: p for p in parts(found())}
    size = np.linalg.norm(table.w[:, :3], axis=1)
    third = np.argsort(table.time) < len(table) / 3
    middle = (table.q[:, 1].max() + table.q[:, 1].min()) / 2
    loads = {name for name in told if name.startswith("loads of")}
    assert len(loads) == len(np.unique(np.round(size, 3)))
    wanted = {
        "axis y": by_hand(np.ones(len(table), dtype=bool), 1),
        "marker p2": by_hand(table.point == table.points.index("p2")),
        f"loads of {size.max():.4g} N": by_hand(np.isclose(size, size.max())),
        next(name for name in told if name.startswith("time, first")): by_hand(third),
        next(name for name in told if name.startswith("q2 below") and name.endswith(" rad")): by_hand(
            table.q[:, 1] < middle
        ),
    }
    for name, sizes in wanted.items():
        assert (told[name].before, told[name].after) == pytest.approx(sizes, rel=1e-9), name
    halves = [p.readings for name, p in told.items() if name.startswith("q2 ")]
    assert sum(halves) == int(table.measured.sum())


def test_the_page_shows_them() -> None:
    page = render(found(), {"code": {"folder": False, "text": "", "compiled": False, "error": None}}, [])
    section = page[page.index("By axis, marker, load, time") :]
    for part in parts(found()):
        assert f"<td>{part.name}</td>" in section
