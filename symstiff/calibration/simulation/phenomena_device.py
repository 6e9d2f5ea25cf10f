"""Effects in the load and in the measurement: force sensor, frames, drift, bad poses."""

from __future__ import annotations

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.simulation.chain import posture
from symstiff.calibration.simulation.equilibrium import States
from symstiff.calibration.simulation.phenomena import (
    Additions,
    Site,
    Values,
    phenomenon,
    rotation_matrix,
    saturation,
)
from symstiff.calibration.simulation.phenomena_body import clock


def _bias(site: Site, p: Values, drifting: bool) -> Additions:
    bias = p["bias"]

    def wrench(states: States, w: Array) -> Array:
        share = states.hung * (saturation(states.time, p["T"]) if drifting else 1.0)
        return np.asarray(w + share[:, None] * bias)

    return Additions(wrenches=(wrench,))


phenomenon("force_sensor_bias", "constant", "load", "bias[6]")(lambda site, p: _bias(site, p, False))
phenomenon("force_sensor_bias", "drifting", "load", "bias[6]", T=1800.0)(lambda site, p: _bias(site, p, True))


@phenomenon("force_sensor_misalignment", "rotation", "load", "rotation[3]")
def _misaligned(site: Site, p: Values) -> Additions:
    turn = rotation_matrix(p["rotation"]).T

    def wrench(states: States, w: Array) -> Array:
        return np.concatenate([w[:, :3] @ turn, w[:, 3:] @ turn], axis=1)

    return Additions(wrenches=(wrench,))


@phenomenon("force_sensor_bias", "tool", "load", "bias[6]")
def _bias_at_flange(site: Site, p: Values) -> Additions:
    """A wrench that is constant in the axes of frame n, about its origin."""
    bias = p["bias"]

    def wrench(states: States, w: Array) -> Array:
        axes, lever = _flange(site, states.q)
        force, moment = axes @ bias[:3], axes @ bias[3:]
        added = np.hstack([force, moment - np.cross(lever, force)])
        return np.asarray(w + states.hung[:, None] * added)

    return Additions(wrenches=(wrench,))


@phenomenon("force_sensor_misalignment", "tool", "load", "rotation[3]")
def _misaligned_at_flange(site: Site, p: Values) -> Additions:
    """The wrench about the origin of frame n is turned by a rotation in that frame's axes."""
    turn = rotation_matrix(p["rotation"])

    def wrench(states: States, w: Array) -> Array:
        axes, lever = _flange(site, states.q)
        turned = axes @ turn @ axes.transpose(0, 2, 1)
        force = np.einsum("nij,nj->ni", turned, w[:, :3])
        moment = np.einsum("nij,nj->ni", turned, w[:, 3:] + np.cross(lever, w[:, :3]))
        return np.hstack([force, moment - np.cross(lever, force)])

    return Additions(wrenches=(wrench,))


def _flange(site: Site, q: Array) -> tuple[Array, Array]:
    """Axes (N, 3, 3) of frame n, and the way (N, 3) from its origin to the tool centre point."""
    chain = site.chain
    axes = posture(chain, q, np.zeros((len(q), chain.size))).after[0][:, -1]
    return axes, axes @ chain.tool


@phenomenon("frame_misalignment", "rotation", "measurement", "rotation[3]", shift=(0.0, 0.0, 0.0))
def _frame(site: Site, p: Values) -> Additions:
    """The device's axes are turned; absolute positions are also shifted."""
    turn = rotation_matrix(p["rotation"])
    shift = p["shift"]

    def reading(states: States, values: Array, kind: str) -> Array:
        result = np.concatenate([values[:, :3] @ turn.T, values[:, 3:] @ turn.T], axis=1)
        if kind == "absolute":
            result[:, :3] += shift
        return np.asarray(result)

    return Additions(readings=(reading,))


def _drift(p: Values, kind: str) -> Additions:
    rate = p["rate"]

    def reading(states: States, values: Array, data: str) -> Array:
        result = values.copy()
        result[:, :3] += clock(states, p, kind)[:, None] * rate
        return result

    return Additions(readings=(reading,))


phenomenon("thermal_drift", "time", "measurement", "rate[3]")(lambda site, p: _drift(p, "time"))
phenomenon("thermal_drift", "temperature", "measurement", "rate[3]", reference=20.0)(
    lambda site, p: _drift(p, "temperature")
)
phenomenon("thermal_drift", "exponential", "measurement", "rate[3]", T=1800.0)(
    lambda site, p: _drift(p, "exponential")
)


@phenomenon("bad_poses", "shift", "rows", "shift[3]", poses=())
def _bad(site: Site, p: Values) -> Additions:
    """All data of the named poses are shifted [m]."""
    return Additions(shifts=((p["poses"], p["shift"]),))


# Outside the catalogue: for blind tests of "unexplained".


@phenomenon("force_sensor_gain", "axes", "load", "gain[6]")
def _gain(site: Site, p: Values) -> Additions:
    """The sensor's axes have wrong gains: the true load is w·(1 + gain), axis by axis."""
    gain = 1.0 + p["gain"]
    return Additions(wrenches=(lambda states, w: w * gain,))


@phenomenon("device_scale", "axes", "measurement", "scale[3]")
def _scale(site: Site, p: Values) -> Additions:
    """The device's axes have wrong scales."""
    scale = 1.0 + p["scale"]

    def reading(states: States, values: Array, kind: str) -> Array:
        result = values.copy()
        result[:, :3] *= scale
        return result

    return Additions(readings=(reading,))
