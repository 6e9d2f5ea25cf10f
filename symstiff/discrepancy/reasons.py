"""Why a verdict is what it is: named cases, of which this file alone makes sentences."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Why(Enum):
    """The reason for a verdict; its value is the sentence, with places for what is told of the data."""

    NOTHING = "no test rejects"
    EXACT = "the model gives the readings but for rounding: they are computed, or the noise is none"
    AHEAD = "sufficient, plausible and ahead"
    LINKS = "the links give way; beyond the complete model no test rejects"
    FRAMES = "the frames of the links are off; beyond them no test rejects"
    SEVERAL = "several sets account for the data"
    PARTLY = "the leader explains most, but not all"
    ENOUGH = "as many effects as were looked for do not account for the data, and a further one is there"
    """The leader is named as insufficient because no larger set was tried."""
    AS_WELL = "it accounts for the data, and what has no name does so as well"
    """The leader is named as insufficient although nothing is left."""
    REFUTED = "without some of the poses another effect is in front, and it does not predict them"
    """The leader is named as insufficient although it accounts for the data."""
    SURE = "it is there, whatever else is missing; for the rest a law without a name does as well as the catalogue"
    """The leader is named as insufficient because only a part of what accounts for the data is sure."""
    NOT_ALONE = "effects of the catalogue account for the data, and a law without a name does so as well"
    FAINT = "effects of the catalogue account for the data, too faintly to be told from laws without a name"
    """Nothing is named although something suffices."""
    NO_SET = "no set of the catalogue accounts for the data"
    ASTRAY = "what accounts for the data goes far beyond its physical range where all parameters are identified jointly"
    ONE_STRATUM = (
        "one part of the residual alone holds more than noise, and no law at any place is seen in it"
    )
    """Neither is anything named nor a place accused."""
    SIGMA = (
        "the residual is {} times the stated sigma: either that is too small, or something is missing that no test "
        "names"
    )
    """The verdict rests on the stated sigma alone."""
    SETTLES = "{}, as one that sticks and slips or has clearance does, and no law of loads, angles or time tells that"
    """The residual contradicts the stated sigma, by what scatters along some joints."""
    POSES = "without the poses that are unlike all others nothing is missing"
    """The poses that bring what the catalogue has no name for."""
    DOUBTED = "{}: correct the {}"
    """What is wrong with the table, and what has to be corrected."""
    UNTESTABLE = "{}"


@dataclass(frozen=True)
class Reason:
    """A reason, and what it tells of the data."""

    why: Why
    told: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.why.value.format(*self.told)
