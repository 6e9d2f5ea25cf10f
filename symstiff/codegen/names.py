"""What parameters, loads and functions mean, in words for headers and tables."""

from __future__ import annotations

from symstiff.reduction.physical import Parameter

LOADS_MEANING = {
    "wrench": "any force and moment at the tool centre point",
    "force": "any force at the tool centre point, no moment",
    "gravity": "a vertical force at the tool centre point (world z)",
}
CONTEXT_MEANING = {
    "time": "s, since the start of the measurements",
    "temperature": "degC",
    "branch": "+1 while the load grows, -1 while it falls",
}
CONTEXT_DEFAULTS = {"time": 0.0, "temperature": 20.0, "branch": 1.0}
SUMMARIES = {
    "deflection": "deflection of the tool centre point by recursion over the links",
    "observation": "observation matrix by columns",
    "jacobian": "Jacobian of the actuated joints",
    "compliance": "Cartesian compliance matrix by recursion",
    "columns": "columns of the virtual-joint Jacobian, three numbers a vector",
    "forward": "pose of the tool centre point",
}


def meaning(p: Parameter) -> str:
    """What a compliance is, in the axes of its link's elastic frame (1 along the beam)."""
    return p.meaning
