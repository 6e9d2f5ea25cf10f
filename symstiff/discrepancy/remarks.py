"""What a person should look at beside the verdict: noise that is not as stated, markers and poses unlike the others."""

from __future__ import annotations

import numpy as np

from symstiff.calibration.measurements import Measurements
from symstiff.discrepancy.noise import NoiseReport
from symstiff.discrepancy.result import Diagnosis
from symstiff.discrepancy.verdict import INSUFFICIENT, NAMED, NOTHING, UNEXPLAINED

LOOSE = 1.35
"""How much more than the others a marker scatters that is spoken of."""
FAR = 2.5
"""Error on poses that were not used, against the noise, that is spoken of."""
_MOSTLY = 0.5
"""Share of the residual's variance that few poses bring from which they are spoken of."""


def remarked(table: Measurements, last: Diagnosis) -> list[str]:
    """Remarks on a diagnosis, a sentence each."""
    noise = last.noise
    return [
        *_of_sigma(noise), *_of_approach(last), *_of_markers(noise), *_of_poses(table, last), *_of_single(last),
        *_of_proof(last)
    ]  # fmt: skip


def _of_sigma(noise: NoiseReport) -> list[str]:
    if not noise.misstated or noise.ratio_interval is None:
        return []
    low, high = noise.ratio_interval
    return [
        f"what is left varies by {noise.ratio:.2f} times the stated sigma ({low:.2f} to {high:.2f}): "
        "no test relies on the stated one"
    ]


def _of_approach(last: Diagnosis) -> list[str]:
    noise = last.noise
    if last.verdict != NOTHING or not noise.mostly_shared:
        return []
    return [
        f"a pose's rows share an error {noise.approach / noise.sigma:.1f} times the noise: the robot's repeatability, "
        "or something missing that these data cannot tell from it: approach some poses anew, or measure more loads"
    ]


def _of_markers(noise: NoiseReport) -> list[str]:
    return [
        f"marker {name} scatters {factor:.1f} times as much as the others: look at how it is fixed"
        for name, factor in noise.by_marker.items()
        if factor > LOOSE
    ]


def _of_poses(table: Measurements, last: Diagnosis) -> list[str]:
    where = last.localisation
    if where is None or last.verdict not in (UNEXPLAINED, INSUFFICIENT) or where.suspected < _MOSTLY:
        return []
    numbers = np.unique(table.pose)
    names = ", ".join(table.labels[int(numbers[p])] for p in where.suspects)
    return [
        f"most of what is left ({100 * where.suspected:.0f} % of its variance) comes with few poses ({names}): "
        "look at their labels and joint readings, or measure them again"
    ]


def _of_single(last: Diagnosis) -> list[str]:
    if last.verdict != NAMED or last.rms.held_out_before is not None:
        return []
    rows = [name.where.get("rows", ()) for name, _, _ in last.leading]
    names = ", ".join(str(pose) for labels in rows if isinstance(labels, list | tuple) for pose in labels)
    return [f"pose {names}: measure it again, or leave it out; no other pose can confirm it"] if names else []


def _of_proof(last: Diagnosis) -> list[str]:
    rms = last.rms
    if last.verdict == UNEXPLAINED or rms.held_out_after is None or rms.held_out_after < FAR * rms.noise:
        return []
    return [
        f"poses that were not used are predicted with {rms.held_out_after / rms.noise:.1f} times the noise: "
        "these poses are too few, or too unlike each other, to rely on the model beyond them"
    ]
