"""Effects in the joints: elasticity that is not a constant, gaps, friction, transmission, neighbours."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from symstiff.arrays import Array
from symstiff.calibration.simulation.chain import joint_index
from symstiff.calibration.simulation.equilibrium import States
from symstiff.calibration.simulation.phenomena import (
    Additions,
    Builder,
    Site,
    Values,
    phenomenon,
    saturation,
    smooth_sign,
)
from symstiff.errors import UserError


def _of_load(share: Callable[[Array, States, Values], Array]) -> Builder:
    """Build a law Δθ_j = share(τ_j, states, values)."""

    def build(site: Site, p: Values) -> Additions:
        v = joint_index(site.where)

        def law(states: States, tau: Array, theta: Array) -> None:
            theta[:, v] += share(tau[:, v], states, p)

        return Additions(laws=(law,))

    return build


def _of_angle(share: Callable[[Array, Values], Array], load_factor: str = "") -> Builder:
    """Build a law Δθ_j = share(q_j, values), or times 1 + β·τ_j where ``load_factor`` names β."""

    def build(site: Site, p: Values) -> Additions:
        j, v = site.where - 1, joint_index(site.where)

        def law(states: States, tau: Array, theta: Array) -> None:
            factor = 1.0 + p[load_factor] * tau[:, v] if load_factor else 1.0
            theta[:, v] += share(states.q[:, j], p) * factor

        return Additions(laws=(law,))

    return build


phenomenon("joint_compliance", "linear", "joint", "c")(_of_load(lambda t, s, p: p["c"] * t))

phenomenon("nonlinear_stiffness", "polynomial", "joint", "c2", "c3", c2=0.0, c3=0.0)(
    _of_load(lambda t, s, p: p["c2"] * t * np.abs(t) + p["c3"] * t**3)
)
phenomenon("nonlinear_stiffness", "tanh", "joint", "a", tau0=1000.0)(
    _of_load(lambda t, s, p: p["a"] * np.tanh(t / p["tau0"]))
)
phenomenon("nonlinear_stiffness", "two_slope", "joint", "c", knee=1000.0)(
    _of_load(lambda t, s, p: p["c"] * np.clip(t, -p["knee"], p["knee"]))
)
phenomenon("nonlinear_stiffness", "power", "joint", "a", tau0=1000.0, exponent=0.5)(
    _of_load(lambda t, s, p: p["a"] * np.sign(t) * np.abs(t / p["tau0"]) ** p["exponent"])
)

phenomenon("backlash", "tanh", "joint", "gap", knee=5.0)(
    _of_load(lambda t, s, p: p["gap"] / 2 * smooth_sign(t, p["knee"]))
)
phenomenon("backlash", "ramp", "joint", "gap", knee=5.0)(
    _of_load(lambda t, s, p: p["gap"] / 2 * np.clip(t / p["knee"], -1, 1))
)
phenomenon("backlash", "arctan", "joint", "gap", knee=5.0)(
    _of_load(lambda t, s, p: p["gap"] / math.pi * np.arctan(t / p["knee"]))
)


def _lag(t: Array, s: States, p: Values) -> Array:
    """Friction lags behind the load: less deflection on the way up, more on the way down."""
    return np.asarray(-s.branch * p["width"] / 2 * smooth_sign(t, p["knee"]))


phenomenon("hysteresis", "constant", "joint", "width", knee=5.0)(_of_load(_lag))
phenomenon("hysteresis", "sqrt", "joint", "width", knee=5.0, tau_ref=1000.0)(
    _of_load(lambda t, s, p: _lag(t, s, p) * np.sqrt(np.abs(t) / p["tau_ref"]))
)
phenomenon("hysteresis", "loop", "joint", "width", knee=5.0, tau_max=5000.0)(
    _of_load(lambda t, s, p: _lag(t, s, p) * np.clip(1 - (t / p["tau_max"]) ** 2, 0, 1))
)
phenomenon("joint_offset", "constant", "joint", "offset")(
    _of_load(lambda t, s, p: np.full(len(t), p["offset"]))
)


def _harmonics(q: Array, p: Values) -> Array:
    orders, a, b = (p[name] for name in ("harmonics", "a", "b"))
    if len(a) != len(orders) or len(b) not in (1, len(orders)):
        raise UserError("a and b need one entry for each of harmonics")
    phase = q[:, None] * orders
    return np.asarray((a * np.sin(phase) + b * np.cos(phase)).sum(axis=1))


phenomenon("transmission_error", "harmonics", "joint", "a[]", "b[]", b=0.0, harmonics=(1.0,))(
    _of_angle(_harmonics)
)
phenomenon("transmission_error", "loaded", "joint", "a[]", "b[]", b=0.0, harmonics=(1.0,), beta=0.0)(
    _of_angle(_harmonics, "beta")
)
phenomenon("transmission_error", "triangle", "joint", "a", harmonic=10.0, phase=0.0)(
    _of_angle(lambda q, p: 2 / math.pi * p["a"] * np.arcsin(np.sin(p["harmonic"] * q + p["phase"])))
)


def _coupled(site: Site) -> tuple[int, int]:
    """Places of two joints. Raises UserError where they are one."""
    first, second = site.where
    if first == second:
        raise UserError(f"joints = [{first}, {second}]: name two joints")
    return joint_index(first), joint_index(second)


@phenomenon("wrist_coupling", "linear", "joints", "c")
def _coupling(site: Site, p: Values) -> Additions:
    j, k = _coupled(site)

    def law(states: States, tau: Array, theta: Array) -> None:
        theta[:, j] += p["c"] * tau[:, k]
        theta[:, k] += p["c"] * tau[:, j]

    return Additions(laws=(law,))


@phenomenon("wrist_coupling", "saturating", "joints", "c", tau0=500.0)
def _saturating_coupling(site: Site, p: Values) -> Additions:
    j, k = _coupled(site)

    def law(states: States, tau: Array, theta: Array) -> None:
        theta[:, j] += p["c"] * p["tau0"] * np.tanh(tau[:, k] / p["tau0"])
        theta[:, k] += p["c"] * p["tau0"] * np.tanh(tau[:, j] / p["tau0"])

    return Additions(laws=(law,))


@phenomenon(
    "gravity_compensator",
    "spring",
    "joint",
    "rate",
    L=0.18472,
    ax=0.68593,
    ay=0.1233,
    s0=0.458,
    zero=0.0,
    direction=1.0,
    preload=0.0,
)
def _compensator(site: Site, p: Values) -> Additions:
    """A spring from an anchor on the link before to an arm on the link after the joint, behind the gear.

    The arm turns with the deflected joint, q_j + θ_j. With ``preload`` 0 the robot's zero was set with the
    spring in place, so that only what the spring's force changes on the way counts.
    """
    j, v = site.where - 1, joint_index(site.where)
    anchor = -np.array([p["ax"], p["ay"]])

    def moment(angle: Array) -> Array:
        arm = p["L"] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        span = arm - anchor
        length = np.linalg.norm(span, axis=1)
        pull = -p["rate"] * (length - p["s0"])
        return np.asarray((arm[:, 0] * span[:, 1] - arm[:, 1] * span[:, 0]) * pull / length)

    def torque(states: States, theta: Array, tau: Array) -> None:
        command = p["direction"] * states.q[:, j] + p["zero"]
        now = moment(command + p["direction"] * theta[:, v])
        tau[:, v] += p["direction"] * (now - (1.0 - p["preload"]) * moment(command))

    return Additions(torques=(torque,))


phenomenon("gravity_compensator", "cosine", "joint", "c", phase=0.0)(
    lambda site, p: _scaled_by_angle(site, site.where, lambda q: p["c"] * np.cos(q - p["phase"]))
)


@phenomenon("gravity_compensator", "per_angle", "joint", "c[]", angles=(0.0,))
def _per_angle(site: Site, p: Values) -> Additions:
    """The joint's extra compliance is a table over its angle; the nearest entry counts."""
    angles, extra = p["angles"], p["c"]
    if len(angles) != len(extra):
        raise UserError("c needs one entry for each of angles")
    return _scaled_by_angle(site, site.where, lambda q: extra[np.abs(q[:, None] - angles).argmin(axis=1)])


def _scaled_by_angle(site: Site, joint: int, c: Callable[[Array], Array]) -> Additions:
    """Δθ_j = c(q_joint)·τ_j."""
    v = joint_index(site.where)

    def law(states: States, tau: Array, theta: Array) -> None:
        theta[:, v] += c(states.q[:, joint - 1]) * tau[:, v]

    return Additions(laws=(law,))


# Outside the catalogue: for blind tests of "unexplained".


@phenomenon("angle_dependent_compliance", "cosine", "joints", "c", order=1.0, phase=0.0)
def _angle_dependent(site: Site, p: Values) -> Additions:
    """Joint j gives way by c·cos(order·q_k + phase)·τ_j: its stiffness depends on another joint's angle."""
    joint, other = site.where
    moved = Site(site.chain, joint, site.compliance)
    return _scaled_by_angle(moved, other, lambda q: p["c"] * np.cos(p["order"] * q + p["phase"]))


@phenomenon("load_product", "product", "joints", "c")
def _load_product(site: Site, p: Values) -> Additions:
    """Joint j gives way by c·τ_j·τ_k: its compliance depends on its neighbour's load."""
    j, k = (joint_index(joint) for joint in site.where)

    def law(states: States, tau: Array, theta: Array) -> None:
        theta[:, j] += p["c"] * tau[:, j] * tau[:, k]

    return Additions(laws=(law,))


@phenomenon("load_product", "magnitude", "joints", "c")
def _load_magnitude(site: Site, p: Values) -> Additions:
    """Joint j gives way by c·τ_j·|τ_k|."""
    j, k = (joint_index(joint) for joint in site.where)

    def law(states: States, tau: Array, theta: Array) -> None:
        theta[:, j] += p["c"] * tau[:, j] * np.abs(tau[:, k])

    return Additions(laws=(law,))


phenomenon("local_bump", "position", "joint", "a", center=0.0, width=0.2)(
    _of_angle(lambda q, p: p["a"] * np.exp(-(((q - p["center"]) / p["width"]) ** 2)))
)
phenomenon("local_bump", "compliance", "joint", "c", center=0.0, width=0.2)(
    lambda site, p: _scaled_by_angle(
        site, site.where, lambda q: p["c"] * np.exp(-(((q - p["center"]) / p["width"]) ** 2))
    )
)
phenomenon("creep", "exponential", "joint", "c", T=600.0)(
    _of_load(lambda t, s, p: p["c"] * t * saturation(s.time, p["T"]))
)
phenomenon("thermal_softening", "linear", "joint", "c", reference=20.0)(
    _of_load(lambda t, s, p: p["c"] * t * (s.temperature - p["reference"]))
)
