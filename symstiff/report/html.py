"""report.html: one page without any outside resource, for screen and print."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup, escape

from symstiff import __version__
from symstiff.codegen.emit import environment
from symstiff.discrepancy.findings import numbers
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.result import Quantity
from symstiff.discrepancy.laws.speech import law_place
from symstiff.discrepancy.reasons import Why
from symstiff.discrepancy.search.verdict import AMBIGUOUS, INSUFFICIENT, UNEXPLAINED, UNTESTABLE
from symstiff.display import sentence_case, unit_text
from symstiff.effects.places import named
from symstiff.report import candidates, cards, law_plots, naming, plots, sizes, unnamed, where, words
from symstiff.report.code import Line, formulas
from symstiff.report.deciding import NOWHERE, OTHERWISE, decides, load_axes, reached, separation_text
from symstiff.report.tables import StepRow, moved, rotates, shift, step_rows

_MOST_LAWS = 5
_LONG = 26
"""Letters of a name from which it may break."""
_ROOM = 6
"""Decimals of a column at most."""
_CHANGED = 2.0
"""Standard deviations by which a parameter that moved is marked."""
_UNITS = {"positional": "mm", "rotational": "mrad", "x": "mm", "y": "mm", "z": "mm"}
_STARTS = {
    "complete": "the complete model",
    "joints": "the model of compliant joints alone",
    "a model": "a model made before",
}
_SHORT = {"positional": "position", "rotational": "rotation"}
_BOUND = re.compile(r" (?=±)|(?<=±) |(?<=\d) (?=(?:%|mm|mrad|µm|m|rad|kg|N|s|h|K)(?!\w))")
"""Spaces at which a quantity must not break: around its ±, and before its unit."""
_AXES = (
    "Axes of a link are those of its elastic frame: 1 to 3 shift along them, 4 to 6 turn about them, 1 and 4 along the "
    "beam; link 0 is the pedestal, and link i the one behind joint i."
)
_NAMES = {
    r"k\d": "k, the link, _ and two axes: how far the link gives way along or about the first by a load on the second "
    "(axes 1 to 3 are forces and shifts, 4 to 6 moments and turns, 1 and 4 along the beam, link 0 the pedestal).",
    r"c\d": "c and a number: the joint's compliance.",
    r"[kc]\d": "After the reduction one may be a sum, which symstiff inspect prints; a sum may be below zero.",
}
"""What the names of compliances mean, by how they begin."""


def render(finding: Finding, files: dict[str, Any], changes: list[Line]) -> str:
    """The page. ``files`` says what else is in the folder; ``changes`` what the growth changed in the C code."""
    jinja = environment()
    jinja.autoescape = True
    jinja.filters.update(bound=_bound, breakable=_breakable, remark=_remark)
    return str(jinja.get_template("report/report.html.j2").render(_context(finding, files, changes)))


def _context(finding: Finding, files: dict[str, Any], changes: list[Line]) -> dict[str, Any]:
    robot = finding.task.robot
    return {
        "version": __version__,
        "robot": robot.title or robot.name,
        "start": _STARTS.get(finding.task.origin, f"the model {finding.task.origin}"),
        "headline": words.headline(finding),
        "sentence": words.sentence(finding, files.get("decide")),
        "verdict": finding.verdict if finding.testable else UNTESTABLE,
        "remarks": finding.remarks,
        "facts": _facts(finding),
        "effects": words.what(finding),
        "explanations": cards.explanations(finding),
        "alternatives": cards.cards_of(finding, finding.alternatives),
        "steps": _steps(finding),
        "strata": _strata(finding),
        "pictures": _pictures(finding),
        "parts": where.parts(finding) if finding.testable else [],
        "laws": _laws(finding),
        "unnamed": _unnamed(finding),
        "candidates": candidates.candidates(finding),
        "untested": candidates.untested(finding),
        "sensitivity": candidates.sensitivity(finding),
        "moved": _moved(finding),
        "told": finding.as_told is not None,
        "absorbed": finding.grown.absorbed,
        "borne": finding.table.kind == "deflection",
        "changes": changes,
        "files": files,
        "decide": _decide(files.get("decide")),
        "grown": len(finding.steps) > 1,
        "axes": _AXES,
        "names": [t for start, t in _NAMES.items() if any(re.match(start, m.name) for m in moved(finding))],
        "changed": f"{_CHANGED:g}",
        "noise": sizes.noise_lines(finding),
    }


def _bound(text: str) -> str:
    """Text that does not break within a quantity."""
    return _BOUND.sub("\N{NO-BREAK SPACE}", text)


def _breakable(name: str) -> Markup:
    """A name, which may break behind each underscore where it is long."""
    return Markup(str(escape(name)).replace("_", "_<wbr>" if len(name) > _LONG else "_"))


def _remark(text: str) -> str:
    """A remark as a sentence; one that begins with a parameter's name keeps it."""
    return sentence_case(text) if re.match(r"[a-z]+[ :,']", text) else text


def _facts(finding: Finding) -> list[tuple[str, str]]:
    table, problem = finding.table, finding.assembly.problem
    r = finding.rms
    facts = [
        (
            "data",
            f"{problem.poses} pose{'s' * (problem.poses != 1)}, {len(table)} rows, {problem.rows} measured "
            f"values ({table.kind})",
        ),
        ("start model", f"{len(finding.start.model.parameters)} parameters"),
        ("residual, rms per coordinate", _fall(finding, r.before, r.after)),
        ("noise, per degree of freedom", sizes.noise(finding, numbers.decimals_between(r.before, r.after))),
    ]
    held = finding.last.held_out
    if held is not None:
        facts.insert(3, ("on held-out poses", _fall(finding, r.held_out_before, r.held_out_after)))
        if r.closure is not None and math.isfinite(r.closure) and finding.named:
            facts.insert(4, ("gap closed", _closed(r.closure)))
    return facts


def _closed(share: float) -> str:
    """The share of the gap that was closed, in words of the report."""
    below = ": what is left there is less than the noise" if round(100 * share) > 100 else ""
    return f"{100 * share:.0f} %, on held-out poses{below}"


def _fall(finding: Finding, before: float | None, after: float | None) -> str:
    """Before and after; one of them where nothing was added."""
    if len(finding.steps) < 2 or before is None or after is None:
        return sizes.size(before, finding)
    decimals = numbers.decimals_between(before, after)
    return f"{sizes.size(before, finding, decimals)} → {sizes.size(after, finding, decimals)}"


def _decide(record: dict[str, Any] | None) -> dict[str, Any] | None:
    """The deciding poses with their joint variables, and the loads of each."""
    if record is None:
        return None
    loaded, poses = load_axes(record), record["poses"]
    return {
        "joints": [_header(name) for name in (poses[0]["q"] if poses else {})],
        "poses": [
            {
                "name": p["pose"],
                "q": [_minus(f"{x:.1f}" if "[deg]" in n else f"{x:.4f}") for n, x in p["q"].items()],
                "separation": separation_text(p["separation"]),
            }
            for p in poses
        ],
        "axes": [_header(a) for a in loaded],
        "reached": reached(record),
        "decides": decides(record),
        "otherwise": OTHERWISE,
        "nowhere": NOWHERE,
        "loads": [[_minus(f"{w[a]:.4g}") for a in loaded] for w in record["loads"]],
        "branches": record["branches"],
        "points": ", ".join(record["points"]) if record["points"] != ["tcp"] else "",
    }


def _minus(number: str) -> str:
    return number.replace("-", "−")


def _header(column: str) -> str:
    """A column of a table with its unit as one writes it: ``q2 [°]``."""
    return unit_text(column.replace("[deg]", "[°]").replace("[", " ["))


def _steps(finding: Finding) -> dict[str, Any]:
    rows = step_rows(finding)
    axes = list(rows[0].sizes)
    columns = zip(*(_cells(r, axes) for r in rows), strict=True)
    decimals = [max(_decimals(numbers.milli(x / 1e3)) for x in column) for column in columns]
    return {
        "axes": [(_SHORT.get(a, a), _UNITS.get(a, "mrad")) for a in axes],
        "rows": [
            {
                "title": r.title,
                "parameters": r.parameters,
                "cells": [f"{x:.{d}f}" for x, d in zip(_cells(r, axes), decimals, strict=True)],
                "share": "" if r.share is None else f"{100 * r.share:.1f} %",
                "p": "" if r.p_left is None else numbers.p_text(r.p_left),
            }
            for r in rows
        ],
    }


def _cells(row: StepRow, axes: Sequence[str]) -> list[float]:
    """A line's sizes in the order of the columns."""
    return [x for a in axes for x in row.sizes.get(a, (math.nan, math.nan))]


def _decimals(text: str) -> int:
    """Decimals of a number, the same for a column; of tiny ones those of the least that a column has room for."""
    return min(len(text.partition(".")[2]), _ROOM) if "e" not in text else _ROOM


def _strata(finding: Finding) -> list[tuple[str, str, str, str]]:
    first = finding.steps[0].strata
    last = {s.name: s for s in finding.steps[-1].strata}
    out = []
    for s in first:
        now = last.get(s.name)
        out.append((s.name, str(s.degrees_of_freedom), _stratum(s), _stratum(now) if now else ""))
    return out


def _stratum(s: Any) -> str:
    p = "reference" if s.p_value is None else numbers.p_equals(s.p_value)
    return f"{s.ratio:.3g} ({p})"


def _pictures(finding: Finding) -> dict[str, Any]:
    drawn = {"gap": plots.draw_gap, "histograms": plots.draw_histograms, "map": plots.draw_map}
    return {name: _marked(draw(finding)) for name, draw in drawn.items()}


def _marked(picture: plots.Picture | None) -> dict[str, Any] | None:
    """A picture for the page; its caption stands for it where nobody sees it."""
    if picture is None:
        return None
    svg = picture.svg.replace("<svg", Markup('<svg role="img" aria-label="{}"').format(picture.caption), 1)
    return {"svg": Markup(svg), "caption": picture.caption}


def _laws(finding: Finding) -> list[dict[str, Any]]:
    """Every effect that was added: its law as formula, and drawn through the data; the links of a ladder last."""
    common, own = words.explanations(finding)
    shown = [*common, *(e for members in own for e in members)]
    count = {e.effect: sum(o.effect == e.effect for o in finding.named) for e in shown}
    out = []
    for e in sorted(shown, key=lambda e: count[e.effect] > naming.MANY)[:_MOST_LAWS]:
        found = formulas(finding.task.robot, e.instance)
        tag = f"explanation {e.set_number + 1}: " if finding.verdict == AMBIGUOUS and e not in common else ""
        out.append(
            {
                "name": tag + named(e.effect, e.where),
                "formulas": [(Markup(f.mathml), f.text, f.letters) for f in found],
                "picture": _marked(law_plots.draw_law(finding, e)) if finding.testable else None,
            }
        )
    return out


def _unnamed(finding: Finding) -> dict[str, Any] | None:
    known = finding.verdict not in (UNEXPLAINED, INSUFFICIENT) or finding.because.why is Why.POSES
    if known or not finding.testable or finding.last.against_sigma or finding.last.stratum_alone is not None:
        return None
    where, law, device = finding.last.localisation, finding.last.law, finding.last.device_law
    top = [] if where is None else [
        (b.virtual_joint, f"{100 * b.explained:.0f} %") for b in where.back_projections[:6]
    ]  # fmt: skip
    return {
        "accused": law_place(finding.accused),
        "picture": _marked(law_plots.draw_unnamed(finding)),
        "device": device and unnamed.device_text(device),
        "law": None
        if law is None
        else {
            "joint": law.virtual_joint,
            "text": unnamed.law_text(finding, law),
            "expression": law.expression,
            "symbol": shift(finding, law.virtual_joint),
            "unit": "rad" if rotates(finding, law.virtual_joint) else "m",
            "scales": {n: f"{x:.4g}" for n, x in law.scales.items()},
            "explained": unnamed.explained(law),
            "validated": f"{100 * law.cross_validated:.0f} %",
        },
        "top": top,
    }


def _moved(finding: Finding) -> list[dict[str, str]]:
    out = []
    for m in moved(finding):
        sigmas = m.sigmas
        out.append(
            {
                "name": m.name,
                "unit": unit_text(m.unit),
                "before": _value(m.before, m.before_std),
                "after": _value(m.after, m.after_std),
                "sigmas": "" if sigmas is None else f"{sigmas:.1f}",
                "class": "moved" if sigmas is not None and sigmas > _CHANGED else "",
            }
        )
    return out


def _value(value: float | None, std: float | None) -> str:
    if value is None or std is None:
        return "–"
    return numbers.quantity(Quantity(value, std, "plain")).removesuffix(" plain")
