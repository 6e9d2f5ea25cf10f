"""A reduction for reading: the steps in words, the groups, the couplings, as tables of a notebook."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from symstiff.display import html_table, shortened

if TYPE_CHECKING:
    from symstiff.reduction.physical import Stage
    from symstiff.reduction.reduce import Reduction

_WHAT = {
    "original": "{n} joints and {links} links of 36 parameters",
    "M1": "symmetrisation: k_ij = k_ji",
    "M2": "sparsing: zeros of the link's template",
    "M3": "aggregation: joints into the links before them",
    "M4": "elimination of what has no influence (G1 {g1}, G2 {g2}, G3 {g3})",
    "M5": "selection of an independent set",
}


def steps(reduction: Reduction) -> tuple[tuple[str, int, str], ...]:
    """The rows of the seed's Table 1: step, number of parameters, what was done."""
    p, n = reduction.partition, reduction.robot.dof
    words = {"n": n, "links": n + 1, "g1": len(p.g1), "g2": len(p.g2), "g3": len(p.g3)}
    return tuple((step, count, _WHAT[step].format(**words)) for step, count in reduction.counts)


def reduction_html(reduction: Reduction) -> str:
    """Table 1, and the groups of its last steps."""
    p, e = reduction.partition, reduction.experiment
    fixed = "".join(f", q{i} fixed at {v}" for i, v in e.fixed.items())
    title = reduction.robot.title or reduction.robot.name
    stages = html_table(
        ("step", "parameters", "what"),
        steps(reduction),
        f"{title}: loads {e.loads}, measured {e.measure}{fixed}",
    )
    groups = (
        ("G1 identifiable", len(p.g1), " ".join(p.g1) or "–"),
        ("G2 without influence", len(p.g2), " ".join(p.g2) or "–"),
        ("G3 semi-identifiable", len(p.g3), " ".join(p.g3) or "–"),
        ("kept: the identifiable set", p.rank, " ".join(p.kept)),
    )
    return stages + html_table(("group", "parameters", "which"), groups)


def stage_html(stage: Stage) -> str:
    """The parameters that a step leaves, body by body, and what it took away and why."""
    bodies: dict[str, list[str]] = {}
    for parameter in stage.parameters:
        kind = "joint" if parameter.is_joint else "link"
        bodies.setdefault(f"{kind} {parameter.body}", []).append(parameter.name)
    kept = [(body, len(names), shortened(names)) for body, names in bodies.items()]
    reasons: dict[str, list[str]] = {}
    for name, reason in stage.reasons.items():
        reasons.setdefault(reason.partition(": ")[2] or reason, []).append(name)
    gone = [(reason, len(names), shortened(names)) for reason, names in reasons.items()]
    html = html_table(
        ("body", "parameters", "which"), kept, f"{stage.step}: {len(stage.parameters)} parameters"
    )
    return html + (html_table(("reason", "eliminated", "which"), gone) if gone else "")


def combination(row: Mapping[str, Any]) -> str:
    """Σ coefficient × kept as one line, equal coefficients together: ``(k0_44 − k1_44)/a_1 − a_1·k0_33``."""
    import sympy as sp

    groups: dict[Any, list[tuple[bool, str]]] = {}
    for kept, coefficient in row.items():
        c = sp.sympify(coefficient)
        negative = c.could_extract_minus_sign()
        groups.setdefault(-c if negative else c, []).append((negative, kept))
    text = ""
    for c, found in groups.items():
        members = sorted(found, key=lambda member: member[0])  # those with a plus first
        numerator, denominator = sp.fraction(c)
        first = members[0][0]
        what = _signed([(negative != first, name) for negative, name in members])
        factors = [_factor(numerator, sp.Add)] if numerator != 1 else []
        factors.append(f"({what})" if len(members) > 1 and (factors or denominator != 1) else what)
        over = "" if denominator == 1 else f"/{_factor(denominator, sp.Add, sp.Mul)}"
        part = "·".join(factors) + over
        inner = len(members) > 1 and part == what  # a bare sum: its signs are those of the line
        text += _signed(members, text != "") if inner else _signed([(first, part)], text != "")
    return text


def _signed(terms: Sequence[tuple[bool, str]], go_on: bool = False) -> str:
    """Terms with their signs; the first one's too, spaced, where a line goes on."""
    text = "".join(f" {'−' if negative else '+'} {term}" for negative, term in terms)
    if go_on:
        return text
    return text.removeprefix(" + ") if text.startswith(" + ") else "−" + text.removeprefix(" − ")


def _factor(expression: Any, *in_brackets: type) -> str:
    """An expression as a factor: products with ·, powers raised, in brackets where it is of one of the kinds."""
    text = str(expression).replace("**", "^").replace("*", "·").replace("-", "−")
    text = re.sub(r"\^(\d+)", lambda power: power[1].translate(_RAISED), text)
    return f"({text})" if isinstance(expression, in_brackets) else text


_RAISED = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def couplings_latex(couplings: Mapping[str, Mapping[str, Any]]) -> str:
    """Couplings as equations between columns of A, one line an eliminated parameter."""
    import sympy as sp

    lines = []
    for eliminated, row in couplings.items():
        total = sp.Add(*[sp.sympify(c) * _column(kept) for kept, c in row.items()])
        lines.append(rf"{sp.latex(_column(eliminated))} &= {sp.latex(total)}")
    return r"$$\begin{aligned}" + r"\\".join(lines) + r"\end{aligned}$$"


def _column(name: str) -> Any:
    import sympy as sp

    return sp.Symbol(rf"A_{{{name.replace('_', ',')}}}")
