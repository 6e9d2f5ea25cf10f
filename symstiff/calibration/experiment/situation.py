"""An experiment seen through a model: geometry, loads, deflections, and what any effect's terms would add.

One state is one row of the measurement table (pose, load case, point); one data row is one measured
component.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp

from symstiff.arrays import TINY, Array, Index, numbered
from symstiff.calibration.tables.loading import turn_of
from symstiff.calibration.tables.measurements import Measurements
from symstiff.effects.base import Body, at_lever
from symstiff.effects.common import GRAVITY
from symstiff.robot.schema import Robot
from symstiff.symbolic.algebras import NumpyAlgebra
from symstiff.symbolic.chain import ElasticChain
from symstiff.symbolic.numeric import Kinematics, kinematics
from symstiff.symbolic.program import walk
from symstiff.symbolic.terms import (
    AXES,
    BRANCH,
    TEMPERATURE,
    TIME,
    TURN,
    Term,
    VirtualJoint,
    deflection,
    q,
    tau,
    up,
    w,
)

Weigh = Callable[[Array], Array]
"""Rows (M, k) in units of the noise, what they share taken into account."""
_ALGEBRA = NumpyAlgebra()
_STEP = 1e-4
"""Change of the largest load over which a slope is taken."""


@dataclass(frozen=True, eq=False)
class View:
    """N states and the M data rows that are read from them.

    ``turn`` (N, 3, 3) and ``shift`` (N, 3), or one for all, take base axes to the device's; ``state`` and ``component``
    (M,) say what each row reads.
    """

    robot: Robot
    table: Measurements
    found: Kinematics
    offset: Array
    """(N, 3) tool centre point to measured point, base axes."""
    state: Index
    component: Index
    tau: Array
    """(N, V) by the wrenches of the table, in absolute data by the links' weight as well."""
    turn: Array = field(default_factory=lambda: np.eye(3)[None])
    shift: Array = field(default_factory=lambda: np.zeros((1, 3)))
    more: Array | float = 0.0
    """(N, V) loads that the model's effects add by their fitted values: every law but a compliance's sees them."""

    @cached_property
    def joints(self) -> tuple[VirtualJoint, ...]:
        """The V virtual joints, base to tip."""
        return ElasticChain(self.robot).virtual_joints

    @cached_property
    def index(self) -> dict[VirtualJoint, int]:
        """Column of each virtual joint."""
        return {v: k for k, v in enumerate(self.joints)}

    @cached_property
    def at_point(self) -> Array:
        """(N, 6, V) twists of the measured points for unit deflections, in the device's axes."""
        J = at_lever(self.found.J_theta, self.offset)
        return np.concatenate([self.turn @ J[:, :3], self.turn @ J[:, 3:]], axis=1)

    @cached_property
    def points(self) -> Array:
        """(N, 3) where the device would read the measured points of the arm of the file: no noise is in them."""
        return self.in_device(self.found.T[:, :3, 3] + self.offset) + self.shift

    @cached_property
    def J(self) -> Array:
        """(M, V) rows of the virtual-joint Jacobian."""
        return np.asarray(self.at_point[self.state, self.component])

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """The links whose mass the robot file tells; each hangs behind its own springs."""
        down = np.tile([0.0, 0.0, -float(GRAVITY), 0.0, 0.0, 0.0], (len(self.table), 1))
        return tuple(
            Body(7 * i + 6, self.found.R[:, i] @ np.array(link.com) - self.found.rho[:, i], link.mass * down)
            for i, link in enumerate(self.robot.links) if i and link.mass
        )  # fmt: skip

    def in_device(self, vectors: Array) -> Array:
        """Vectors (N, 3) of base axes in the device's."""
        return np.asarray((self.turn @ vectors[:, :, None])[:, :, 0])

    def read(self, twists: Array) -> Array:
        """Rows (M,) of twists (N, 6) of the measured points, device axes."""
        return np.asarray(twists[self.state, self.component])

    @cached_property
    def values(self) -> dict[sp.Symbol, Array]:
        """Numbers (N,) for the symbols of a factor."""
        acting = self.tau + self.more
        known: dict[sp.Symbol, Array] = {tau(v): acting[:, k] for k, v in enumerate(self.joints)}
        known |= {q(j + 1): self.table.q[:, j] for j in range(self.table.dof)}
        known |= {w(c): self.table.w[:, c - 1] for c in AXES}
        frames = self.found.R.shape[1]
        known |= {up(i, k + 1): self.found.R[:, i, 2, k] for i in range(frames) for k in range(3)}
        known |= {
            TIME: np.nan_to_num(self.table.time),
            TEMPERATURE: np.nan_to_num(self.table.temperature, nan=20.0),
            BRANCH: np.nan_to_num(self.table.branch),
            TURN: np.nan_to_num(turn_of(self.table), nan=1.0),
        }
        return known

    @cached_property
    def _parts(self) -> dict[sp.Expr, Any]:
        """What parts of factors are: laws at one place, and their shapes, have most of their parts in common."""
        return {}

    def factor(self, expression: sp.Expr, more: Mapping[sp.Symbol, Array] | None = None) -> Array:
        """A term's factor at every state (N,)."""
        if more:
            found = walk(expression, {**self.values, **more}, _ALGEBRA)
        else:
            found = walk(expression, self.values, _ALGEBRA, self._parts)
        return np.asarray(np.broadcast_to(found, (len(self.table),)))

    def load_of(self, at: VirtualJoint, factor: Array) -> Array:
        """Loads (N, V) that a term of the wrench or of a body's weight puts on the virtual joints."""
        J = self.found.J_theta
        if at.kind == "load":
            return np.asarray(J[:, at.axis - 1] * factor[:, None])
        frame = at.body
        axis = self.found.R[:, frame, :, (at.axis - 1) % 3]
        if at.axis > 3:
            load = np.einsum("nr,nrv->nv", axis, J[:, 3:])
        else:
            point = J[:, :3] - np.cross(J[:, 3:], self.found.rho[:, frame, :, None], axis=1)
            load = np.einsum("nr,nrv->nv", axis, point)
        load[:, 7 * at.body + 6 :] = (
            0.0  # a body's weight acts on what is before it, its own springs included
        )
        return np.asarray(load * factor[:, None])


def loads_of(view: View, terms: Iterable[Term]) -> dict[str, Array]:
    """Loads (N, V) on the virtual joints by one unit of each parameter whose terms act on the wrench or on bodies."""
    loads: dict[str, Array] = {}
    for term in terms:
        if term.at.kind in ("load", "body"):
            load = view.load_of(term.at, view.factor(term.factor))
            loads[term.parameter] = loads.get(term.parameter, 0.0) + load
    return loads


def look(robot: Robot, table: Measurements, stand: Array | None = None) -> View:
    """Geometry and external loads of a table's states, of an arm whose virtual joints ``stand`` (N, V) off."""
    poses, back = np.unique(table.q, axis=0, return_inverse=True)
    back = back.reshape(-1)
    once = kinematics(robot, poses)
    found = Kinematics(once.J_theta[back], once.T[back], once.R[back], once.rho[back])
    found = found if stand is None else found.moved(stand)
    offset = np.zeros((len(table), 3))
    for k, name in enumerate(table.points):
        hit = table.point == k
        if hit.any():
            offset[hit] = found.point_offset(robot, name)[hit]
    state, component = np.nonzero(table.measured)
    return View(robot, table, found, offset, state, component, found.loads(table.w))


def under_weights(view: View) -> View:
    """The view with the weight of the robot's links added to the loads, as in absolute data."""
    total = np.array(view.tau)
    for body in view.bodies:
        carried = body.columns(view.found.J_theta)
        total[:, : body.before] += np.einsum("nrv,nr->nv", carried, body.wrench)
    return replace(view, tau=total)


@dataclass(frozen=True, eq=False)
class Laws:
    """Terms with values: the deflections of the virtual joints as a function of their loads."""

    view: View
    terms: tuple[Term, ...]
    numbers: Mapping[str, float]

    @cached_property
    def _parts(self) -> tuple[Array, list[tuple[int, sp.Expr, float]]]:
        """Compliance matrix (V, V) of the linear terms, and the other terms."""
        index = {tau(v): k for k, v in enumerate(self.view.joints)}
        matrix = np.zeros((len(self.view.joints),) * 2)
        rest = []
        for term in self.terms:
            number = self.numbers.get(term.parameter, 0.0)
            if term.at.kind not in ("link", "joint") or number == 0.0:
                continue
            at = self.view.index[term.at]
            if term.factor in index:
                matrix[at, index[term.factor]] += number
            else:
                rest.append((at, term.factor, number))
        return matrix, rest

    def linear(self, loads: Array) -> Array:
        """Δθ (N, V) under loads (N, V) by the compliances alone."""
        return np.asarray(loads @ self._parts[0].T)

    def __call__(self, loads: Array) -> Array:
        """Δθ (N, V) under loads (N, V)."""
        rest = self._parts[1]
        theta = self.linear(loads)
        if rest:
            moved = replace(self.view, tau=loads, more=0.0)
            for at, factor, number in rest:
                theta[:, at] += number * moved.factor(factor)
        return np.asarray(theta)


def linear_columns(view: View, terms: Sequence[Term], names: Sequence[str]) -> Array:
    """(M, len(names)) columns of terms at links and joints; other terms are left out.

    A compliance is a column of the table's loads alone: what it answers to further loads is in their columns.
    """
    columns = np.zeros((len(view.state), len(names)))
    place = {n: k for k, n in enumerate(names)}
    own = {tau(v): k for k, v in enumerate(view.joints)}
    for term in terms:
        if term.at.kind in ("link", "joint") and term.parameter in place:
            v = view.index[term.at]
            plain = own.get(term.factor)
            factor = view.factor(term.factor) if plain is None else view.tau[:, plain]
            columns[:, place[term.parameter]] += view.J[:, v] * factor[view.state]
    return columns


@dataclass(frozen=True, eq=False)
class Situation:
    """A view with the current model's fitted deflections: what effects' columns are computed from."""

    view: View
    laws: Laws

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the poses that the data hold."""
        present = set(self.view.table.pose.tolist())
        return tuple(label for k, label in enumerate(self.view.table.labels) if k in present)

    @property
    def row_pose(self) -> Index:
        """(M,) position in ``labels``."""
        return np.asarray(numbered(self.view.table.pose)[self.view.state])

    @property
    def row_axis(self) -> Index:
        """(M,) component 0–5."""
        return self.view.component

    @property
    def J(self) -> Array:
        """(N, 6, V) at the tool centre point, base axes."""
        return self.view.found.J_theta

    @cached_property
    def wrench(self) -> Array:
        """(N, 6) as the table tells it, with the errors of it that the model has."""
        total = np.array(self.view.table.w)
        for term in self.laws.terms:
            if term.at.kind == "load":
                number = self.laws.numbers.get(term.parameter, 0.0)
                total[:, term.at.axis - 1] += number * self.view.factor(term.factor)
        return total

    @property
    def offset(self) -> Array:
        """(N, 3) tool centre point to measured point, base axes."""
        return self.view.offset

    @cached_property
    def theta(self) -> Array:
        """(N, V) deflections by the current model."""
        return self.laws(self.view.tau + self.view.more)

    @cached_property
    def sag(self) -> Array:
        """(N, V) deflections under the links' known weight that deflections do not show; 0 in absolute data."""
        if self.view.table.kind == "absolute" or not self.view.robot.has_weights:
            return np.zeros_like(self.view.tau)
        # laws that bend are those of what a load adds to the weight: without it there is none
        weight = under_weights(self.view).tau - self.view.tau
        return np.asarray(self.laws(np.zeros_like(weight)) - self.laws(-weight))

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The links whose mass the robot file tells."""
        return self.view.bodies

    @property
    def robot(self) -> Robot:
        """The robot file's."""
        return self.view.robot

    def of(self, robot: Robot) -> Situation:
        """The same states of a robot whose links weigh something else, under the same loads of the experiment."""
        if robot is self.robot:
            return self
        view = replace(self.view, robot=robot)
        if view.table.kind == "absolute":  # whose loads hold the links' weight
            other = under_weights(view).tau - under_weights(self.view).tau
            view = replace(view, tau=self.view.tau + other)
        return replace(self, view=view)

    def respond(self, loads: Array) -> Array:
        """(N, V) further deflections under further loads (N, V)."""
        return np.asarray(self.laws(self.view.tau + self.view.more + loads) - self.theta)

    def slope(self, loads: Array) -> Array:
        """(N, V) change of the deflections by each unit of further loads (N, V), where the loads are now."""
        step = _STEP * float(np.abs(self.view.tau).max()) / max(float(np.abs(loads).max()), TINY)
        return self.respond(step * loads) / step if step > 0 else self.respond(loads)

    def rows(self, twists: Array) -> Array:
        """Rows (M,) of twists (N, 6) of the measured points, base axes."""
        parts = [self.view.in_device(part) for part in (twists[:, :3], twists[:, 3:])]
        return self.view.read(np.concatenate(parts, axis=1))

    @cached_property
    def reading(self) -> dict[sp.Symbol, Array]:
        """Predicted deflection (N,) of the measured points by component, for terms of the measuring device."""
        twist = np.einsum("nrv,nv->nr", self.view.at_point, self.theta)
        return {deflection(c): twist[:, c - 1] for c in AXES}

    def columns(self, terms: Sequence[Term], names: Sequence[str]) -> Array:
        """(M, len(names)): what one unit of each parameter adds to the data."""
        view = self.view
        total = linear_columns(view, terms, names)
        place = {n: k for k, n in enumerate(names)}
        for term in terms:
            if term.parameter in place and term.at.kind == "measure":
                hit = view.component == term.at.axis - 1
                factor = view.factor(term.factor, self.reading)[view.state]
                total[:, place[term.parameter]] += hit * factor
        for name, load in loads_of(view, (t for t in terms if t.parameter in place)).items():
            total[:, place[name]] += np.einsum("mv,mv->m", view.J, self.slope(load)[view.state])
        return total
