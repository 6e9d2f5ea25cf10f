"""Findings in words: the verdict in a few words, and in a sentence."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from symstiff.calibration.doubts.soundness import outside_class
from symstiff.calibration.tables.checks import of_units
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.numbers import decimals_between, p_equals
from symstiff.discrepancy.findings.remarks import FEW, hiding
from symstiff.discrepancy.findings.result import Found, RivalLaw
from symstiff.discrepancy.findings.since import worse
from symstiff.discrepancy.laws.speech import law_at, law_place
from symstiff.discrepancy.problem import Options
from symstiff.discrepancy.reasons import Why
from symstiff.discrepancy.search.proof import FEWEST
from symstiff.discrepancy.search.rivals import AS_MUCH
from symstiff.discrepancy.search.verdict import AMBIGUOUS, INSUFFICIENT, NAMED, NOTHING, UNEXPLAINED
from symstiff.display import listing, sentence_case
from symstiff.effects.places import named, place
from symstiff.effects.registry import find
from symstiff.report.deciding import deciding
from symstiff.report.instead import as_well
from symstiff.report.naming import confidence, each_told, names
from symstiff.report.sizes import louder, of_noise, size
from symstiff.report.tables import shift
from symstiff.report.unnamed import device_text, explained, law_in_short

_REST = 0.25
"""Probability that no explanation is left with, from which it is told."""
_OTHER = 3.0
"""Standard deviations by which a size in another set is another one."""


def _nothing_missing(finding: Finding) -> str:
    noise = finding.last.noise
    if not finding.last.growth:
        return "Nothing is missing"
    if louder(noise):
        return "Nothing found missing; the noise is larger than stated"
    if noise.mostly_shared:
        return "Nothing found missing; what a pose's rows share is more than noise"
    if hiding(finding.table, noise):
        return "Nothing found missing; something may hide in an error that a pose's rows share"
    if noise.degrees_of_freedom < FEW or finding.assembly.problem.poses < FEWEST:
        return "Nothing found missing, in few data"
    if worse(finding.as_told, finding.rms.after):
        return "Nothing is missing, but values of the start model do not hold any more"
    return "Nothing is missing"


def headline(finding: Finding) -> str:
    """The verdict in a few words."""
    if not finding.testable:
        doubtful = finding.last.doubtful
        return "The table has to be corrected first" if doubtful else "Nothing can be tested with these data"
    if of_units(finding.table, finding.task.robot):
        return f"{_headline(finding)}, if the units are right"
    beyond = outside_class(finding.table.w, finding.start.model.loads)
    return _headline(finding) + (", beside loads that the start model leaves out" if beyond else "")


def _headline(finding: Finding) -> str:
    if finding.because.why is Why.POSES:
        return f"Something is wrong with {finding.accused}; without that nothing is missing"
    if finding.because.why in (Why.NOT_ALONE, Why.FAINT):
        return "Something is missing, and the data do not tell whether the catalogue has a name for it"
    if finding.because.why is Why.SETTLES:
        return f"{sentence_case(finding.accused)} stops elsewhere at every reading, which no law tells"
    if finding.last.against_sigma:
        return "More is left than the stated sigma allows, and no test finds anything missing"
    if finding.last.stratum_alone is not None:
        return "More is left than independent noise leaves, and no place stands out"
    if _perhaps(finding):
        return f"Something is missing, perhaps: {names(finding.named)}"
    return {
        NAMED: sentence_case(_told_apart(finding, names)),
        NOTHING: _nothing_missing(finding),
        AMBIGUOUS: "Ambiguous: more than one explanation accounts for the data",
        INSUFFICIENT: "Missing, but not all of it: " + names(finding.named),
        UNEXPLAINED: "Something is missing that has no name in the catalogue",
    }[finding.verdict]


def _perhaps(finding: Finding) -> bool:
    """Whether something else does as well as what leads, or poses that were not used do not confirm it."""
    unconfirmed = finding.verdict == NAMED and finding.rms.unconfirmed and not finding.reshaped
    return unconfirmed or finding.because.why in (Why.AS_WELL, Why.REFUTED)


def _told_apart(finding: Finding, tell: Callable[[list[Found]], str]) -> str:
    """What was named, in words; what the start model has in another shape apart."""
    there = [named(e.effect, e.where) for e in finding.reshaped]
    new, old = (
        [e for e in finding.named if (named(e.effect, e.where) in there) is held] for held in (False, True)
    )
    missing = [f"missing: {tell(new)}"] if new else []
    other = [f"in another shape than the start model has it: {tell(old)}"] if old else []
    return "; ".join([*missing, *other])


def what(finding: Finding) -> str:
    """What the effects that a diagnosis tells of are: missing, perhaps, or in another shape than they were."""
    if finding.verdict == AMBIGUOUS:
        return "What could be missing"
    if _perhaps(finding):
        return "What is missing, perhaps"
    there = {named(e.effect, e.where) for e in finding.reshaped}
    other = {named(e.effect, e.where) in there for e in finding.named}
    return {
        frozenset({True}): "What has another shape",
        frozenset({True, False}): "What is missing, and what has another shape",
    }.get(frozenset(other), "What is missing")


def sentence(finding: Finding, decide: Mapping[str, Any] | None = None) -> str:
    """The verdict in a sentence, with units and confidence; ``decide`` is the record of the poses that decide."""
    if not finding.testable:
        so_far = (
            "is tested before the table is right"
            if finding.last.doubtful
            else "can be tested with these data"
        )
        return f"Nothing {so_far}: {finding.reason}."
    text = {
        NAMED: _named,
        NOTHING: _nothing,
        AMBIGUOUS: _ambiguous,
        INSUFFICIENT: _insufficient,
        UNEXPLAINED: _unexplained,
    }[finding.verdict](finding)
    doubts = of_units(finding.table, finding.task.robot)
    text = " ".join([*(f"{sentence_case(doubt)}." for doubt in doubts), text])
    if finding.reshaped and finding.verdict != NAMED:
        has = listing([named(e.effect, e.where) for e in finding.reshaped])
        text += f" The start model has {has} in another shape."
    return text if decide is None else f"{text} {deciding(decide)}"


def listed(finding: Finding, some: Sequence[Found] | None = None) -> str:
    """The leading set, or some of it: names, sizes, confidence; an effect at many places in one breath."""
    kinds: dict[str, list[Found]] = {}
    for e in finding.named if some is None else some:
        kinds.setdefault(e.effect, []).append(e)
    return "; ".join(part for group in kinds.values() for part in each_told(finding, group))


def gap(finding: Finding) -> str:
    """How the gap shrank."""
    r = finding.rms
    text = f"the residual {_goes(r.before, r.after, finding)} rms per coordinate"
    if r.held_out_before is not None and r.held_out_after is not None:
        text += f", on poses that were not used it {_goes(r.held_out_before, r.held_out_after, finding)}"
        text += ", which does not confirm it" if r.unconfirmed else ""
    return f"{text} ({of_noise(finding, decimals_between(r.before, r.after))})"


def _goes(before: float, after: float, finding: Finding) -> str:
    """From one size to another, in words, with the digits that tell them apart."""
    decimals = decimals_between(before, after)
    first, last = size(before, finding, decimals), size(after, finding, decimals)
    if first == last:
        return f"stays at {first}"
    return f"{'falls' if after < before else 'rises'} from {first} to {last}"


def _named(finding: Finding) -> str:
    told = _told_apart(finding, lambda some: listed(finding, some))
    if told.startswith("missing"):
        told = f"{what(finding)}{told.removeprefix('missing')}" if _perhaps(finding) else f"what is {told}"
    text = f"{sentence_case(told)}; {gap(finding)}.{as_well(finding)}"
    sets = sorted({e.set_number for e in finding.alternatives})
    others = [[e for e in finding.alternatives if e.set_number == s] for s in sets]
    if not others:
        return text
    return f"{text} Less likely, but not excluded: {'; or '.join(_instead(members, finding) for members in others)}."


def _instead(members: list[Found], finding: Finding) -> str:
    """Another set in words, what it shares with the named one left out."""

    def outside(some: Sequence[Found], others: Sequence[Found]) -> list[Found]:
        there = [named(e.effect, e.where) for e in others]
        return [e for e in some if named(e.effect, e.where) not in there]

    own, gone = (
        names(part).replace("; ", " with ")
        for part in (outside(members, finding.named), outside(finding.named, members))
    )
    if not own:
        return f"the same without {gone}"
    return f"{own} instead of {gone}" if gone and len(finding.named) > 1 else own


def _nothing_but_poses(finding: Finding) -> str:
    them = "them" if len(finding.because.told) > 1 else "it"
    law = finding.last.device_law
    there = "" if law is None else f", where {device_text(law)}"
    return (
        f"What is missing comes with {finding.accused}{there}: unlike all others, and nothing of the catalogue. Look "
        f"at labels, loads and joint readings there, or measure {them} again. Without {them} the model accounts for "
        f"the data: {size(finding.rms.after, finding)} rms per coordinate is left, {of_noise(finding)}."
    )


def _nothing(finding: Finding) -> str:
    r = finding.rms
    kind, data = finding.table.kind, "positions" if finding.table.kind == "absolute" else "deflections"
    shown = [
        c for c in finding.candidates if kind in find(c.effect).seen_in and find(c.effect).places_in is None
    ]
    larger = louder(finding.last.noise)
    fitted, own = "", ""
    if worse(finding.as_told, r.after):
        fitted = " once its values are fitted anew to them"
        told = size(finding.as_told, finding)
        own = f" With the values that it was told it leaves {told}: they do not hold any more."
    return (
        f"The model accounts for the data{fitted}: {size(r.after, finding)} rms per coordinate is left, the noise is "
        f"{size(r.noise, finding)}{f', {larger}' if larger else ''} (no effect of the catalogue stands out from it: "
        f"{p_equals(finding.first.p_missing)}, where {Options.alpha:g} would; {sum(c.testable for c in shown)} of "
        f"{len(shown)} effects at their places that {data} can show could be tested).{own}"
    )


def explanations(finding: Finding) -> tuple[list[Found], list[list[Found]]]:
    """What all admissible sets share, as in the first, and what is each set's own."""
    sets = [
        [e for e in finding.effects if e.set_number == s]
        for s in sorted({e.set_number for e in finding.effects})
    ]
    keys = [{(e.effect, place(e.where)) for e in members} for members in sets]
    shared = set.intersection(*keys) if keys else set()
    common = [e for e in sets[0] if (e.effect, place(e.where)) in shared] if sets else []
    own = [[e for e in members if (e.effect, place(e.where)) not in shared] for members in sets]
    return common, own


def _ambiguous(finding: Finding) -> str:
    common, own = explanations(finding)
    texts = [
        f"{names(members).replace('; ', ' with ') or 'nothing more'}"
        + (f" ({confidence(finding, members)})" if members else "")
        for members in own
    ]
    beside = f"Beside {'; '.join(each_told(finding, common))}, " if common else ""
    rest = 1.0 - sum(min(e.confidence for e in members) for members in own if members)
    if rest > _REST and all(own):
        texts.append(f"none of these ({100 * rest:.0f} %)")
    told = ", or ".join(texts)
    text = f"{beside}{len(own)} explanations account for the data: {told}; with the first, {gap(finding)}."
    if changing := [e for e in common if _otherwise_elsewhere(finding, e)]:
        text += (
            f" The size of {names(changing)} is that with the first; with another explanation it is another."
        )
    return text


def _otherwise_elsewhere(finding: Finding, effect: Found) -> bool:
    """Whether another admissible set holds an effect with clearly other sizes."""
    others = (e for e in finding.effects if named(e.effect, e.where) == named(effect.effect, effect.where))
    return any(
        abs(size.value - effect.parameters[name].value) > _OTHER * max(size.std, effect.parameters[name].std)
        for other in others
        for name, size in other.parameters.items()
        if name in effect.parameters and math.isfinite(max(size.std, effect.parameters[name].std))
    )


def _insufficient(finding: Finding) -> str:
    if finding.because.why is Why.SURE:
        known = {named(e.effect, e.where) for e in finding.named}
        rest = [text for text in _leading(finding) if text not in known]
        law = _told(finding.last.rival)
        return (
            f"What is missing is sure in part: {listed(finding)}; for the rest, {_not_alone(rest)}{law}; "
            f"{gap(finding)}."
        )
    why = (
        "a law still stands out in what it leaves: another shape of it, or a further effect too faint to name"
    )
    if finding.because.why is Why.AS_WELL:
        rivals = (r for r in (finding.last.rival, finding.last.alike) if r is not None and r.lead >= -AS_MUCH)
        why = f"a law without a name accounts for the data as well{_told(next(rivals, None))}"
    if finding.because.why is Why.ENOUGH:
        why = f"{_further(finding)} stands out beside as many effects as were looked for: allow more (--max-effects)"
    if finding.because.why is Why.REFUTED:
        why = f"{finding.reason}: measure more poses before relying on it"
    return f"The leading explanation is {listed(finding)}, but {why}; {gap(finding)}."


def _told(rival: RivalLaw | None) -> str:
    """A law without a name and its place, after a colon; nothing where there is none."""
    return "" if rival is None else f": {law_at(rival.law, rival.place)}"


def _leading(finding: Finding) -> list[str]:
    """The effects of the leading set at their places."""
    return [named(name.effect, name.where) for name, _, _ in finding.last.leading]


def _not_alone(effects: Sequence[str], faint: bool = False) -> str:
    verb = "account" if len(effects) > 1 else "accounts"
    but = (
        "too faintly to be told from laws without a name" if faint else "a law without a name does so as well"
    )
    return f"{', '.join(effects)} {verb} for the data, but {but}"


def _further(finding: Finding) -> str:
    """What stands out most beside the effects found."""
    step = finding.last.growth[-1]
    name = "a further effect" if step.further is None else named(step.further.effect, step.further.where)
    return f"{name} ({p_equals(step.p_left)})"


def _unexplained(finding: Finding) -> str:
    if finding.because.why is Why.SETTLES:
        return (
            f"{sentence_case(finding.reason)} (residual {size(finding.rms.after, finding)} rms per coordinate, "
            f"noise as stated {size(finding.last.noise.stated, finding)}): "
            "read each load several times, coming from both sides."
        )
    if finding.last.against_sigma:
        return (
            f"No test finds anything missing, and {finding.reason} (residual {size(finding.rms.after, finding)} rms "
            f"per coordinate, noise as stated {size(finding.last.noise.stated, finding)}): check the stated sigma."
        )
    alone = finding.last.stratum_alone
    if alone is not None:
        p = p_equals(alone.p_value or 0.0)
        return (
            f"One part of the residual alone holds more than noise ({alone.name}: {p}), and no law at any "
            "place is seen there: it may be noise that follows itself from reading to reading (residual "
            f"{size(finding.rms.after, finding)} rms per coordinate, {of_noise(finding)})."
        )
    if finding.because.why is Why.POSES:
        return _nothing_but_poses(finding)
    accused = finding.accused
    text = "No effect of the catalogue accounts for the data"
    if finding.last.rival is not None and finding.last.leading:
        nearest = _leading(finding)
        come = "come" if len(nearest) > 1 else "comes"
        text += f" as well as a law without a name does, and {' and '.join(nearest)} {come} nearest"
    if finding.because.why is Why.NOT_ALONE:
        text = sentence_case(_not_alone(_leading(finding))) + _told(finding.last.rival)
    if finding.because.why is Why.FAINT:
        text = sentence_case(_not_alone(_leading(finding), faint=True))
    text += f"; the evidence is strongest at {law_place(accused)}" if accused else ""
    if finding.last.device_law is not None:
        text += f", where {device_text(finding.last.device_law)}"
    law = finding.last.law
    if law is not None and finding.last.device_law is None:
        where = (
            ", where" if law.virtual_joint == accused else f", without a law there; at {law.virtual_joint}"
        )
        text += (
            f"{where} the law {shift(finding, law.virtual_joint)} = {law_in_short(finding, law)} explains "
            + explained(law)
        )
    seen = f"; noise alone shows as much: {p_equals(min(finding.last.p_missing, finding.last.p_unnamed))}"
    return (
        f"{text} (residual {size(finding.rms.after, finding)} rms per coordinate, {of_noise(finding)}{seen})."
        f"{_to_do(accused, bool(finding.table.w.any()))}"
    )


def _to_do(accused: str, loaded: bool) -> str:
    """What helps next where no name is given, of rows of which some are ``loaded`` or none."""
    if accused.startswith(("joint", "link")) and not loaded:
        return (
            f" Look at {accused} for what moves or measures it so, as a pitch or an encoder that is not true; poses "
            "that take it through its range in finer steps tell its law better."
        )
    if accused.startswith(("joint", "link")):
        return (
            f" Look at {accused} for what gives way so; more load steps, and poses that take it through its range, "
            "tell its law better."
        )
    if accused:
        return f" Check {law_place(accused)}, and measure again, before anything else."
    return " More poses and load steps would tell where it sits."
