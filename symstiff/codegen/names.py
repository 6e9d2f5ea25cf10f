"""What parameters, loads and functions mean, in words for headers and tables."""

from __future__ import annotations

from symstiff.reduction.physical import Parameter

LOADS_MEANING = {
    "wrench": "any force and moment at the tool centre point",
    "force": "any force at the tool centre point, no moment",
    "gravity": "a vertical force at the tool centre point (world z)",
}
SUMMARIES = {
    "deflection": "deflection of the tool centre point by recursion over the links",
    "observation": "observation matrix by columns",
    "jacobian": "Jacobian of the actuated joints",
    "compliance": "Cartesian compliance matrix by recursion",
    "forward": "pose of the tool centre point",
}
_AXIS = {1: "translation along 1", 2: "translation along 2", 3: "translation along 3"}
_AXIS |= {4: "rotation about 1", 5: "rotation about 2", 6: "rotation about 3"}
_LOAD = {1: "force along 1", 2: "force along 2", 3: "force along 3"}
_LOAD |= {4: "moment about 1", 5: "moment about 2", 6: "moment about 3"}


def meaning(p: Parameter) -> str:
    """What a compliance is, in the axes of its link's elastic frame (1 along the beam)."""
    if p.is_joint:
        return f"compliance of joint {p.body}"
    body = "link 0 (pedestal)" if p.body == 0 else f"link {p.body}"
    both = " (and its mirror)" if p.is_coupling else ""
    return f"{body}: {_AXIS[p.row]} by {_LOAD[p.column]}{both}"
