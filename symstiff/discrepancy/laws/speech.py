"""Laws without a name in words."""

from __future__ import annotations

from symstiff.discrepancy.laws.unnamed import READING

_DEVICE = {
    "gain": "a gain error",
    "gain*load": "a gain error that grows with the load",
    "gain*time": "a gain error that grows with the session",
    "gain*temperature": "a gain error that grows with the temperature",
    "gain*branch": "a load that is another one rising than falling, as friction in the rig makes it",
    "gain*branch*(1 - load)": "a load that is another one rising than falling, alike where it turns",
    "crosstalk": "crosstalk",
    "late": "a reading that still holds a share of the load before",
}

_JOINT = {
    "tau, late": "a load that is followed late, as what creeps follows it",
    "tau by load_case": "a load that tells more the later it comes in its pose, as on what creeps",
    "tau beyond a threshold": "the part of the load that is above a threshold",
    "branch*tau": "friction in proportion to the load",
}


def law_place(accused: str) -> str:
    """The place of a law without a name, with the article of things that have no number."""
    things = ("reading", "force", "load of", "measuring", "order", "foot", "flange", "robot")
    sensor, axis, number = accused.partition(" axis ")
    if accused.startswith("force sensor") and axis:
        return f"axis {number} of the {sensor}"
    return f"the {accused}" if accused.startswith(things) else accused


def law_words(name: str, place: str) -> str:
    """A law of a device at its place in words; ``^1`` is left unsaid."""
    if place.startswith(READING):
        return f"a term in {name.replace('order', 'the order of the rows')}"
    article = "an" if name[0] in "aeo" else "a"
    return _DEVICE.get(name, f"{article} {name.removesuffix('^1')}")


def law_at(law: str, place: str) -> str:
    """A law without a name in words, as far as it has some, and its place."""
    loaded = place.startswith(("joint", "link"))
    told = _JOINT.get(law, f"a law of {law.replace('*', '·')}") if loaded else law_words(law, place)
    return f"{told} ({place})"
