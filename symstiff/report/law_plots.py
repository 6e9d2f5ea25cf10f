"""Pictures of laws: what the data ask of a virtual joint, against its load and angle, and the law through it."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy as sp

from symstiff.arrays import Array
from symstiff.calibration.fits.decomposition import unit_columns
from symstiff.calibration.tables.measurements import COMPONENTS
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.result import Found
from symstiff.discrepancy.search.localise import back_project
from symstiff.display import sentence_case
from symstiff.effects.places import named
from symstiff.report.plots import AFTER, LAW, Picture, drawing
from symstiff.report.tables import rotates, shift, weights
from symstiff.report.unnamed import law_text
from symstiff.report.whole_load import WholeLoad, whole_load
from symstiff.symbolic.algebras import NumpyAlgebra
from symstiff.symbolic.program import walk
from symstiff.symbolic.terms import q, tau

_GRID = 240
"""Points of a curve."""
_LOOSE, _HEAVY = 6.0, 0.1
"""Standard deviation, over the median one, from which a pose hardly moves with a joint and says nothing of it; share of
the largest load from which a deflection is shown over its load."""
_LONG = 2 * 3600.0
"""Session [s] from which its time is shown in hours."""


@dataclass(frozen=True, eq=False)
class _Law:
    """A law at one virtual joint: its deflections (M,), the joint whose load drives it, and its formula."""

    joint: int
    driver: int
    values: Array
    formula: sp.Expr | None = None
    angle: int = 0
    """Number of the joint variable that it depends on beside its load; 0: the joint's own."""
    among: int = 1
    """Virtual joints that the effect moves."""


@dataclass(frozen=True, eq=False)
class _Points:
    """Deflections of one virtual joint by pose and load case: as the data ask for them, and by the law."""

    delta: Array
    deviation: Array
    tau: Array
    angles: Array
    time: Array | None
    law: Array


def draw_law(finding: Finding, effect: Found) -> Picture | None:
    """Deflection of the effect's virtual joint that the data ask for, against load and angle, with its law.

    What the rest of the model explains is taken away: points are the residual after growth plus what the effect adds,
    projected back to the virtual joint.
    """
    added = finding.added(effect)
    together = sum((finding.added(e) for e in _beside(finding, effect)), np.zeros(len(added)))
    partial = left_with(finding, together) + added
    law = _strongest(finding, effect)
    if law is None:
        return _draw_added(finding, effect, added, partial)
    points = _points(finding, law, partial)
    if points is None:
        return None
    name = finding.assembly.problem.virtual_joints[law.joint]
    most = ", which it moves most," if law.among > 1 else ""
    robot = finding.assembly.situation.view.robot
    assert law.formula is not None
    whole = whole_load(robot, effect, law.formula, points.tau, points.angles)
    told = "" if whole is None else " Against weight and load, what the law gives under the weight is added."
    caption = (
        f"{_title(effect)}: deflection of {name}{most} that the data ask for (points, ± one standard deviation; "
        f"the rest of the model taken away), and the fitted law (red).{told}{_of_whole_load(finding, effect)}"
    )
    name = f"law {effect.set_number} {effect.effect} {effect.where}"
    return Picture(_draw(finding, law, points, name, whole=whole), caption)


def _of_whole_load(finding: Finding, effect: Found) -> str:
    """A sentence where the law is shown over another load than the written model takes: that counts weight itself."""
    written = (e for e in finding.model.effects if (e.effect, e.where) == (effect.effect, effect.where))
    if all(e.shape == effect.shape for e in written):
        return ""
    return (
        " τ is the joint's whole load, the links' weight in it, as the positions show it; model and code add the "
        "weight of the robot file's masses to the load at the tool, and give what the load adds."
    )


def draw_unnamed(finding: Finding) -> Picture | None:
    """Where nothing of the catalogue fits: back-projection at the accused virtual joint, best smooth law.

    Where no virtual joint is accused it is the one that would explain most, of those that bear a load if any does.
    """
    found, place = finding.last.law, finding.last.localisation
    problem = finding.assembly.problem
    if place is None or problem.J is None or problem.tau is None:
        return None
    name = found.virtual_joint if found is not None else place.accused
    if name not in problem.virtual_joints:
        likely = [b.virtual_joint for b in place.back_projections]
        bearing = [n for n in likely if problem.tau[:, problem.virtual_joints.index(n)].any()]
        if not likely:
            return None
        name = (bearing or likely)[0]
    v = problem.virtual_joints.index(name)
    values = found.values if found is not None else np.full(problem.rows, np.nan)
    signal = problem.J[:, v] * values if found is not None else np.zeros(problem.rows)
    angle = re.search(r"\bq(\d+)", "" if found is None else found.expression)
    law = _Law(v, v, values, angle=int(angle.group(1)) if angle else 0)
    points = _points(finding, law, left_with(finding, signal) + signal)
    if points is None:
        return None
    caption = (
        f"Deflection of {name} that the data ask for beside the model (points, ± one standard deviation)"
    )
    if found is None:
        caption += ", which could bear most of it: no law was found there"
    if found is not None:
        caption += f", and the best smooth law (red): {shift(finding, name)} = {law_text(finding, found)}"
    return Picture(_draw(finding, law, points, "unnamed", ratio=True), caption + ".")


def _title(effect: Found) -> str:
    return sentence_case(named(effect.effect, effect.where))


def _beside(finding: Finding, effect: Found) -> list[Found]:
    """The members of an effect's set that the model of the last diagnosis does not hold yet."""
    has = set(finding.assembly.names)
    return [
        e
        for e in (*finding.effects, *finding.alternatives)
        if e.set_number == effect.set_number and not set(e.parameters) <= has
    ]


def left_with(finding: Finding, signal: Array) -> Array:
    """(M,) what is left of the data once a signal has joined the model, all coefficients fitted again."""
    problem, weight = finding.assembly.problem, 1.0 / weights(finding)
    before = finding.last.growth[0].residual if finding.last.growth else np.zeros(problem.rows)
    X, length = unit_columns(problem.A * weight[:, None])
    absorbed = np.linalg.lstsq(X, signal * weight, rcond=1e-9)[0] / length
    return np.asarray(before - signal + problem.A @ absorbed)


def _strongest(finding: Finding, effect: Found) -> _Law | None:
    """The virtual joint that an effect moves most, and its deflection by the law."""
    view, problem = finding.assembly.situation.view, finding.assembly.problem
    laws: dict[int, sp.Expr] = {}
    for term in effect.instance.realise(view.robot).terms:
        if term.at.kind in ("link", "joint") and term.parameter in effect.parameters:
            v = view.index[term.at]
            number = sp.Float(effect.parameters[term.parameter].value)
            laws[v] = laws.get(v, sp.S.Zero) + number * term.factor
    best: tuple[float, _Law] | None = None
    loads = {tau(v): k for k, v in enumerate(view.joints)}
    for v, formula in laws.items():
        values = view.factor(formula)[view.state]
        assert problem.J is not None
        size = float(np.linalg.norm(problem.J[:, v] * values))
        drivers = sorted(loads[s] for s in formula.free_symbols if s in loads)
        driver = v if v in drivers or not drivers else drivers[0]
        if best is None or size > best[0]:
            best = size, _Law(v, driver, values, formula, among=len(laws))
    return None if best is None or best[0] == 0 else best[1]


def _points(finding: Finding, law: _Law, partial: Array) -> _Points | None:
    problem = finding.assembly.problem
    scale = weights(finding)
    seen = back_project(problem, partial / scale, scale, law.joint)
    if seen is None or problem.q is None or problem.tau is None:
        return None
    cells = np.column_stack([seen.pose, seen.case])
    first = np.array([np.flatnonzero((problem.pose == p) & (problem.case == c))[0] for p, c in cells])
    good = np.isfinite(seen.deviation)
    tight = np.median(seen.deviation[good]) if good.any() else np.inf
    good &= seen.deviation < _LOOSE * tight
    rows = first[good]
    time = None if problem.time is None or not np.ptp(problem.time) else problem.time[rows]
    return _Points(
        seen.delta[good], seen.deviation[good], problem.tau[rows, law.driver], problem.q[rows], time,
        law.values[rows],
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Panel:
    """One pair of axes: x, what stands on y, and the law as a curve where it depends on x alone."""

    x: Array
    label: str
    y: Array
    deviation: Array
    law: Array
    curve: tuple[Array, Array] | None = None
    y_label: str = ""


def _draw(
    finding: Finding,
    law: _Law,
    points: _Points,
    name: str,
    ratio: bool = False,
    whole: WholeLoad | None = None,
) -> str:
    view, names = finding.assembly.situation.view, finding.assembly.problem.virtual_joints
    unit, factor = ("mrad", 1e3) if rotates(finding, names[law.joint]) else ("µm", 1e6)
    moment, moved = "N·m" if rotates(finding, names[law.driver]) else "N", shift(finding, names[law.joint])
    at = view.joints[law.driver]
    j = law.angle or (at.body if at.kind == "joint" else min(max(at.body, 1), view.robot.dof))
    turns = not view.robot.joint[j - 1].prismatic
    angle = points.angles[:, j - 1]
    scale = np.degrees(1.0) if turns else 1.0
    delta = (factor * points.delta, factor * points.deviation, factor * points.law)
    by_load = _curve(law, tau(at), points.tau, factor)
    by_angle = _curve(law, q(j), angle, factor)
    if by_angle is not None:
        by_angle = scale * by_angle[0], by_angle[1]
    q_label = f"q{j} [{'°' if turns else 'm'}]"
    of_load = _Panel(points.tau, f"load τ on {names[law.driver]} [{moment}]", *delta, by_load)
    of_load = of_load if whole is None else _whole(of_load, whole, factor)
    carries = bool(points.tau.any()) or not len(angle)
    panels = [*([of_load] if carries else []), _Panel(scale * angle, q_label, *delta, by_angle)]
    per_load = _per_load(law, tau(at), q(j), angle, factor)
    if per_load is not None:
        per_load = scale * per_load[0], 1e3 * per_load[1]
    if carries and (ratio or per_load is not None) and len(angle):
        heavy = np.abs(points.tau) > _HEAVY * np.abs(points.tau).max()
        t = points.tau[heavy]
        y, deviation, line = (1e3 * d[heavy] / x for d, x in zip(delta, (t, np.abs(t), t), strict=True))
        label = f"{moved}/τ [{'µrad' if unit == 'mrad' else 'nm'}/({moment})]"
        panels.append(_Panel(scale * angle[heavy], q_label, y, deviation, line, per_load, label))
    if points.time is not None:
        long = np.ptp(points.time) > _LONG if len(points.time) else False
        panels.append(_Panel(points.time / (3600 if long else 1), f"time [{'h' if long else 's'}]", *delta))
    with drawing(name, 9.0, 3.0 if len(panels) < 4 else 2.6) as (figure, out):
        grid = figure.subplots(1, len(panels), squeeze=False)[0]
        for k, (axes, panel) in enumerate(zip(grid, panels, strict=True)):
            _paint(axes, panel, panel.y_label or ("" if k else f"{moved} of {names[law.joint]} [{unit}]"))
        grid[0].legend(fontsize=8)
    return out[0]


def _whole(panel: _Panel, found: WholeLoad, factor: float) -> _Panel:
    """The panel of the load with the links' weight in it."""
    start, (grid, along) = factor * found.start, found.curve
    return replace(
        panel, x=panel.x + found.weight, label=panel.label.replace("load τ", "weight and load"), y=panel.y + start,
        law=panel.law + start, curve=(grid, factor * along),
    )  # fmt: skip


def _curve(law: _Law, symbol: sp.Symbol, x: Array, factor: float) -> tuple[Array, Array] | None:
    """The law over the range of x, where it depends on nothing else."""
    if law.formula is None or not len(x) or law.formula.free_symbols != {symbol}:
        return None
    grid = np.linspace(x.min(), x.max(), _GRID)
    return grid, factor * np.asarray(walk(law.formula, {symbol: grid}, NumpyAlgebra()), dtype=float)


def _per_load(
    law: _Law, load: sp.Symbol, angle: sp.Symbol, q: Array, factor: float
) -> tuple[Array, Array] | None:
    """Δθ/τ over the angle, of a law that is proportional to its load by a factor of that angle alone."""
    if law.formula is None or not len(q) or law.formula.free_symbols != {load, angle}:
        return None
    grid = np.linspace(q.min(), q.max(), _GRID)
    one, two = (
        np.asarray(walk(law.formula, {load: t * np.ones(_GRID), angle: grid}, NumpyAlgebra()), dtype=float)
        for t in (1.0, 2.0)
    )
    return (grid, factor * one) if np.allclose(two, 2 * one, rtol=1e-9, atol=0) else None


def _paint(axes: Any, panel: _Panel, y_label: str) -> None:
    axes.axhline(0, color="#bbb", linewidth=0.8)
    axes.errorbar(
        panel.x, panel.y, panel.deviation, fmt="o", ms=3.2, color=AFTER, ecolor="#b9cfd8", elinewidth=0.9,
        label="data", zorder=2,
    )  # fmt: skip
    if panel.curve is not None:
        axes.plot(*panel.curve, color=LAW, linewidth=1.4, label="fitted law", zorder=3)
    elif np.isfinite(panel.law).any():
        axes.plot(panel.x, panel.law, "_", color=LAW, ms=8, mew=1.5, label="fitted law", zorder=3)
    axes.locator_params(axis="x", nbins=6)
    axes.set_xlabel(panel.label)
    if y_label:
        axes.set_ylabel(y_label)


def _draw_added(finding: Finding, effect: Found, added: Array, there: Array) -> Picture:
    """For effects that are no law of a virtual joint: what they add to every row, against what is there."""
    problem = finding.assembly.problem
    with drawing(f"added {effect.set_number} {named(effect.effect, effect.where)}", 9.0, 2.6) as (
        figure,
        out,
    ):
        grid = figure.subplots(1, 3, sharey=True)
        for axes, axis in zip(grid, range(3), strict=True):
            rows = problem.axis == axis
            axes.plot(1e3 * added[rows], 1e3 * there[rows], "o", ms=3.2, color=AFTER)
            if rows.any():
                ends = np.array([added[rows].min(), added[rows].max()]) * 1e3
                axes.plot(ends, ends, color=LAW, linewidth=1.4)
            axes.set(xlabel=f"added by the effect, {COMPONENTS[axis]} [mm]")
            axes.locator_params(axis="x", nbins=5)
        grid[0].set_ylabel("asked for by the data [mm]")
    return Picture(
        out[0],
        f"{_title(effect)}: what it adds to a row, and what the data ask for there (the rest of the model taken away); "
        "red: equal.",
    )
