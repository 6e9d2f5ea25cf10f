"""Laws without a name in words: what a virtual joint, a sensor, the device or a marker does."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.numbers import number, quantity
from symstiff.discrepancy.findings.result import Quantity
from symstiff.discrepancy.laws.speech import law_words
from symstiff.discrepancy.search.localise import FittedDevice, FittedLaw
from symstiff.display import listing
from symstiff.report.tables import rotates

_LITTLE = 0.1
"""Share of what is left below which a law's size in standard deviations is told."""
_TERMS, _TERM = 3, re.compile(r" (?=[-+][\d.]+(?:e[-+]\d+)?\*)")
"""Terms of a law that a sentence shows, and what stands before each but the first."""
_MANY, _CLEAR = 6, 2.0
"""Sizes of a device's law of which only those beyond so many standard deviations are told."""


def explained(law: FittedLaw | FittedDevice) -> str:
    """How much a law explains; where that is little, as among much noise, its own size too; whether it holds."""
    text = f"{100 * law.explained:.0f} % of what the model leaves"
    if isinstance(law, FittedDevice):
        return text
    if law.explained < _LITTLE and law.deviations:
        text += f": a size of {law.deviations:.2g} standard deviations"
    elsewhere = f"{100 * law.cross_validated:.0f} %" if law.cross_validated > 0 else "nothing"
    return f"{text}, and {elsewhere} on poses that were left out"


def device_text(law: FittedDevice) -> str:
    """What a sensor, the device or a marker adds, with sizes; of many those that are clearly not zero."""
    parts: dict[str, list[str]] = {text.partition(": ")[0]: [] for text, *_ in law.terms}
    clear = [term for term in law.terms if abs(term[1]) > _CLEAR * term[2]]
    many = len(law.terms) > _MANY
    for text, value, deviation, unit in clear if many else law.terms:
        name, _, part = text.partition(": ")
        size = quantity(Quantity(value, deviation, unit))
        parts[name].append(f"{part.replace('*', '·')} {size}".strip())
    if many and not clear:
        parts = {name: [f"{len(law.terms)} sizes, none of which is told by itself"] for name in parts}
    told = ", ".join(
        f"{law_words(name, law.place)} ({', '.join(sizes)})" for name, sizes in parts.items() if sizes
    )
    return f"{told} explains {explained(law)}"


_LATE, _IN_ORDER = r"late\(", "late(t, s) following t with the constant s of the rows, in the table's order"
_WORDS = {
    r"beyond\(": "beyond(t, s) the part of t above s",
    r"creep\(": "creep(t, s) following t from the begin of its pose on with the time constant s of a pose's time",
    _LATE: "late(t, s) following t with the time constant s of the session",
    r"\btime\b": "time running from 0 to 1 over the session",
    r"\border\b": "order running from 0 to 1 over the rows of the table",
    r"\bload_case\b": "load_case growing by 1 from the first load of a pose to the last",
    r"\bweight\b": "weight the load of the links' own weight in the unit of t",
    r"\bload\b": "load the size of the load over the largest of its pose",
    r"\bbranch\b": "branch 1 where the load rises and −1 where it falls",
    r"\btemperature\b": "temperature running from 0 at the lowest to 1 at the highest",
}
"""What the words of a law mean, by how they are found in it."""


def _signed(value: float) -> str:
    return (
        f"{value:+.3g}" if 1e-4 <= abs(value) < 1e3 else f"{'+' if value >= 0 else '-'}{number(abs(value))}"
    )


def law_in_short(finding: Finding, law: FittedLaw) -> str:
    """A fitted law as a sentence holds it: of many terms the largest."""
    terms = sorted(_TERM.split(law.expression), key=lambda term: -abs(float(term.partition("*")[0])))
    if len(terms) <= _TERMS + 1:
        return law_text(finding, law)
    shown = " ".join(terms[:_TERMS])
    used = {name: size for name, size in law.other_scales.items() if re.search(rf"\b{name}\b", shown)}
    kept = replace(law, expression=shown, other_scales=used)
    return law_text(finding, kept, f" and {len(terms) - _TERMS} smaller terms")


def law_text(finding: Finding, law: FittedLaw, more: str = "") -> str:
    """A fitted law as one reads it, with t for the load in units of the largest; ``more`` follows its terms."""
    text = re.sub(r"[-+]?\d[\d.]*e[-+]\d+", lambda m: f"{float(m.group()):+.9f}", law.expression)
    unit, load = ("mrad", "N·m") if rotates(finding, law.virtual_joint) else ("mm", "N")
    text = re.sub(r"(?<![\w.(*^])[-+]?\d[\d.]*(?=\*)", lambda m: _signed(1e3 * float(m.group())), text)
    for plain, written in (("tau", "t"), ("*", "·"), (" ", ""), ("+", " + "), ("-", " − ")):
        text = text.replace(plain, written)
    text = text.strip().removeprefix("+").strip()
    text = re.sub(r"^− ", "−", text)
    joints = finding.task.robot.joint
    told = [f"t = τ/({number(law.tau_scale, 4)} {load})"] if "tau" in law.scales else []
    for name, largest in law.other_scales.items():
        own = name.removeprefix("tau")
        slides = own == "x" or joints[int(own) - 1].prismatic
        what = "the load along the link" if own == "x" else f"τ{own}"
        told.append(f"t{own} = {what}/({number(largest, 4)} {'N' if slides else 'N·m'})")
    words = _WORDS if np.all(np.isfinite(finding.table.time)) else {**_WORDS, _LATE: _IN_ORDER}
    told += [meaning for word, meaning in words.items() if re.search(word, text)]
    return f"({text}{more}) {unit}" + (f" with {listing(told)}" if told else "")
