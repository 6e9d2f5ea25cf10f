"""A finding for reading: a line, and a table of a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

from symstiff.discrepancy.findings.numbers import percent, quantity
from symstiff.display import html_table
from symstiff.effects.places import named, place, spoken

if TYPE_CHECKING:
    from symstiff.discrepancy.findings.finding import Finding
    from symstiff.discrepancy.findings.result import Found


def finding_line(finding: Finding) -> str:
    """``kuka_kr270, named: nonlinear stiffness at joint 3; 0.046 to 0.035 mm rms``, the translations' (or mrad)."""
    names = ", ".join(named(e.effect, e.where) for e in finding.named)
    unit = "mm" if finding.table.measured[:, :3].any() else "mrad"
    sizes = f"{1e3 * finding.rms.before:.3f} to {1e3 * finding.rms.after:.3f} {unit} rms"
    verdict = finding.verdict.replace("_", " ")
    return f"{finding.task.robot.name}, {verdict}: {f'{names}; ' if names else ''}{sizes}"


def finding_html(finding: Finding) -> str:
    """The verdict's effects with sizes and confidence, sets of an ambiguous one in order, and the remarks."""
    rows = [
        (
            e.set_number + 1,
            spoken(e.effect),
            place(e.where),
            "; ".join(f"{name} = {quantity(value)}" for name, value in e.parameters.items()),
            _confidence(finding, e),
        )
        for e in finding.effects
    ]
    notes = [x for x in (finding.reason, *finding.remarks) if x]
    return html_table(
        ("set", "effect", "where", "parameters", "confidence"), rows, finding_line(finding), notes
    )


def _confidence(finding: Finding, effect: Found) -> str:
    least, bet = finding.confidence([effect])
    return f"at most {percent(least)}" if bet else percent(least)
