"""Effects in links, base and tool: compliance blocks, geometry, weights, growth with temperature, slip."""

from __future__ import annotations

from typing import Any

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.simulation.chain import link_slice
from symstiff.calibration.simulation.equilibrium import States, Weight, weight_at
from symstiff.calibration.simulation.phenomena import (
    Additions,
    Site,
    Values,
    phenomenon,
    rotation_matrix,
    saturation,
)
from symstiff.errors import UserError


def block_of(entries: dict[str, float]) -> Array:
    """Return the symmetric 6×6 compliance with the given entries, keys "11" to "66", row ≤ column."""
    block = np.zeros((6, 6))
    for key, value in entries.items():
        if len(key) != 2 or not set(key) <= set("123456") or key[0] > key[1]:
            raise UserError(f'entry {key!r}: name it by row and column, "11" to "66", row ≤ column')
        row, column = int(key[0]) - 1, int(key[1]) - 1
        block[row, column] = block[column, row] = value
    return block


def _at(site: Site, link: int, block: Array) -> Additions:
    full = np.zeros_like(site.compliance)
    full[link_slice(link), link_slice(link)] = block
    return Additions(compliance=full)


def _unit(name: str, direction: Any) -> Array:
    """A direction, one long."""
    length = float(np.linalg.norm(direction))
    if not length > 0:
        raise UserError(f"{name} {np.asarray(direction).tolist()}: a direction has a length")
    return np.asarray(direction / length)


@phenomenon("link_compliance", "entries", "link", "entries{}")
@phenomenon("link_asymmetry", "entries", "link", "entries{}")
def _entries(site: Site, p: Values) -> Additions:
    return _at(site, site.where, block_of(p["entries"]))


@phenomenon("link_asymmetry", "tilted", "link", "angle", axis=(0.0, 1.0, 0.0))
def _tilted(site: Site, p: Values) -> Additions:
    """The link's principal axes stand at an angle [rad] to its elastic frame."""
    turn = np.kron(np.eye(2), rotation_matrix(_unit("axis", p["axis"]) * p["angle"]))
    old = site.compliance[link_slice(site.where), link_slice(site.where)]
    return _at(site, site.where, turn @ old @ turn.T - old)


@phenomenon("base_compliance", "entries", "robot", "entries{}")
def _base(site: Site, p: Values) -> Additions:
    return _at(site, 0, block_of(p["entries"]))


@phenomenon("base_compliance", "rocking", "robot", "c", direction=(0.0, 1.0, 0.0), height=0.0)
def _rocking(site: Site, p: Values) -> Additions:
    """The base rocks about a horizontal line below frame 0: turn and shift at once, one degree of freedom."""
    axis = site.chain.elastic[0].T @ _unit("direction", p["direction"])
    up = site.chain.elastic[0].T @ np.array([0.0, 0.0, 1.0])
    motion = np.concatenate([np.cross(axis, up) * p["height"], axis])
    return _at(site, 0, p["c"] * np.outer(motion, motion))


@phenomenon("tool_compliance", "entries", "robot", "entries{}")
def _tool(site: Site, p: Values) -> Additions:
    return _at(site, site.chain.dof, block_of(p["entries"]))


@phenomenon("geometric_error", "constant", "link", "shift[6]")
def _geometry(site: Site, p: Values) -> Additions:
    """Constant error at the link's six virtual joints [m, rad]."""
    shift = p["shift"]
    part = link_slice(site.where)

    def law(states: States, tau: Array, theta: Array) -> None:
        theta[:, part] += shift

    return Additions(laws=(law,))


@phenomenon("link_weight", "lumped", "link", "mass", com=(0.0, 0.0, 0.0))
def _weight(site: Site, p: Values) -> Additions:
    return Additions(weights=(weight_at(site.where, p["mass"], p["com"], behind=True),))


@phenomenon("link_weight", "before_springs", "link", "mass", com=(0.0, 0.0, 0.0))
def _weight_before(site: Site, p: Values) -> Additions:
    """The weight hangs ahead of the link's own springs and does not bend them."""
    return Additions(weights=(weight_at(site.where, p["mass"], p["com"]),))


def _payload(site: Site, p: Values, only_loaded: bool) -> Additions:
    """A mass at the tool centre point, and a first moment beside it, in the axes of frame n."""
    x, y, z = (float(m) for m in p["dmc"] + p["dm"] * site.chain.tool)
    return Additions(weights=(Weight(site.chain.dof, p["dm"], (x, y, z), True, only_loaded),))


phenomenon("payload_error", "tool", "tool", "dm", "dmc[3]", dm=0.0, dmc=0.0)(
    lambda site, p: _payload(site, p, False)
)
phenomenon("payload_error", "load", "tool", "dm", "dmc[3]", dm=0.0, dmc=0.0)(
    lambda site, p: _payload(site, p, True)
)


def _growth(site: Site, p: Values, kind: str) -> Additions:
    """The link grows along its elastic axes and turns about them, in the loaded state against the session's start."""
    part, size = link_slice(site.where), np.concatenate([p["rate"], p["turn"]])

    def law(states: States, tau: Array, theta: Array) -> None:
        theta[:, part] += (clock(states, p, kind) * states.loaded)[:, None] * size

    return Additions(laws=(law,))


def clock(states: States, p: Values, kind: str) -> Array:
    """What a drift grows with: time, temperature above a reference, or 1 − exp(−t/T)."""
    if kind == "time":
        return states.time
    return saturation(states.time, p["T"]) if kind == "exponential" else states.temperature - p["reference"]


phenomenon("thermal_drift", "link_time", "link", "rate[3]", "turn[3]", turn=0.0)(
    lambda site, p: _growth(site, p, "time")
)
phenomenon("thermal_drift", "link_temperature", "link", "rate[3]", "turn[3]", turn=0.0, reference=20.0)(
    lambda site, p: _growth(site, p, "temperature")
)
phenomenon("thermal_drift", "link_exponential", "link", "rate[3]", "turn[3]", turn=0.0, T=1800.0)(
    lambda site, p: _growth(site, p, "exponential")
)

phenomenon("large_deflection", "geometry", "robot")(lambda site, p: Additions())


# Outside the catalogue: for blind tests of "unexplained".


def _number(name: str, value: Any, most: int) -> int:
    """A number that counts from 1."""
    if value != int(value) or not 1 <= value <= most:
        raise UserError(f"{name} {value:g}: a whole number from 1 to {most}")
    return int(value)


@phenomenon("configuration_dependent_link", "sine", "link", "fraction", joint=1.0, order=1.0, phase=0.0)
def _configuration_dependent(site: Site, p: Values) -> Additions:
    """The link's whole compliance changes by fraction·sin(order·q_joint + phase)."""
    part, j = link_slice(site.where), _number("joint", p["joint"], site.chain.dof) - 1
    block = site.compliance[part, part]

    def law(states: States, tau: Array, theta: Array) -> None:
        change = p["fraction"] * np.sin(p["order"] * states.q[:, j] + p["phase"])
        theta[:, part] += change[:, None] * (tau[:, part] @ block)

    return Additions(laws=(law,))


@phenomenon("base_slip", "threshold", "robot", "c", axis=5.0, threshold=2000.0, width=50.0)
def _slip(site: Site, p: Values) -> Additions:
    """The base gives way about one elastic axis once the load passes a threshold."""
    v = _number("axis", p["axis"], 6) - 1

    def law(states: States, tau: Array, theta: Array) -> None:
        excess = p["width"] * np.logaddexp(0.0, (np.abs(tau[:, v]) - p["threshold"]) / p["width"])
        theta[:, v] += p["c"] * np.sign(tau[:, v]) * excess

    return Additions(laws=(law,))
