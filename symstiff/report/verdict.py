"""verdict.json: the finding for programs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from symstiff.discrepancy.findings.finding import Finding, Rung
from symstiff.discrepancy.findings.result import CandidateResult, Found, Inconstancy, Name, Quantity
from symstiff.discrepancy.noise.sharing import JOINTS
from symstiff.discrepancy.search.verdict import NOTHING
from symstiff.discrepancy.statistics.strata import Stratum
from symstiff.display import finite
from symstiff.effects.instance import EffectInstance
from symstiff.report.tables import sizes_of
from symstiff.report.words import sentence


def verdict_table(finding: Finding, decide: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The verdict as plain values; what is not finite or unknown is null. ``decide``: the poses that decide."""
    last = finding.last
    table = {
        "verdict": finding.verdict,
        "testable": finding.testable,
        "sentence": sentence(finding, decide),
        "reason": finding.reason,
        "remarks": list(finding.remarks),
        "robot": finding.task.robot.name,
        "start": finding.task.origin,
        "effects": [effect_table(e) for e in finding.effects],
        "alternatives": [effect_table(e) for e in finding.alternatives],
        "candidates": [_candidate(c) for c in finding.candidates],
        "as_told_mm": _mm(finding.as_told),
        "rms_mm": {
            "before": _mm(finding.rms.before),
            "after": _mm(finding.rms.after),
            "held_out_before": _mm(finding.rms.held_out_before),
            "held_out_after": _mm(finding.rms.held_out_after),
            "noise": _mm(finding.rms.noise),
        },
        "closure": finite(finding.rms.closure),
        "confirmed": finding.rms.confirmed,
        "p_missing": finite(finding.first.p_missing),
        "p_unnamed": finite(last.p_unnamed),
        "noise": _noise(finding),
        "strata": [_stratum(s) for s in finding.steps[0].strata],
        "strata_left": [_stratum(s) for s in finding.steps[-1].strata],
        "steps": [_step(finding, s) for s in finding.steps],
        "accused": (finding.accused if finding.verdict != NOTHING else "") or None,
        "law": _law(finding),
        "device_law": _device_law(finding),
        "leading": [
            {**_name(name), "shape": _json(shape), "parameters": _estimates(sizes)}
            for name, shape, sizes in last.leading
        ],
        "rival": None if last.rival is None else asdict(last.rival),
        "inconstant": [_inconstant(o) for o in last.inconstant],
        "reshaped": [_instance(e) for e in finding.reshaped],
        "confusability": {
            "names": [_name(n) for n in last.confusability_names],
            "noncentrality": np.asarray(last.confusability).tolist(),
        },
        "model": {
            "loads": finding.start.model.loads,
            "measure": finding.start.model.measure,
            "values": {n: finite(v) for n, v in finding.start.model.values.items()},
            "effects": [_instance(e) for e in finding.start.model.effects],
        },
    }  # fmt: skip
    return table if decide is None else {**table, "decide": decide}


def _instance(effect: EffectInstance) -> dict[str, Any]:
    return {"effect": effect.effect, "where": _json(effect.where), "shape": _json(effect.shape)}


def _mm(value: float | None) -> float | None:
    return None if value is None else finite(1e3 * value)


def _json(value: Any) -> Any:
    """Places hold numbers, names and lists of them."""
    if isinstance(value, Mapping):
        return {str(k): _json(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_json(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def _estimates(parameters: Mapping[str, Quantity]) -> dict[str, Any]:
    return {
        n: {"value": finite(e.value), "std": finite(e.std), "unit": e.unit}
        | ({} if e.across is None else {"across": [finite(x) for x in e.across]})
        for n, e in parameters.items()
    }


def _name(name: Name) -> dict[str, Any]:
    return {"effect": name.effect, "where": _json(name.where)}


def effect_table(effect: Found) -> dict[str, Any]:
    """An effect of the verdict; effects with the same ``set`` stand together."""
    return {
        "effect": effect.effect,
        "where": _json(effect.where),
        "parameters": _estimates(effect.parameters),
        "p_value": finite(effect.p_value),
        "confidence": finite(effect.confidence),
        "confounded_with": [_name(n) for n in effect.confounded_with],
        "shape": _json(effect.shape),
        "sizes_over": _json(effect.instance.spans),
        "set": effect.set_number,
    }


def _candidate(c: CandidateResult) -> dict[str, Any]:
    sizes = {n: e for n, e in c.smallest_detectable.items() if math.isfinite(e.value)}
    smallest: dict[str, Any] = {"value": None, "unit": ""}
    if sizes:
        name = next(iter(sizes))
        smallest = {
            "value": finite(sizes[name].value),
            "unit": sizes[name].unit,
            "parameter": name,
            "shape": _json(c.seen_as),
        }
    return {
        "effect": c.effect,
        "where": _json(c.where),
        "p_value": finite(c.p_value),
        "testable": c.testable,
        "sufficient": bool(c.sufficient),
        "smallest_detectable": smallest,
        "smallest_detectable_by_parameter": {
            n: {"value": finite(e.value), "unit": e.unit} for n, e in c.smallest_detectable.items()
        },
        "plausible": c.plausible,
        "reason": c.reason,
        "score": finite(c.score),
        "share_left": finite(c.share_left),
        "shape": _json(c.shape),
        "parameters": _estimates(c.parameters),
        "confused_with": [_name(n) for n in c.confused_with],
    }


def _stratum(s: Stratum) -> dict[str, Any]:
    return {
        "name": s.name,
        "degrees_of_freedom": int(s.degrees_of_freedom),
        "ratio": finite(s.ratio),
        "p_value": finite(s.p_value),
    }


def _step(finding: Finding, s: Rung) -> dict[str, Any]:
    sizes = sizes_of(finding, s.residual)
    return {
        "title": s.title,
        "parameters": s.parameters,
        "p_left": finite(s.p_left),
        "residuals": {k: {"max": v.max, "rms": v.rms} for k, v in sizes.items()},
    }


def _inconstant(one: Inconstancy) -> dict[str, Any]:
    ways = {
        "by": one.by,
        "p_value": finite(one.p_value),
        "share": one.share,
        "low": one.low,
        "high": one.high,
        **({"files": dict(one.each)} if one.each else {}),
    }
    return {**_name(one.name), **ways}


def _noise(finding: Finding) -> dict[str, Any]:
    n = finding.last.noise
    return {
        "sigma_mm": _mm(n.sigma),
        "stated_mm": _mm(n.stated),
        "ratio": finite(n.ratio),
        "misstated": bool(n.misstated),
        "source": n.source,
        "degrees_of_freedom": finite(n.degrees_of_freedom),
        "approach_mm": _mm(n.approach),
        "approach_p": finite(n.approach_p),
        "approach_of": "joints" if n.shared == JOINTS else "axes",
        "reading_share": finite(n.reading),
        "settling": [
            {"joint": s.joint, "std": finite(s.std), "unit": "m" if s.slide else "rad"} for s in n.settling
        ],
        "homogeneity_p": finite(n.homogeneity_p),
    }


def _law(finding: Finding) -> dict[str, Any] | None:
    law = finding.last.law
    if law is None:
        return None
    return {
        "virtual_joint": law.virtual_joint,
        "expression": law.expression,
        "tau_scale": finite(law.tau_scale),
        "other_scales": {name: finite(largest) for name, largest in law.other_scales.items()},
        "explained": finite(law.explained),
        "cross_validated": finite(law.cross_validated),
    }


def _device_law(finding: Finding) -> dict[str, Any] | None:
    law = finding.last.device_law
    if law is None:
        return None
    terms = [{"law": t, "value": finite(v), "std": finite(d), "unit": u} for t, v, d, u in law.terms]
    return {"place": law.place, "terms": terms, "explained": finite(law.explained)}
