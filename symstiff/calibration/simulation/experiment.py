"""The virtual experiment: equilibria with and without the load, then what a real device would have read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from symstiff.arguments import require, whole
from symstiff.arrays import Array
from symstiff.calibration.simulation.chain import Chain, chain_of, posture
from symstiff.calibration.simulation.equilibrium import (
    Mechanism,
    States,
    Weight,
    equilibrium,
    weight_at,
)
from symstiff.calibration.simulation.nominal import linear_compliance
from symstiff.calibration.simulation.phenomena import Additions, build
from symstiff.calibration.simulation.rehearsal import CONTEXT, followed
from symstiff.calibration.simulation.truth import Device, Noise, Truth
from symstiff.calibration.tables.loading import as_loading
from symstiff.calibration.tables.measurements import Measurements, measurements
from symstiff.errors import UserError

Kind = Literal["deflection", "absolute"]
_A_TRUTH = ("what is true", "load_truth('truth.toml') gives it")
_GIVEN = frozenset({"kind", "points", "point", "labels", "pose", *CONTEXT})


@dataclass(frozen=True)
class Rig:
    """A truth made ready to run: the mechanism and what the device does to its readings."""

    truth: Truth
    mechanism: Mechanism
    additions: tuple[Additions, ...]


def prepare(truth: Truth) -> Rig:
    """Assemble the mechanism of a truth. Raises UserError for effects that do not fit the robot."""
    chain = chain_of(truth.robot)
    compliance = linear_compliance(chain, dict(truth.compliance))
    additions = []
    for effect in truth.effects:
        added = build(effect, chain, compliance)
        additions.append(added)
        if added.compliance is not None:
            compliance = compliance + added.compliance
    mechanism = Mechanism(
        chain=chain,
        compliance=compliance,
        laws=tuple(law for a in additions for law in a.laws),
        torques=tuple(torque for a in additions for torque in a.torques),
        wrenches=tuple(wrench for a in additions for wrench in a.wrenches),
        weights=(*_link_weights(truth), *(weight for a in additions for weight in a.weights)),
    )
    return Rig(truth, mechanism, tuple(additions))


def _link_weights(truth: Truth) -> tuple[Weight, ...]:
    """Weights of the robot file's links, as the truth wants them."""
    if not truth.weights:
        return ()
    behind = truth.weights != "before"
    return tuple(
        weight_at(i, link.mass, np.array(link.com), behind)
        for i, link in enumerate(truth.robot.links)
        if link.mass
    )


@np.errstate(all="ignore")  # what is not finite is refused in the end
def simulate(truth: Truth, design: Measurements, seed: int) -> Measurements:
    """Return what an experiment at the rows of ``design`` would have measured; the same seed, the same data.

    ``seed``: a whole number from 0 on, of which the noise of every row follows; another one is another experiment.
    Raises UserError where the design does not fit the robot, no equilibrium exists, or a number is beyond what a
    table holds.
    """
    from symstiff.calibration.tables.checks import check_robot
    from symstiff.calibration.tables.table import check_limits

    require(truth, Truth, *_A_TRUTH)
    whole(seed, "seed")
    check_robot(design, truth.robot)
    kind: Kind = truth.kind or ("absolute" if design.kind == "absolute" else "deflection")
    if kind == "deflection" and not design.w.any():
        raise UserError(
            "every wrench is zero: give the poses table loads (fx[N] …), or measure absolute positions"
        )
    rig, design = prepare(truth), _in_environment(truth, design)
    _check_effects(rig, design)
    seeds = np.random.SeedSequence(seed).spawn(4)
    approach, noise, unloaded, settling = (np.random.default_rng(s) for s in seeds)
    group = design.approach
    errors = approach.standard_normal((int(group.max()) + 1, truth.robot.dof + 3))[group]
    stops = errors[:, 3:] * truth.noise.approach_mrad + _settling(truth, design, settling)
    values = _clean(rig, as_loading(design), kind, stops * 1e-3)
    values[:, :3] += errors[:, :3] * np.array(truth.noise.approach_mm) * 1e-3
    if kind == "deflection":
        before = unloaded.standard_normal((int(group.max()) + 1, len(design.points), 3))[group, design.point]
        values[:, :3] -= before * np.array(truth.noise.unloaded_mm) * 1e-3
    deviation = _deviation(truth.noise, truth.device, rig.mechanism.chain, design)
    values += deviation * noise.standard_normal(values.shape)
    if truth.noise.quantum_mm > 0:
        quantum = truth.noise.quantum_mm * 1e-3
        values[:, :3] = np.round(values[:, :3] / quantum) * quantum
    sigma = np.where(deviation > 0, deviation * truth.noise.stated, np.nan)
    if truth.noise.stated <= 0:
        sigma[:] = np.nan
    if truth.components == "position":
        values[:, 3:] = sigma[:, 3:] = np.nan
    nowhere = np.zeros(len(design), dtype=np.intp)
    made = replace(design, kind=kind, values=values, sigma=sigma, files=(), file=nowhere, line=nowhere)
    check_limits(made)
    return made


def _settling(truth: Truth, design: Measurements, rng: np.random.Generator) -> Array:
    """(M, n) errors of the joints [mrad, of slides mm] that the points of one reading share."""
    context = np.column_stack([design.branch, design.load_step, design.repeat])
    keys = np.column_stack([design.pose, design.w, np.nan_to_num(context, nan=-2.0)])
    reading = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    size = np.array(truth.noise.settling_mrad or (0.0,) * truth.robot.dof)
    return np.asarray(size * rng.standard_normal((len(design), truth.robot.dof))[reading])


def _check_effects(rig: Rig, design: Measurements) -> None:
    """Raise UserError for an effect that would leave no trace: the design lacks what it follows, or its poses."""
    chain = rig.mechanism.chain
    for effect, added in zip(rig.truth.effects, rig.additions, strict=True):
        for name in followed(effect, chain):
            if np.isnan(getattr(design, name)).all():
                otherwise = "" if name == "branch" else ", or [environment] to the truth"
                table = design.files[0] if design.files else "the poses table"
                raise UserError(
                    f"effect {effect.effect}: it follows the {name}, which {table} does not tell: "
                    f"add a column {CONTEXT[name]}{otherwise}"
                )
        strangers = [label for labels, _ in added.shifts for label in labels if label not in design.labels]
        if strangers:
            known = ", ".join(design.labels[:4]) + (", …" if len(design.labels) > 4 else "")
            raise UserError(
                f"effect {effect.effect}: no pose is called {strangers[0]}: the table has {known}"
            )


def clean_response(truth: Truth, q: Any, w: Any, context: Mapping[str, Any] | None = None) -> Array:
    """Noise-free values (M, 6) at joints ``q`` (M, n) under wrenches ``w`` (M, 6): m, rad.

    ``context`` may hold ``kind``, and any of ``points``, ``point``, ``labels``, ``pose``, ``time``,
    ``temperature`` and ``branch`` as in ``measurements``. Raises UserError for what does not fit the robot.
    """
    from symstiff.calibration.tables.checks import check_robot

    require(truth, Truth, *_A_TRUTH)
    require(context or {}, Mapping, "a context", "{'kind': 'absolute'} is one")
    given = dict(context or {})
    if strange := sorted(map(str, set(given) - _GIVEN)):
        raise UserError(f"context: unknown {strange[0]!r}: known are {', '.join(sorted(_GIVEN))}")
    kind = given.pop("kind", None) or truth.kind or "deflection"
    if kind not in ("deflection", "absolute"):
        raise UserError(f"kind: expected deflection or absolute, found {kind!r:.40}")
    table = measurements(q, w, **given)
    if table.dof == truth.robot.dof:
        units = tuple("m" if j.prismatic else "rad" for j in truth.robot.joint)
        table = replace(table, joint_units=units)
    check_robot(table, truth.robot)
    table = _in_environment(truth, table)
    return _clean(prepare(truth), table, kind, np.zeros(table.q.shape))


def _clean(rig: Rig, table: Measurements, kind: Kind, approach: Array) -> Array:
    """Readings without noise; ``approach`` (M, n) is added to the joints of the measured state."""
    states = States(
        q=table.q + approach,
        w=table.w,
        loaded=np.ones(len(table)),
        time=np.nan_to_num(table.time),
        temperature=np.nan_to_num(table.temperature, nan=20.0),
        branch=np.nan_to_num(table.branch),
    )
    chain = rig.mechanism.chain
    points = np.array([chain.point(name) for name in table.points])[table.point]
    position, rotation = _settle(rig.mechanism, states, points)
    if kind == "deflection":
        start, attitude = _settle(rig.mechanism, replace(states, q=table.q).unloaded(), points)
        values = np.concatenate(
            [position - start, _rotation_vector(rotation @ attitude.transpose(0, 2, 1))], axis=1
        )
    else:
        values = _seen_from(rig.truth.device, position, rotation @ chain.attitude)
    for added in rig.additions:
        for reading in added.readings:
            values = reading(states, values, kind)
        for labels, shift in added.shifts:
            hit = np.isin(np.array(table.labels), np.array(labels))[table.pose]
            values[hit, :3] += shift
    return values


def _settle(mechanism: Mechanism, states: States, points: Array) -> tuple[Array, Array]:
    """Positions (M, 3) of points and attitudes (M, 3, 3) of frame n; equal rows are solved once."""
    keys = np.column_stack(
        [states.q, states.w, states.loaded, states.time, states.temperature, states.branch]
    )
    packed = np.ascontiguousarray(keys + 0.0).view(np.dtype((np.void, 8 * keys.shape[1]))).ravel()
    _, first, inverse = np.unique(packed, return_index=True, return_inverse=True)
    inverse = inverse.ravel()
    once = states.select(first)
    now = posture(mechanism.chain, once.q, equilibrium(mechanism, once))
    rotation, position = now.after[0][inverse, -1], now.after[1][inverse, -1]
    return position + np.einsum("nij,nj->ni", rotation, points), rotation


def _rotation_vector(rotation: Array) -> Array:
    """Rotation vectors (M, 3) of rotations (M, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def _seen_from(device: Device, position: Array, rotation: Array) -> Array:
    """World positions and attitudes in the device's frame."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("xyz", device.rpy).as_matrix()  # fixed axes: Rz(yaw)·Ry(pitch)·Rx(roll)
    return np.concatenate(
        [(position - np.array(device.xyz)) @ turn, _rotation_vector(turn.T @ rotation)], axis=1
    )


def _in_environment(truth: Truth, table: Measurements) -> Measurements:
    """Fill time and temperature by the truth's schedule where the design has none of its own."""
    plan = truth.environment
    if plan is None:
        return table
    time = np.where(np.isnan(table.time), plan.start + plan.interval * np.arange(len(table)), table.time)
    warmth = plan.temperature - plan.warming * np.expm1(-time / max(plan.T, 1e-9))
    return replace(
        table, time=time, temperature=np.where(np.isnan(table.temperature), warmth, table.temperature)
    )


def _deviation(noise: Noise, device: Device, chain: Chain, table: Measurements) -> Array:
    """Standard deviations (M, 6) of one reading: m, rad."""
    points = np.array([chain.point(name) for name in table.points])[table.point]
    position = posture(chain, table.q, np.zeros((len(table), chain.size))).at(points)
    distance = np.linalg.norm(position - np.array(device.xyz), axis=1)
    own = np.concatenate([noise.sigma_mm, noise.sigma_mrad]) * 1e-3
    result = np.broadcast_to(own, (len(table), 6)).copy()
    if noise.growth_ppm > 0:
        result[:, :3] = np.hypot(result[:, :3], (noise.growth_ppm * 1e-6 * distance)[:, None])
    return result
