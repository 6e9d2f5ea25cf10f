"""What may be behind what was found, other than its name or its place."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.tables.measurements import Measurements
from symstiff.discrepancy.findings.result import Diagnosis
from symstiff.discrepancy.laws.sensors import SENSOR
from symstiff.discrepancy.laws.speech import law_at
from symstiff.discrepancy.search.rivals import AS_MUCH
from symstiff.discrepancy.search.verdict import INSUFFICIENT, UNEXPLAINED

_COMPLIANCES = {
    "gain*time": "soften with the session, as gears that warm up do,",
    "gain*temperature": "soften with the temperature",
    "gain*load": "bend alike",
}
"""What compliances do that all together look like a gain of the force sensor."""


def of_files(table: Measurements, last: Diagnosis) -> list[str]:
    """What may have changed between the sessions that files are of, where no effect accounts for all of them."""
    if last.verdict not in (UNEXPLAINED, INSUFFICIENT) or len(np.unique(table.file)) < 2:
        return []
    return [
        "these are several files, and of what changed between them only a device or targets that moved are looked for: "
        "diagnose each by itself, a later one also from the model of an earlier one (--start model.toml)"
    ]


def of_alike(last: Diagnosis) -> list[str]:
    """A law without a name elsewhere that describes what was named."""
    if last.alike is None:
        return []
    told, lead = law_at(last.alike.law, last.alike.place), last.alike.lead
    well = "better" if lead > AS_MUCH else "as well" if lead > -AS_MUCH else "nearly as well"
    return [
        f"what was named may be another thing: {told}, which the catalogue does not hold, explains these "
        f"data {well}: look there before relying on the name"
    ]


def of_gain(table: Measurements, last: Diagnosis) -> list[str]:
    """That a gain of all loads is what compliances leave that all change alike."""
    device = last.device_law
    if device is None or device.place != SENSOR or table.kind != "deflection":
        return []
    told = [_COMPLIANCES[law] for law, *_ in device.terms if law in _COMPLIANCES]
    return [
        f"compliances that all {how} leave the same in deflections as a gain of the force sensor: loads by weights "
        "that are known would tell them apart"
        for how in told
    ]
