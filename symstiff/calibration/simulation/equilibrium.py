"""Static equilibrium of the elastic robot: θ = law(τ), τ the loads on the deflected chain, many at once.

The load stands at the tool centre point and moves with it; weights hang at their centres of mass. Rows that
are nearly linear settle under fixed-point steps (each gains about log10(size/deflection) digits); what does
not settle is solved by damped Newton steps on the residual θ − law(τ(θ)).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from symstiff.arrays import TINY, Array
from symstiff.calibration.simulation.chain import Chain, Posture, posture
from symstiff.errors import UserError

GRAVITY = 9.80665  # m/s²
_RELATIVE = 1e-12
_ABSOLUTE = 1e-16
_STEPS = 14
_NEWTON_STEPS = 60
_DIFFERENCE = 1e-7
_BATCH = 20_000


@dataclass(frozen=True)
class States:
    """What N equilibria are asked for: joints ``q`` (N, n), wrench ``w`` (N, 6), and the context (N,) of
    each row.

    ``loaded`` is 1 where the test load hangs, 0 for the reference state; time, temperature and branch are 0
    where unknown.
    """

    q: Array
    w: Array
    loaded: Array
    time: Array
    temperature: Array
    branch: Array

    def __len__(self) -> int:
        return len(self.q)

    @property
    def hung(self) -> Array:
        """(N,) 1 where a load is told of the measured state, else 0."""
        return np.asarray(self.loaded * self.w.any(axis=1))

    def select(self, rows: Any) -> States:
        """Return some of the rows."""
        return States(*(getattr(self, f.name)[rows] for f in fields(self)))

    def unloaded(self) -> States:
        """Return the same rows just before the load came: no wrench, no branch."""
        zero = np.zeros(len(self))
        return replace(self, w=np.zeros_like(self.w), loaded=zero, branch=zero)


Law = Callable[[States, Array, Array], None]
"""``law(states, tau, theta)``: adds its share to ``theta`` (N, V) for loads ``tau`` (N, V)."""

Torque = Callable[[States, Array, Array], None]
"""``torque(states, theta, tau)``: adds to ``tau`` what springs inside the robot exert at ``theta``."""

Wrench = Callable[[States, Array], Array]
"""``wrench(states, w)``: what really acts when ``w`` (N, 6) is believed to."""


@dataclass(frozen=True)
class Weight:
    """A body's weight: mass [kg], first moment [kg·m] in DH frame ``link``, before or behind its springs."""

    link: int
    mass: float
    moment: tuple[float, float, float]
    behind: bool = False
    only_loaded: bool = False


def weight_at(link: int, mass: float, com: Array, behind: bool = False) -> Weight:
    """Return the weight of a mass [kg] at ``com`` (3,) [m] in DH frame ``link``."""
    x, y, z = (float(mass * c) for c in com)
    return Weight(link, mass, (x, y, z), behind)


@dataclass(frozen=True)
class Mechanism:
    """An elastic robot with all that bends it: linear compliance (V, V), laws, inner springs, weights."""

    chain: Chain
    compliance: Array
    laws: tuple[Law, ...] = ()
    torques: tuple[Torque, ...] = ()
    wrenches: tuple[Wrench, ...] = ()
    weights: tuple[Weight, ...] = ()


def loads(mechanism: Mechanism, states: States, now: Posture) -> Array:
    """Loads τ (N, V) on the virtual joints of deflected states: force along, or moment about, each axis."""
    w = states.w
    for wrench in mechanism.wrenches:
        w = wrench(states, w)
    translational = mechanism.chain.translational
    force = np.broadcast_to(w[:, None, :3], now.axis.shape)
    lever = now.at(mechanism.chain.tool)[:, None] - now.origin
    moment = w[:, None, 3:] + np.cross(lever, force)
    for weight in mechanism.weights:
        count = 7 * weight.link + (6 if weight.behind else 0)
        if not count:
            continue
        rotation, position = now.after if weight.behind else now.before
        share = states.hung if weight.only_loaded else np.ones(len(states))
        down = -GRAVITY * share[:, None]
        arm = np.einsum("nij,j->ni", rotation[:, weight.link], np.array(weight.moment))
        first_moment = (position[:, weight.link, None] - now.origin[:, :count]) * weight.mass + arm[:, None]
        force = np.array(force)
        force[:, :count, 2] += down * weight.mass
        moment[:, :count, 0] += first_moment[:, :, 1] * down
        moment[:, :count, 1] -= first_moment[:, :, 0] * down
    return np.asarray(np.einsum("nvi,nvi->nv", now.axis, np.where(translational[:, None], force, moment)))


def response(mechanism: Mechanism, states: States, theta: Array) -> Array:
    """law(τ(θ)): the coordinates (N, V) that the loads at coordinates ``theta`` would produce."""
    tau = loads(mechanism, states, posture(mechanism.chain, states.q, theta))
    for torque in mechanism.torques:
        torque(states, theta, tau)
    result = tau @ mechanism.compliance.T
    for law in mechanism.laws:
        law(states, tau, result)
    return np.asarray(result)


def equilibrium(mechanism: Mechanism, states: States) -> Array:
    """Solve for the virtual coordinates θ (N, V). Raises UserError where no equilibrium is found."""
    theta = np.zeros((len(states), mechanism.chain.size))
    active = np.arange(len(states))
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            new = response(mechanism, states.select(active), theta[active])
            step = np.abs(new - theta[active]).max(axis=1)
            theta[active] = new
            settled = np.isfinite(step) & (step <= _RELATIVE * np.abs(new).max(axis=1) + _ABSOLUTE)
            active = active[~settled]
            if not active.size:
                return theta
        rows = max(1, _BATCH // (mechanism.chain.size + 1))
        for part in np.array_split(active, -(-active.size // rows)):
            theta[part] = _newton(mechanism, states.select(part), theta[part])
    return theta


def _newton(mechanism: Mechanism, states: States, theta: Array) -> Array:
    theta = np.where((np.isfinite(theta) & (np.abs(theta) < 1)).all(axis=1, keepdims=True), theta, 0.0)
    residual = theta - response(mechanism, states, theta)
    for _ in range(_NEWTON_STEPS):
        slopes = _slopes(mechanism, states, theta, residual)
        try:
            step = np.linalg.solve(slopes, residual[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:  # some row has nowhere to go
            break
        factor = np.minimum(1.0, 0.5 / np.abs(step).max(axis=1, initial=TINY))  # no turn beyond half a radian
        for _ in range(12):
            trial = theta - factor[:, None] * step
            after = trial - response(mechanism, states, trial)
            worse = ~(np.abs(after).max(axis=1) <= np.abs(residual).max(axis=1) + _ABSOLUTE)
            if not worse.any():
                break
            factor = np.where(worse, factor / 2, factor)
        theta, residual = trial, after
        if (np.abs(residual).max(axis=1) <= _RELATIVE * np.abs(theta).max(axis=1) + _ABSOLUTE).all():
            return theta
    if (np.abs(residual).max(axis=1) <= 1e-9 * np.abs(theta).max(axis=1)).all():
        return theta
    raise UserError(
        "no static equilibrium found: the load is too large for these compliances: lower the wrench or "
        "the compliances of the truth"
    )


def _slopes(mechanism: Mechanism, states: States, theta: Array, residual: Array) -> Array:
    """∂(θ − law(τ(θ)))/∂θ (N, V, V) by forward differences of the whole residual."""
    rows, size = theta.shape
    moved = theta[:, None, :] + _DIFFERENCE * np.eye(size)
    many = states.select(np.repeat(np.arange(rows), size))
    flat = moved.reshape(rows * size, size)
    shifted = (flat - response(mechanism, many, flat)).reshape(rows, size, size)
    return np.asarray((shifted - residual[:, None, :]).transpose(0, 2, 1) / _DIFFERENCE)
