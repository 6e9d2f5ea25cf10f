"""Residuals and noise in words: with their units, and with the digits that tell them apart."""

from __future__ import annotations

from symstiff.calibration.tables.measurements import COMPONENTS
from symstiff.discrepancy.findings.finding import Finding
from symstiff.discrepancy.findings.numbers import milli
from symstiff.discrepancy.noise.scales import NoiseReport, off
from symstiff.discrepancy.noise.sharing import JOINTS
from symstiff.display import times

_TWO_DIGITS = 10.0
"""Units of the last digit from which a size has two."""
_LOUDER = 1.08
"""Least residual over the stated sigma that is spoken of where nothing is missing."""
_SEEN = 0.01
"""p-value below which something is said of the noise."""
_GROWS = 0.25
"""Power of a quantity from which the noise is said to change with it."""


def louder(noise: NoiseReport) -> str:
    """How much larger the noise is than stated; empty where it is not."""
    larger = noise.misstated and noise.ratio is not None and noise.ratio > _LOUDER
    return f"{times(noise.ratio or 1.0)} times the stated sigma" if larger else ""


def size(value: float | None, finding: Finding, decimals: int | None = None) -> str:
    """A residual as millimetres, with so many decimals; as milliradians where rotations alone were measured."""
    if value is None:
        return "–"
    rough = decimals is None or 1e3 * value * 10**decimals < _TWO_DIGITS
    return f"{milli(value) if rough else f'{1e3 * value:.{decimals}f}'} {unit(finding)}"


def unit(finding: Finding) -> str:
    """The unit of residuals that count together."""
    return "mm" if finding.table.measured[:, :3].any() else "mrad"


def shares(finding: Finding) -> bool:
    """Whether a pose's rows are said to share an error."""
    return finding.last.noise.mostly_shared or finding.last.noise.approach_p < _SEEN


def noise(finding: Finding, decimals: int | None = None) -> str:
    """The noise of a coordinate; where a pose's rows share more than that, which may be something missing, both."""
    report = finding.last.noise
    if not report.mostly_shared:
        whole = size(finding.rms.noise, finding, decimals)
        return f"{whole}, what a pose's rows share included" if shares(finding) else whole
    own, shared = size(report.sigma, finding, decimals), size(report.approach, finding, decimals)
    return f"{own}, and {shared} that a pose's rows share"


def of_noise(finding: Finding, decimals: int | None = None) -> str:
    """The same, with the word before it."""
    return f"noise {noise(finding, decimals)}"


def noise_lines(finding: Finding) -> list[str]:
    """What was found out about the noise, a line each."""
    n = finding.last.noise
    found = finding.testable and finding.named
    left = "what is left after everything found" if found else "what the model leaves"
    source = {"repeats": "repeated readings", "residual": f"{left}, as too little was measured twice"}
    lines = [
        f"standard deviation {size(n.sigma, finding)} from {source.get(n.source, n.source)} "
        f"({n.degrees_of_freedom:.0f} degrees of freedom)"
    ]
    if n.stated is not None and n.ratio is not None:
        text = f"stated {size(n.stated, finding)}: found/stated = {n.ratio:.2f}"
        counts = n.ratio_interval is not None and off(n.ratio_interval)
        agrees = (
            ", which agree if the stated one counts the reading without load" if counts else ", which agree"
        )
        lines.append(text + (", which contradicts the stated one" if n.misstated else agrees))
    if n.approach_p < _SEEN:
        how = ", as if the joints had stopped beside their targets" if n.shared == JOINTS else ""
        lines.append(f"a pose's rows share an error of {size(n.approach, finding)}{how}")
    if n.reading > 0:
        lines.append(f"the markers of one reading share {100 * n.reading:.0f} % of its variance")
    lines += [str(joint) for joint in n.settling]
    if n.homogeneity_p < _SEEN:
        units = ("mm", "mrad")
        by = ", ".join(f"{COMPONENTS[a]} {milli(s)} {units[a > 2]}" for a, s in n.by_axis.items())
        lines.append(f"the noise differs between axes: {by}")
    for what, power in n.growth.items():
        if abs(power) > _GROWS:
            lines.append(f"the noise changes with the {what} (power {power:+.2f})".replace("-", "−"))
    return lines
